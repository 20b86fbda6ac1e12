"""Finds the server's address, and the token of a server on this machine.

Another user's program may have taken the port of a server that has ended. So a token
that was found in a file is sent only to a server on this machine that runs as the owner
of the file, and without a token a server on this machine gets something only if it runs
as the caller or as root. Before each connection, the users whose programs listen at the
address are therefore looked up. This works only on Linux, because other systems do not
report who listens. Token files of other users are ignored.
"""

from __future__ import annotations

import ipaddress
import json
import os
import stat
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import httpx

from unghost.wire.note import DEFAULT_PORT, note_path, state_folder

DEFAULT_URL: Final = "http://127.0.0.1:8000"

SERVER_VARIABLE: Final = "UNGHOST_SERVER"
"""Environment variable with the address to use instead of `DEFAULT_URL`."""

DEFAULT_DATA: Final = Path("unghost-data")

_ROOT: Final = 0

_MOST_READ: Final = 65_536
"""Characters that are read of a file; a token has fewer than a hundred."""


@dataclass(frozen=True)
class Server:
    """A server's address, and the token for it (None: none was found).

    `token_file` is where the token was found, and `owner` the user whose file it is;
    None if the token was given.
    """

    url: str
    token: str | None
    token_file: Path | None = None
    owner: int | None = None


class BadServerUrl(ValueError):
    """An address that is not http://HOST[:PORT] or https://HOST[:PORT]."""


class ForeignServer(Exception):
    """Another user's program listens at the address, and no token was given for it."""


class IgnoredTokenFile(UserWarning):
    """A token file was not used, because it belongs to another user."""


def find_server(
    url: str | None = None,
    token: str | None = None,
    *,
    environ: Mapping[str, str] | None = None,
) -> Server:
    """The server to connect to, from the arguments, the environment and local files.

    The server is the first of: the argument, `UNGHOST_SERVER`, the one that `unghost
    auth login` stored, `DEFAULT_URL`. The token is the first of: the argument,
    `UNGHOST_TOKEN`, the `token` file in the folder `UNGHOST_DATA`, the token that was
    stored for this server, the file that `unghost serve` noted for this address, the
    `token` file in `./unghost-data`.

    A file is ignored, with the warning IgnoredTokenFile, unless it belongs to the
    caller or to root; root also uses others' files, except the last one, which is only
    a guess. Raises ForeignServer if no token was given and another user listens at the
    address: see `refuse_foreign`.
    """
    env = os.environ if environ is None else environ
    address = _address(url, env)
    secret = token or env.get("UNGHOST_TOKEN")
    if secret:
        return Server(address, secret.strip())
    stored = stored_servers(env).tokens.get(address)
    if stored and not env.get("UNGHOST_DATA"):
        return Server(address, stored)
    server = _local_server(address, env)
    refuse_foreign(server)
    return server


def found_again(server: Server) -> Server | None:
    """The server with another token, if its file has another one by now.

    A server writes the file at its first start, perhaps after `find_server`. None if
    there is no other token, or if this one was given. Raises ForeignServer as
    `find_server` does.
    """
    if server.token is not None and server.token_file is None:
        return None
    renewed = _local_server(server.url, os.environ)
    if renewed.token in (None, server.token):
        return None
    refuse_foreign(renewed)
    return renewed


@dataclass(frozen=True)
class StoredServers:
    """Servers with tokens that `unghost auth login` stored, and the last of them."""

    default: str | None = None
    tokens: Mapping[str, str] = field(default_factory=dict)


def stored_servers(environ: Mapping[str, str]) -> StoredServers:
    """The servers that this user has stored; none if the file is another user's."""
    file = _stored_file(environ)
    text, owner = _text_and_owner(file)
    try:
        stored = json.loads(text) if text and owner in (_caller(), None) else {}
        tokens = {str(url): str(token) for url, token in stored["servers"].items()}
        return StoredServers(stored["default"], tokens)
    except (ValueError, LookupError, TypeError, AttributeError):
        return StoredServers()


def store_servers(environ: Mapping[str, str], stored: StoredServers) -> Path:
    """Write the servers to a file that only this user can read; its path."""
    file = _stored_file(environ)
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    written = file.with_name(f"{file.name}.{os.getpid()}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOFOLLOW", 0)
    content = {"default": stored.default, "servers": dict(stored.tokens)}
    with os.fdopen(os.open(written, flags, 0o600), "w", encoding="utf-8") as opened:
        json.dump(content, opened)
    written.replace(file)
    return file


def _stored_file(environ: Mapping[str, str]) -> Path:
    return state_folder(environ) / "auth.json"


def refuse_foreign(server: Server) -> None:
    """Raise ForeignServer if another user listens, and the token was not given.

    Root may listen: it may run the proxy of a container, or have opened the port for a
    service. Otherwise it must be the owner of the token's file or, without a token, the
    caller.
    """
    file, parsed = server.token_file, httpx.URL(server.url)
    if file is None and (server.token or not is_local(parsed.host)):
        return
    port = parsed.port or DEFAULT_PORT[parsed.scheme]
    owner = _caller() if file is None else server.owner
    foreign = listening_uids(parsed.host, port) - {owner, _ROOT}
    if not foreign:
        return
    why = "this is neither you nor root: nothing was sent"
    if file is not None:
        why = f"{file} belongs to user {owner}: its token was not sent"
    raise ForeignServer(
        f"user {min(foreign)} listens at {server.url}, but {why}. If this is your "
        "server, give the token as UNGHOST_TOKEN; if not, start yours again, on "
        "another port while this one is taken."
    )


def _caller() -> int | None:
    """The user of this process; None on systems whose files have no such owners."""
    return os.geteuid() if hasattr(os, "geteuid") else None


def _address(url: str | None, env: Mapping[str, str]) -> str:
    variable = env.get(SERVER_VARIABLE)
    if url or not variable:
        return _checked(url or stored_servers(env).default or DEFAULT_URL)
    try:
        return _checked(variable)
    except BadServerUrl as exc:
        raise BadServerUrl(f"{SERVER_VARIABLE}: {exc}") from exc


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
    except httpx.InvalidURL as exc:
        raise BadServerUrl(f"{url!r} is not the address of a server: {exc}") from exc
    if parsed.scheme not in DEFAULT_PORT or not parsed.host:
        raise BadServerUrl(
            f"{url!r} is not the address of a server, such as {DEFAULT_URL}"
        )
    return url.rstrip("/")


def _local_server(url: str, env: Mapping[str, str]) -> Server:
    if not is_local(httpx.URL(url).host):
        return Server(url, None)
    caller, files = _caller(), list[Path]()
    if folder := env.get("UNGHOST_DATA"):
        files.append(Path(folder, "token"))
    if noted := _noted_token_file(note_path(url, env)):
        files.append(noted)
    # Only a guess: the server may have been started with another folder.
    guess = DEFAULT_DATA / "token"
    for file in dict.fromkeys([*files, guess]):
        token, owner = _text_and_owner(file)
        is_ours = caller is None or owner in (caller, _ROOT)
        if token and (is_ours or (caller == _ROOT and file in files)):
            return Server(url, token, file, owner)
        if token:
            warnings.warn(
                f"ignored: {file} belongs to user {owner}; if it is the token of your "
                "server, give it as UNGHOST_TOKEN",
                IgnoredTokenFile,
                stacklevel=2,
            )
    return Server(url, None)


def noted_servers(environ: Mapping[str, str]) -> list[str]:
    """The addresses of servers of this user that run on this machine, in order.

    Only those that `unghost serve` or `demo` started and that have noted themselves.
    """
    running = []
    for file in sorted(state_folder(environ).glob("servers/*.json")):
        try:
            text, _ = _text_and_owner(file)
            note = json.loads(text)
            url, pid = note["url"], note["pid"]
            if os.name == "posix":  # elsewhere this would end the process
                os.kill(pid, 0)
        except PermissionError:  # it runs, as another user
            running.append(url)
        except (ValueError, LookupError, TypeError, OSError):
            continue  # no note, or of a server that was killed
        else:
            running.append(url)
    return running


def _text_and_owner(file: Path) -> tuple[str, int]:
    """The text of a small file, and the user who owns it.

    "" and the administrator if it cannot be read: it is absent, or for others.
    """
    # Reading a pipe would wait for its writer.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)
    try:
        with os.fdopen(os.open(file, flags), encoding="utf-8") as opened:
            status = os.fstat(opened.fileno())
            is_file = stat.S_ISREG(status.st_mode)
            text = opened.read(_MOST_READ).strip() if is_file else ""
    except (OSError, UnicodeDecodeError):
        return "", _ROOT
    return text, status.st_uid


def is_local(host: str) -> bool:
    """Whether a host name or address is this machine itself."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _noted_token_file(note: Path) -> Path | None:
    try:
        text, _ = _text_and_owner(note)
        return Path(json.loads(text)["token_file"])
    except (ValueError, LookupError, TypeError):
        return None


_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

_LISTEN: Final = "0A"

_ANY: Final = {4: ipaddress.ip_address("0.0.0.0"), 6: ipaddress.ip_address("::")}

_LOCALHOST: Final = ("127.0.0.1", "::1")

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def listening_uids(host: str, port: int) -> frozenset[int]:
    """The users whose programs a connection to this loopback address could reach.

    Empty if no program listens in this network namespace, and on other systems.
    """
    if sys.platform != "linux":
        return frozenset()
    there = [*_listeners(port)]
    # `localhost` is resolved later, so all of its addresses count.
    names = _LOCALHOST if host == "localhost" else (host,)
    return frozenset(
        uid
        for name in names
        for uid in _reached(_unmapped(ipaddress.ip_address(name)), there)
    )


def _reached(address: Address, there: list[tuple[Address, int]]) -> set[int]:
    own = (address, _ANY[address.version])
    owners = {uid for listening, uid in there if listening in own}
    if not owners and address.version == 4:
        # An IPv6 socket also accepts IPv4 connections that no IPv4 socket accepts.
        owners = {uid for listening, uid in there if listening == _ANY[6]}
    return owners


def _listeners(port: int) -> Iterator[tuple[Address, int]]:
    """The addresses on which programs listen at a port, with their users."""
    for table in _TABLES:
        try:
            lines = table.read_text("ascii").splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            fields = line.split()
            if fields[3] == _LISTEN:
                digits, number = fields[1].split(":")
                if int(number, 16) != port:
                    continue
                # Words of 32 bits, each in the order of bytes of this machine.
                starts = range(0, len(digits), 8)
                words = (int(digits[start : start + 8], 16) for start in starts)
                packed = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
                yield _unmapped(ipaddress.ip_address(packed)), int(fields[7])


def _unmapped(address: Address) -> Address:
    mapped = address.ipv4_mapped if address.version == 6 else None
    return mapped or address
