"""Runs the server on its port, and tells people and the command line how to log in."""

from __future__ import annotations

import errno
import json
import math
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

import uvicorn
from fastapi import FastAPI
from sqlalchemy.exc import DatabaseError

from app.access.first_token import make_first_code, write_secret
from app.access.service import code_is_over
from app.context import ServiceContext
from app.engine.chunk import UnusableEngine
from app.logs import configure_logging, error_log, server_log
from app.main import create_app
from app.maintenance import datafolder
from app.measuring.active import UnusableConfig
from app.memory import keep_freed_memory, settle
from app.package import VERSION
from app.process.connections import raise_descriptor_limit
from app.process.server import GracefulServer, ProblemProtocol, exit_on_sigterm
from app.settings import Settings, bracketed
from app.storage.durable import SERVER_LOCK, CannotLock, InUse, locked, make_folder
from unghost.wire.note import note_path

STOP_WAIT_S: Final = 10
_BACKLOG: Final = 2048
_ANYWHERE: Final = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}
_OTHER_LOOPBACK: Final = {
    "127.0.0.1": "::1",
    "localhost": "::1",
    "0.0.0.0": "::1",
    "": "::1",
    "::1": "127.0.0.1",
}
"""For each host that includes one loopback address only, the other one."""
_TRIES: Final = 20
"""How many ports are tried if any may be used."""

_HINTS: Final = {
    errno.EADDRINUSE: "is another server running there? --port chooses another port",
    errno.EADDRNOTAVAIL: "--host takes an address of this machine, or 0.0.0.0 for all",
    errno.EACCES: "ports below 1024 need the rights of an administrator; "
    "--port chooses another port",
}


class CannotServe(Exception):
    """The service could not start; the text says why and what to do."""


def serve(
    settings: Settings,
    *,
    on_locked: Callable[[], None] = lambda: None,
    on_ready: Callable[[str, Callable[[], bool]], None] | None = None,
) -> None:
    """Serve until interrupted.

    `on_locked` is called once the data folder and the port are this server's alone, and
    `on_ready` once requests are answered: with a link that logs a person in, once and
    within ten minutes, and a function that says whether it was used or has expired.

    Raises CannotServe: the port is taken, or the data folder cannot be used, for
    instance because another server uses it.
    """
    configure_logging(settings.log_level, settings.log_format)
    keep_freed_memory()
    limit = raise_descriptor_limit()
    with _only_server(settings) as locks, _listening(settings) as sockets:
        locks.warn()
        host, port = settings.host.strip("[]"), sockets[0].getsockname()[1]
        url = f"http://{bracketed(_ANYWHERE.get(host, host))}:{port}"
        locks.note(url)
        note = ServerNote(url, settings.token_file)
        on_locked()

        app = create_app(settings)

        def ready() -> None:
            link, is_over = first_link(app.state.services, url)
            settle()
            note.write()
            server_log.info("ready at %s, version %s", url, VERSION)
            if host in _ANYWHERE and not settings.allowed_hosts:
                server_log.warning(
                    "other machines reach this service at the addresses of this one; "
                    "under a host name they are refused (421) until it is in "
                    "UNGHOST_ALLOWED_HOSTS, such as UNGHOST_ALLOWED_HOSTS=%s",
                    socket.gethostname(),
                )
            server_log.info(
                "at most %s files and connections may be open, %d of them connections",
                "any number of" if limit is None else limit,
                app.state.connections.most,
            )
            if on_ready is not None:
                on_ready(link, is_over)
            else:
                sys.stdout.write(f"{ready_text(link)}\n")
                sys.stdout.flush()

        def stopping() -> None:
            note.remove()
            locks.note("")
            # Jobs pause, batches end, and so do streams of events.
            app.state.services.engine.stopping.set()

        server = GracefulServer(
            server_config(app),
            ready=ready,
            stopping=stopping,
            wait_s=settings.shutdown_wait_s,
        )
        exit_on_sigterm()
        # Ctrl+C is the usual end; with SystemExit uvicorn reports a failed start.
        with suppress(KeyboardInterrupt, SystemExit):
            server.run(sockets=sockets)
    if not server.started or server.failure is not None:
        raise _cannot_start(settings, server.failure or app.state.failure)


class _Locks:
    """What a server has locked, so that no other one uses it at the same time."""

    def __init__(self, held: ExitStack) -> None:
        self._held = held
        self._notes: list[Callable[[str], None]] = []
        self._unlocked: dict[Path, str] = {}

    def add(self, file: Path, what: str, advice: str) -> None:
        """Lock a file; the texts say what it stands for, and how to choose another one.

        Raises CannotServe if another server has locked it.
        """
        try:
            note = self._held.enter_context(locked(file))
        except CannotLock as exc:
            self._unlocked[file.parent] = str(exc)
        except InUse as exc:
            address = str(exc)
            if not address:  # only while it starts or stops
                raise CannotServe(
                    f"{what} is in use by a server that is starting or stopping; "
                    "try again in a moment"
                ) from exc
            raise CannotServe(
                f"{what} is in use by the server at {address}; use that one, or stop "
                f"it first. {advice}"
            ) from exc
        else:
            self._notes.append(note)

    def note(self, address: str) -> None:
        """Note the address that other servers name when they are refused."""
        for note in self._notes:
            note(address)

    def warn(self) -> None:
        """Log which folders could not be locked, and why."""
        for folder, reason in self._unlocked.items():
            server_log.warning(
                "the folder %r cannot be locked (%s): a second server that uses it "
                "would not be refused, so start none",
                str(folder),
                reason,
            )


@contextmanager
def _only_server(settings: Settings) -> Iterator[_Locks]:
    """Lock the data folder and the database, if that is SQLite.

    With SQLite, parts of one service know of each other only in memory: whose turn it
    is to write, and that the final step of a run is being cancelled. Also, a server of
    a newer version would migrate the database while this one uses it. And for a server
    with another database, the files of this one would be garbage. Raises CannotServe if
    another server uses one of them, or the folder cannot be written to or may have been
    filled by others.
    """
    with ExitStack() as held:
        locks = _Locks(held)
        try:
            make_folder(settings.data)
            datafolder.check_owner(settings)
            database = datafolder.database_file(settings)
            if database is not None:  # several servers may share PostgreSQL
                locks.add(
                    settings.data.resolve() / SERVER_LOCK,
                    f"the data folder {str(settings.data)!r}",
                    "--data chooses another folder",
                )
                database = database.resolve()
                locks.add(
                    datafolder.database_lock(database),
                    f"the database {str(database)!r}",
                    "UNGHOST_DATABASE_URL chooses another database",
                )
        except (OSError, datafolder.CannotMaintain) as exc:
            raise _cannot_start(settings, exc) from exc
        yield locks


class ServerNote:
    """A file that tells the command line on this machine where to find the token."""

    def __init__(self, url: str, token_file: Path) -> None:
        self._url = url
        self._token_file = token_file
        self.path = note_path(url, os.environ)

    def write(self) -> None:
        """Write the note; if that is impossible, the server runs without it."""
        note = {
            "url": self._url,
            "token_file": str(self._token_file.resolve()),
            "pid": os.getpid(),
        }
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_secret(self.path, json.dumps(note))
        except OSError as exc:
            sys.stderr.write(
                f"the command line will not find this server: {exc.strerror}\n"
            )

    def remove(self) -> None:
        """Delete the note, unless another server has replaced it."""
        try:
            if json.loads(self.path.read_text("utf-8"))["pid"] == os.getpid():
                self.path.unlink()
        except (OSError, ValueError, KeyError, TypeError):
            return


def _cannot_start(settings: Settings, reason: Exception) -> CannotServe:
    if isinstance(reason, UnusableConfig):
        return CannotServe(f"the configuration cannot be used: {reason}")
    if isinstance(reason, datafolder.CannotMaintain | UnusableEngine):
        return CannotServe(str(reason))
    if isinstance(reason, DatabaseError):
        return CannotServe(
            f"the service could not start with the data folder {str(settings.data)!r}: "
            f"{reason.orig}; `unghost doctor` says more"
        )
    if not isinstance(reason, OSError):
        error_log.error("could not start", exc_info=reason)
    text = getattr(reason, "strerror", None) or type(reason).__name__
    return CannotServe(
        f"the service could not start with the data folder {str(settings.data)!r}: "
        f"{text}"
    )


def server_config(app: FastAPI) -> uvicorn.Config:
    """The configuration of uvicorn, without its own logging.

    The address of a client is that of its connection. Headers that name another one are
    trusted only from the proxies in the settings, since anybody can send them.
    """
    settings: Settings = app.state.settings
    proxies = settings.trusted_proxies
    return uvicorn.Config(
        app,
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=bool(proxies),
        forwarded_allow_ips=list(proxies),
        timeout_graceful_shutdown=STOP_WAIT_S,
        # Not sooner than `ProblemProtocol` closes idle connections. Many clients reuse
        # a connection for five seconds: with uvicorn's default, also five, they would
        # send on a connection that is just being closed.
        timeout_keep_alive=math.ceil(settings.head_wait_s),
        lifespan="on",
        ws="none",
        http=ProblemProtocol,
    )


def listen(
    host: str, port: int, family: socket.AddressFamily = socket.AF_INET
) -> socket.socket:
    """A listening socket whose connections send without delay.

    It is created with the protocol TCP: only then asyncio turns off Nagle's algorithm,
    which would delay the second half of each response by 40 ms.
    """
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":  # elsewhere it would let two servers share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(_BACKLOG)
    except BaseException:  # a host that is not an address raises other errors
        listener.close()
        raise
    return listener


def check_free(settings: Settings) -> None:
    """Raise CannotServe unless the data folder is not in use and the port is free."""
    with _only_server(settings), _listening(settings):
        pass


@contextmanager
def _listening(settings: Settings) -> Iterator[list[socket.socket]]:
    """The listening sockets of the service, during the block.

    A browser looks for ``localhost`` at both loopback addresses, so a service that
    listens at one of them takes the other one as well. A program of another user there
    would be the same origin to the browser, which would send it sessions. Raises
    CannotServe if one of the addresses is taken, or is not one of this machine.
    """
    host, port = settings.host.strip("[]"), settings.port
    other = _OTHER_LOOPBACK.get(host)
    for left in reversed(range(_TRIES)):
        with ExitStack() as opened:
            sockets = [opened.enter_context(_listen(host, port))]
            try:
                if other is not None and _has_address(other):
                    taken = sockets[0].getsockname()[1]
                    sockets.append(opened.enter_context(_listen(other, taken)))
            except CannotServe as exc:
                if port == 0 and left:  # any other port will do
                    continue
                why = f"browsers look for localhost at {bracketed(other or '')} as well"
                raise CannotServe(f"{exc}; {why}") from exc
            yield sockets
            return


def _listen(host: str, port: int) -> socket.socket:
    try:
        return listen(host, port, _family(host))
    except OSError as exc:
        hint = _HINTS.get(exc.errno or 0, "--host and --port say where to listen")
        place = f"{bracketed(host)}:{port}"
        detail = f"cannot listen on {place}: {exc.strerror}; {hint}"
        raise CannotServe(detail) from exc


def _has_address(host: str) -> bool:
    """Whether this machine has the address: some have no IPv6."""
    try:
        with socket.socket(_family(host), socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
    except OSError:
        return False
    return True


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def first_link(services: ServiceContext, url: str) -> tuple[str, Callable[[], bool]]:
    """A new login link for the token in the data folder, and whether it is over."""
    database = services.database
    with database.write() as session:
        code, secret = make_first_code(session, services.settings.token_file)

    def is_over() -> bool:
        with database.read() as session:
            return code_is_over(session, code.id)

    return f"{url}/#code={secret}", is_over


def ready_text(link: str) -> str:
    """The text that is printed once requests are answered."""
    return (
        f"Unghost is ready. Log in with\n\n    {link}\n\n"
        "The link works once, within ten minutes; `unghost login` prints another.\n"
    )
