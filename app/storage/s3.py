"""A blob store in a bucket of Amazon S3, or of a server with the same API.

S3 guarantees that a put is durable when it returns, and that a blob is never partly
visible. So nothing has to be renamed or flushed.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import S3Store

from app.errors import AppError, DamagedFile, StorageAway, TryLater
from app.logs import error_log
from app.storage import base
from app.storage.durable import make_folder

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig, S3Config

MAX_PARALLEL: Final = 16
"""Maximum number of concurrent puts, and of other concurrent requests."""
SMALL_BYTES: Final = 2 * base.PIECE
"""Blobs up to this size are read once: they are verified and sent from memory."""
PART_BYTES: Final = 8 * 1024**2
"""Bytes of each part of an export; five parts are in memory while it is put."""
CLOCK_STEP_S: Final = 1.0
"""S3 rounds times down to whole seconds."""
YOUNG: Final = 12
"""Minimum age at which blobs are removed, as a multiple of `trust_s`: an hour.

Clocks differ by less: S3 refuses requests whose clock is off by more than a quarter of
an hour.
"""
MOST_TRUSTED: Final = 20_000
_READY: Final = "ready"
"""The key that `check` tries to create; it exists from the first time on."""
_BLOB: Final = re.compile(r"[0-9a-f]{2}/([0-9a-f]{64})")


class S3Drafts(base.Drafts):
    """Blobs that are being sent to the bucket."""

    def __init__(self) -> None:
        self.puts: list[Future[None]] = []


class S3Storage(base.BlobStore):
    """A `BlobStore` in a bucket; keys are the same as paths in a folder."""

    def __init__(self, place: S3Place, local: Path) -> None:
        self._store = retrying_client(place)
        self._probe = _opened(place, min(PROBE_S, place.timeout_s), 1)
        self._local = local
        self._patience_s = 2 * place.timeout_s
        self._recent = _RecentBlobs(place.trust_s)
        # Two pools: garbage collection sends requests while it holds the turn to write,
        # and must not wait for puts.
        self._puts = ThreadPoolExecutor(MAX_PARALLEL, "s3-puts")
        self._asks = ThreadPoolExecutor(MAX_PARALLEL, "s3-asks")
        self._slots = threading.BoundedSemaphore(MAX_PARALLEL)

    def prepare(self) -> None:
        """Check that blobs can be put and listed; create the local folder."""
        self.check()
        with translated():
            next(self._probe.list(chunk_size=1), None)
        make_folder(self._local)

    def check(self) -> None:
        """Try to create a key, which needs the same permissions as `put`.

        It exists after the first time, so a bucket with versioning does not fill up.
        """
        with suppress(AlreadyExistsError), translated():
            self._probe.put(_READY, b"ready?", mode="create")

    def draft(self, blobs: Mapping[str, bytes]) -> S3Drafts:
        """Start putting blobs; waits while `MAX_PARALLEL` others are being put.

        This limits the number of blobs in memory if the store is slow. An existing blob
        is put again, since only its time shows that it is in use.
        """
        drafts = S3Drafts()
        try:
            for digest, data in blobs.items():
                if not self._slots.acquire(timeout=self._patience_s):
                    raise StorageAway("too many blobs wait")
                try:
                    put = self._puts.submit(self._put, digest, data)
                except BaseException:
                    self._slots.release()
                    raise
                put.add_done_callback(lambda _: self._slots.release())
                drafts.puts.append(put)
        except BaseException:
            self.discard([drafts])
            raise
        return drafts

    def settle(self, many: Sequence[base.Drafts]) -> None:
        """Return when all blobs of these drafts are in the bucket."""
        for put in _puts_of(many):
            put.result()

    def discard(self, many: Sequence[base.Drafts]) -> None:
        """Cancel puts that have not begun; garbage collection removes the others."""
        for put in _puts_of(many):
            put.cancel()

    def read(self, digest: str) -> bytes:
        try:
            with translated(absent=True):
                content = self._store.get(base.place_of(digest)).bytes().to_bytes()
        except FileNotFoundError:
            raise self._missing(digest) from None
        if base.sha256_of(content) != digest:
            raise DamagedFile(digest, "has changed since it was stored")
        return content

    def open(self, digest: str, *, size_bytes: int | None) -> base.StoredBlob:
        file = self._find(digest)
        if file is None:
            raise self._missing(digest)
        if size_bytes is not None and file.size_bytes != size_bytes:
            raise _wrong_size(digest, file.size_bytes, size_bytes)

        def part(first: int, end: int) -> bytes:
            try:
                with translated(absent=True):
                    read = self._store.get_range(
                        base.place_of(digest), start=first, end=end
                    )
            except FileNotFoundError:
                raise self._missing(digest) from None
            if len(read) != end - first:
                raise DamagedFile(digest, "is truncated")
            return read.to_bytes()

        return base.StoredBlob(file.size_bytes, part)

    def open_verified(self, digest: str, *, size_bytes: int | None) -> base.StoredBlob:
        if size_bytes is not None and size_bytes <= SMALL_BYTES:
            content = self.read(digest)
            if len(content) != size_bytes:
                raise _wrong_size(digest, len(content), size_bytes)
            return base.StoredBlob(size_bytes, lambda first, end: content[first:end])
        blob = self.open(digest, size_bytes=size_bytes)
        if blob.digest() != digest:
            raise DamagedFile(digest, "has changed since it was stored")
        return blob

    def require(self, digests: Iterable[str]) -> None:
        """Raise `BlobsUncertain` for those not put or found recently by this process.

        The others are too young to be removed.
        """
        uncertain = [digest for digest in digests if digest not in self._recent]
        if uncertain:
            raise base.BlobsUncertain(uncertain)

    def make_sure(self, digests: Iterable[str]) -> None:
        """Look up blobs; raises TryLater if one was removed since it was put."""
        digest_list, begun = list(digests), time.monotonic()
        if not all(self._asks.map(self._find, digest_list)):
            raise TryLater("a file was deleted meanwhile; send the frame again")
        for digest in digest_list:
            self._recent.add(digest, begun)

    def put_missing(self, blobs: Mapping[str, bytes]) -> None:
        files = zip(blobs, self._asks.map(self._find, blobs), strict=True)
        sizes = {digest: file.size_bytes for digest, file in files if file}
        lost = {
            digest: data
            for digest, data in blobs.items()
            if sizes.get(digest) != len(data)
        }
        if lost:
            self.put(lost)

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        """Remove blobs that were not put since a time; returns sizes of removed ones.

        Young ones always stay, since `require` does not look them up.
        """
        young_s = YOUNG * self._recent.trust_s
        until = min(unused_since, time.time() - young_s) if young_s else unused_since
        take = partial(self._remove, until=until)
        sizes = zip(digests, self._asks.map(take, digests), strict=True)
        return {digest: size for digest, size in sizes if size is not None}

    def adopt(self, file: Path) -> str:
        """Put a file, in parts if it is large, and delete it; returns its digest."""
        digest = base.digest_of(file)
        with translated():
            self._store.put(
                base.place_of(digest), file, chunk_size=PART_BYTES, max_concurrency=4
            )
        file.unlink()
        return digest

    def files(self) -> Iterator[base.StoredFile]:
        """All blobs below the prefix, in the order of their keys."""
        with translated():
            for some in self._store.list(chunk_size=1000):
                for entry in some:
                    blob = _BLOB.fullmatch(entry["path"])
                    if blob is not None:
                        changed_at = entry["last_modified"].timestamp()
                        yield base.StoredFile(blob[1], entry["size"], changed_at)

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        """Unfinished exports on this machine, each with the time of its last change."""
        return base.leftovers(self._local)

    def temporary_folder(self) -> Path:
        """A local folder in which exports are written before they are put."""
        folder = self._local / "tmp"
        make_folder(folder)
        return folder

    def close(self) -> None:
        """Let each thread end after its current request."""
        self._puts.shutdown(wait=False, cancel_futures=True)
        self._asks.shutdown(wait=False, cancel_futures=True)

    def _put(self, digest: str, data: bytes) -> None:
        key, begun = base.place_of(digest), time.monotonic()
        try:
            with translated():
                self._store.put(key, data, mode="create")
        except AlreadyExistsError:
            # Another process may be removing the existing blob: see `BlobsUncertain`.
            with translated():
                self._store.put(key, data, use_multipart=False)
        else:
            self._recent.add(digest, begun)

    def _find(self, digest: str) -> base.StoredFile | None:
        try:
            with translated(absent=True):
                entry = self._store.head(base.place_of(digest))
        except FileNotFoundError:
            return None
        changed_at = entry["last_modified"].timestamp()
        return base.StoredFile(digest, entry["size"], changed_at)

    def _remove(self, digest: str, *, until: float) -> int | None:
        file = self._find(digest)
        if file is None or file.modified_at + CLOCK_STEP_S > until:
            return None
        self._recent.discard(digest)
        with suppress(FileNotFoundError), translated(absent=True):
            self._store.delete(base.place_of(digest))
        return file.size_bytes

    def _missing(self, digest: str) -> AppError:
        """The error for a missing blob: StorageAway if the whole bucket is missing."""
        try:
            with translated():
                next(self._probe.list(chunk_size=1), None)
        except StorageAway as exc:
            return exc
        return DamagedFile(digest, "is missing")


class _RecentBlobs:
    """Digests of blobs that this process has put or found within `trust_s` seconds."""

    def __init__(self, trust_s: float) -> None:
        self.trust_s = trust_s
        self._at: dict[str, float] = {}
        self._lock = threading.Lock()

    def add(self, digest: str, begun: float) -> None:
        """Add a blob; the request for it was sent at `begun`, by `time.monotonic`."""
        with self._lock:
            self._at.pop(digest, None)
            self._at[digest] = begun
            while len(self._at) > MOST_TRUSTED:
                del self._at[next(iter(self._at))]

    def discard(self, digest: str) -> None:
        """Remove a blob that no longer exists."""
        with self._lock:
            self._at.pop(digest, None)

    def __contains__(self, digest: str) -> bool:
        with self._lock:
            begun = self._at.get(digest)
        return begun is not None and time.monotonic() - begun < self.trust_s


def _puts_of(many: Sequence[base.Drafts]) -> Iterator[Future[None]]:
    for drafts in many:
        if not isinstance(drafts, S3Drafts):
            raise TypeError(f"drafts of another store: {drafts!r}")
        yield from drafts.puts


def _wrong_size(digest: str, size: int, size_bytes: int) -> DamagedFile:
    return DamagedFile(digest, f"has {size} of {size_bytes} bytes")


CONNECT_S: Final = 3
PROBE_S: Final = 5.0
"""Timeout of a request that only checks whether the store responds."""
MOST_RETRIES: Final = 4
TRUST_S: Final = 300.0
"""How long a blob that was put or found is assumed to exist without a request."""
NO_BUCKET: Final = "NoSuchBucket"
NO_KEYS: Final = "NoKeys"
_ROLES: Final = "169.254.169.254"
_CODE: Final = re.compile(r"<Code>(\w{1,64})</Code>")


@dataclass(frozen=True)
class S3Place:
    """The address of a bucket, the prefix of its keys, and its timeouts.

    The `prefix` may be empty. An `endpoint` without TLS needs `plain`. Without a
    `region`, that of the environment is used. `timeout_s` limits each attempt, and the
    time for starting retries.
    """

    bucket: str
    prefix: str
    endpoint: str
    region: str | None
    plain: bool
    timeout_s: float
    trust_s: float = TRUST_S


def retrying_client(place: S3Place) -> S3Store:
    """A client that retries failed requests."""
    return _opened(place, place.timeout_s, MOST_RETRIES)


def _opened(place: S3Place, timeout_s: float, retries: int) -> S3Store:
    patience = timedelta(seconds=timeout_s)
    config: S3Config = {"endpoint": place.endpoint}
    if place.region is not None:
        config["region"] = place.region
    client: ClientConfig = {
        "allow_http": place.plain,
        "connect_timeout": f"{CONNECT_S}s",
        "timeout": f"{round(timeout_s * 1000)}ms",
    }
    retry: RetryConfig = {"max_retries": retries, "retry_timeout": patience}
    return S3Store(
        place.bucket,
        prefix=place.prefix or None,
        config=config,
        client_options=client,
        retry_config=retry,
    )


@contextmanager
def translated(*, absent: bool = False) -> Iterator[None]:
    """Raise errors of the library as StorageAway.

    AlreadyExistsError is passed on, and with `absent` also FileNotFoundError, unless
    the bucket itself is missing. The library's texts are not passed on: they quote
    responses of the server, which may quote headers of the request.
    """
    try:
        yield
    except AlreadyExistsError:
        raise
    except FileNotFoundError as exc:
        if absent and _reason(exc) != NO_BUCKET:
            raise
        raise _away(NO_BUCKET) from None
    except BaseError as exc:
        raise _away(_reason(exc)) from None


def _away(reason: str) -> StorageAway:
    error_log.warning("the storage of the files does not respond: %s", reason)
    return StorageAway(reason)


def _reason(exc: Exception) -> str:
    """The code of S3's error, else the kind of failure."""
    text = str(exc)
    code = _CODE.search(text)
    if code:
        return code[1]
    # Without keys in the environment, the library requests those of the machine's role.
    return NO_KEYS if _ROLES in text else type(exc).__name__
