"""Waits for runs and exports, and downloads the file of an export.

The progress of a job is read from its event stream or, if the stream is not available,
by polling its state. An interrupted download continues where it stopped, and the digest
is checked before the file gets its final name.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Final, Generic, Protocol, TypeAlias, TypeVar

import httpx

from unghost import wire
from unghost.client import errors
from unghost.client.api import export_path, id_of, run_path
from unghost.client.call import Call, JsonReader, read_object, result
from unghost.client.transport import Attempts, Transport

_FIRST_POLL_S: Final = 0.05
_LONGEST_POLL_S: Final = 2.0
MAX_EVENT_BYTES: Final = 1 << 20
"""Longer events are refused: the state of a job has about a kilobyte."""
_CHUNK_BYTES: Final = 1 << 20
_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


class State(Protocol):
    """The state of a job as the server reports it."""

    @property
    def state(self) -> str:
        """A word, "done" after success."""
        ...

    @property
    def finished(self) -> bool:
        """Whether the job has ended: done, failed or cancelled."""

    @property
    def error(self) -> wire.Failure | None:
        """Why it failed; None unless it did."""


StateT = TypeVar("StateT", bound=State)

Progress: TypeAlias = Callable[[StateT], object]


class JobMethods:
    """Methods of the client that wait for runs and exports, and download files."""

    _transport: Transport

    def events(self, run: wire.Run | int) -> Iterator[wire.Run]:
        """Yields a run each time it changes, until it has ended.

        A stream that breaks off is continued after the last received event.
        """
        return self._run(run).events()

    def wait(
        self,
        run: wire.Run | int,
        *,
        progress: Callable[[wire.Run], object] | None = None,
        timeout_s: float | None = None,
    ) -> wire.Run:
        """Wait for a run and return it; `progress` is called with each state before.

        Raises RunFailed if it failed or was cancelled, and TimeoutError if it had not
        ended after `timeout_s`; then it continues on the server.
        """
        return self._run(run).done(progress, timeout_s)

    def export_events(self, export: wire.Export | int) -> Iterator[wire.Export]:
        """Yields an export each time it changes, until it has ended.

        A stream that breaks off is continued after the last received event.
        """
        return self._export(export).events()

    def wait_for_export(
        self,
        export: wire.Export | int,
        *,
        progress: Callable[[wire.Export], object] | None = None,
        timeout_s: float | None = None,
    ) -> wire.Export:
        """The export when it is done; raises as `wait` does for a run."""
        return self._export(export).done(progress, timeout_s)

    def download(
        self,
        export: wire.Export,
        path: str | PathLike[str],
        *,
        progress: Callable[[int, int | None], object] | None = None,
    ) -> Path:
        """Download a finished export to `path`, which is complete or does not exist.

        Called again, an interrupted download continues where it stopped.
        """
        url = export.download or f"{export_path(export)}/download"
        download = _Download(
            self._transport, url, Path(path), export.sha256, export.size_bytes
        )
        return download.fetch(progress or _ignore)

    def _run(self, run: wire.Run | int) -> _Job[wire.Run]:
        run_id = id_of(run)
        name, path = f"run {run_id}", run_path(run_id)
        return _Job(self._transport, name, path, wire.Run)

    def _export(self, export: wire.Export | int) -> _Job[wire.Export]:
        export_id = id_of(export)
        name, path = f"export {export_id}", export_path(export_id)
        return _Job(self._transport, name, path, wire.Export)


@dataclass(frozen=True)
class _Job(Generic[StateT]):
    """A job of the server: its name for people, its path, and the type of its state."""

    transport: Transport
    name: str
    path: str
    kind: JsonReader[StateT]

    def done(
        self, progress: Progress[StateT] | None, timeout_s: float | None
    ) -> StateT:
        """Its state when it is done; RunFailed, TimeoutError."""
        progress = progress or _ignore
        followed = self._followed(progress) if timeout_s is None else None
        ended = followed or self._polled(progress, timeout_s)
        if ended.state != "done":
            raise errors.run_failed(self.name, ended.state, ended.error)
        return ended

    def events(self) -> Iterator[StateT]:
        """Yields its state each time it changes, until it has ended."""
        attempts = Attempts(self.transport.retry)
        last_id = ""
        while True:
            moved_on = False
            try:
                with self.transport.stream(self._stream(last_id)) as response:
                    if response.status_code == httpx.codes.NO_CONTENT:
                        return
                    for name, number, data in _events_of(_lines_of(response)):
                        if name == "end":
                            return
                        last_id, moved_on = number, True
                        state = json.loads(data)
                        yield read_object(self.kind.read, state, response)
                    raise httpx.RemoteProtocolError("the events have no end")
            except errors.Unavailable as error:
                wait_s = attempts.failed(error, moved_on=moved_on)
                if not self.transport.pause(wait_s):
                    raise

    def _stream(self, last_id: str) -> Call[httpx.Response]:
        """The events after the one with this id; all if the id is empty."""
        headers = {"Accept": "text/event-stream"}
        if last_id:
            headers["Last-Event-ID"] = last_id
        return Call("GET", f"{self.path}/events", _as_received, headers=headers)

    def _followed(self, progress: Progress[StateT]) -> StateT | None:
        """Its final state from its event stream; None if there is no stream."""
        try:
            for state in self.events():
                progress(state)
                if state.finished:
                    return state
        except (errors.BadRequest, errors.NotFound, errors.Unavailable) as error:
            if isinstance(error, errors.NoResponse) and not error.sent:
                raise  # the server is away, and has been waited for
            # No such stream, too many streams, or a proxy that buffers it: poll.
            return None
        return None

    def _polled(self, progress: Progress[StateT], timeout_s: float | None) -> StateT:
        """Request the state, at growing intervals, until the job has ended."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause_s = _FIRST_POLL_S
        call = Call("GET", self.path, result(self.kind))
        while True:
            state = self.transport.send(call)
            progress(state)
            if state.finished:
                return state
            if deadline is not None and time.monotonic() + pause_s > deadline:
                raise TimeoutError(f"not finished after {timeout_s:g} s")
            self.transport.pause(pause_s)
            pause_s = min(_LONGEST_POLL_S, pause_s * 1.5)


def _lines_of(response: httpx.Response) -> Iterator[str]:
    """The lines of a stream of events; UnexpectedAnswer if an event is too long."""
    rest, size = b"", 0
    for piece in response.iter_raw():
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            size = size + len(line) if line.strip() else 0
            yield line.decode("utf-8", "replace").removesuffix("\r")
        if size + len(rest) > MAX_EVENT_BYTES:
            raise errors.unexpected(
                response, f"has an event of more than {MAX_EVENT_BYTES} bytes"
            )


def _events_of(lines: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    """The name, id and data of the events in the lines of a stream.

    The id is the `Last-Event-ID` to continue after it. One without its empty line is
    incomplete. Only the fields that the server sends are parsed.
    """
    name, number, data = "message", "", list[str]()
    for line in lines:
        if not line:
            if data:
                yield name, number, "\n".join(data)
            name, data = "message", []
            continue
        key, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if key == "event":
            name = value
        elif key == "id":
            number = value
        elif key == "data":
            data.append(value)


@dataclass(frozen=True)
class _Download:
    """A file to download: its URL, its path, its size and digest (None: unknown)."""

    transport: Transport
    url: str
    path: Path
    sha256: str | None
    size_bytes: int | None

    @property
    def partial(self) -> Path:
        """The temporary file in the same folder; its name depends on the content."""
        mark = (self.sha256 or "unknown")[:12]
        return self.path.with_name(f"{self.path.name}.{mark}.part")

    def fetch(self, progress: Callable[[int, int | None], object]) -> Path:
        """Download the file; `path` is complete or does not exist.

        An interrupted download continues where it stopped; it fails when a retry
        brings no more bytes.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        attempts = Attempts(self.transport.retry)
        while True:
            before = self._bytes_there()
            try:
                self._continue(progress)
                break
            except errors.Unavailable as error:
                moved_on = self._bytes_there() > before
                wait_s = attempts.failed(error, moved_on=moved_on)
                if not self.transport.pause(wait_s):
                    raise
        if self.sha256 is not None:
            digest = hashlib.sha256()
            with self.partial.open("rb") as file:
                while chunk := file.read(_CHUNK_BYTES):
                    digest.update(chunk)
            if digest.hexdigest() != self.sha256:
                self.partial.unlink()
                raise errors.DamagedDownload(
                    f"{self.path.name}: got SHA-256 {digest.hexdigest()}, "
                    f"expected {self.sha256}; the download was dropped, fetch it again"
                )
        self.partial.replace(self.path)
        return self.path

    def _bytes_there(self) -> int:
        # Without a digest, the rest may not belong to the bytes already downloaded.
        if self.sha256 is None:
            return 0
        try:
            status = self.partial.lstat()
        except FileNotFoundError:
            return 0
        have = status.st_size if _is_only_ours(status) else 0
        return have if self.size_bytes is None or have <= self.size_bytes else 0

    def _continue(self, progress: Callable[[int, int | None], object]) -> None:
        have = self._bytes_there()
        if have and have == self.size_bytes:
            return
        headers = {"Range": f"bytes={have}-"} if have else {}
        call = Call("GET", self.url, _as_received, headers=headers)
        with self.transport.stream(call) as response:
            is_rest = response.status_code == httpx.codes.PARTIAL_CONTENT
            with self._open(resumed=have > 0 and is_rest) as file:
                for chunk in response.iter_raw():
                    file.write(chunk)
                    progress(file.tell(), self.size_bytes)
                file.flush()
                os.fsync(file.fileno())

    def _open(self, *, resumed: bool) -> IO[bytes]:
        """The temporary file, to append to it; a new one unless `resumed`.

        Others who may write into the folder can know its name, and lay a link there. So
        what is there is removed, or continued only if it is a file of ours alone.
        """
        flags = os.O_WRONLY | os.O_APPEND | _NO_LINK
        if not resumed:
            self.partial.unlink(missing_ok=True)
            flags |= os.O_CREAT | os.O_EXCL
        file = os.fdopen(os.open(self.partial, flags, 0o666), "ab")
        if resumed and not _is_only_ours(os.fstat(file.fileno())):
            file.close()
            raise PermissionError(f"{self.partial} was replaced by another program")
        return file


def _is_only_ours(status: os.stat_result) -> bool:
    """Whether this is a regular file of this user, without a second name."""
    is_mine = not hasattr(os, "geteuid") or status.st_uid == os.geteuid()
    return stat.S_ISREG(status.st_mode) and status.st_nlink == 1 and is_mine


def _as_received(response: httpx.Response) -> httpx.Response:
    """The response as it was received: the caller reads its stream."""
    return response


def _ignore(*_: object) -> None:
    """Ignore the progress."""
