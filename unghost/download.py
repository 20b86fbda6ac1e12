"""One file from the server to a path: resumed if interrupted, checked, then renamed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import httpx

from unghost.errors import DamagedDownload, Unavailable
from unghost.retry import PATIENCE
from unghost.transport import Call, Transport

Progress = Callable[[int, "int | None"], object]
_CHUNK_BYTES: Final = 1 << 20
_PARTIAL_CONTENT: Final = 206


@dataclass(frozen=True)
class Download:
    """What to fetch, where to, and what it must be (None: not known)."""

    url: str
    path: Path
    sha256: str | None
    size_bytes: int | None

    @property
    def partial(self) -> Path:
        """The temporary file beside `path`; another content has another name."""
        mark = (self.sha256 or "unknown")[:12]
        return self.path.with_name(f"{self.path.name}.{mark}.part")


def fetch(
    transport: Transport, wanted: Download, progress: Progress | None = None
) -> Path:
    """Download to `wanted.path`; the file there appears whole or not at all.

    Broken off, it goes on where it stopped; it gives up when no more bytes come.
    """
    wanted.path.parent.mkdir(parents=True, exist_ok=True)
    attempt = 1
    while True:
        before = _bytes_there(wanted)
        try:
            _continue(transport, wanted, progress)
            break
        except (httpx.TransportError, Unavailable) as error:
            attempt = attempt if _bytes_there(wanted) <= before else 1
            if transport.closed or attempt >= PATIENCE * transport.retry.attempts:
                raise
            asked = error.retry_after_s if isinstance(error, Unavailable) else None
            transport.pause(transport.retry.delay_s(attempt, asked))
            attempt += 1
    _check(wanted)
    wanted.partial.replace(wanted.path)
    return wanted.path


def _bytes_there(wanted: Download) -> int:
    # Without a digest nothing proves that the rest would belong to what is there.
    if wanted.sha256 is None or not wanted.partial.exists():
        return 0
    have = wanted.partial.stat().st_size
    return have if wanted.size_bytes is None or have <= wanted.size_bytes else 0


def _continue(
    transport: Transport, wanted: Download, progress: Progress | None
) -> None:
    have = _bytes_there(wanted)
    if have and have == wanted.size_bytes:
        return
    headers = {"Accept-Encoding": "identity"}
    if have:
        headers["Range"] = f"bytes={have}-"
    call = Call("GET", wanted.url, headers=headers)
    with transport.stream(call) as response:
        resumed = response.status_code == _PARTIAL_CONTENT
        with wanted.partial.open("ab" if resumed else "wb") as file:
            total = wanted.size_bytes
            _copy(response, file, lambda done: progress and progress(done, total))
            file.flush()
            os.fsync(file.fileno())


def _copy(
    response: httpx.Response, file: BinaryIO, copied: Callable[[int], object]
) -> None:
    for chunk in response.iter_raw():
        file.write(chunk)
        copied(file.tell())


def _check(wanted: Download) -> None:
    if wanted.sha256 is None:
        return
    digest = hashlib.sha256()
    with wanted.partial.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    if digest.hexdigest() != wanted.sha256:
        wanted.partial.unlink()
        raise DamagedDownload(
            f"{wanted.path.name}: got SHA-256 {digest.hexdigest()}, "
            f"expected {wanted.sha256}; the download was dropped, fetch it again"
        )
