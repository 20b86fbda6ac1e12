"""A bucket of blobs: on Amazon's S3, or on a server that speaks as it does.

A put that returned is durable, and a blob is never half there: both are promises of
S3. Nothing is renamed and nothing is flushed.
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

from app.addresses import Bucket
from app.errors import AppError, DamagedFile, StorageAway, TryLater
from app.logs import error_log
from app.storage.base import (
    PIECE,
    Blob,
    Drafts,
    StoredFile,
    Unsure,
    digest_of,
    leftovers,
    place_of,
    sha256_of,
)
from app.storage.durable import make_folder

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig, S3Config

TOGETHER: Final = 16
"""Blobs that are put, and questions that are asked, at the same time."""
HELD: Final = 2 * PIECE
"""Blobs of up to so many bytes are read once, compared and sent from memory."""
PART: Final = 8 * 1024**2
"""Bytes of each part of an export; five are held while it is put."""
CLOCK_S: Final = 1.0
"""Times of S3 are whole seconds, rounded down."""
YOUNG: Final = 12
"""Blobs are not taken away before so many times that: clocks differ by less.

S3 refuses requests of clocks that are more than a quarter of an hour off.
"""
MOST_TRUSTED: Final = 20_000
_READY: Final = "ready"
"""A key of no use: it is made once, and then only tried to be made."""
_BLOB: Final = re.compile(r"[0-9a-f]{2}/([0-9a-f]{64})")


@dataclass(frozen=True)
class S3Drafts(Drafts):
    """Blobs on their way to the bucket."""

    puts: list[Future[None]]


class S3Storage:
    """Blobs in a bucket, each under the first two letters of its digest."""

    def __init__(self, place: S3Place, local: Path) -> None:
        self._store, self._probe = patient(place), brief(place)
        self._local = local
        self._patience_s = 2 * place.timeout_s
        self._made = _LatelyMade(place.trust_s)
        # Two pools: who clears away asks in a writer's turn, and never waits for puts.
        self._puts = ThreadPoolExecutor(TOGETHER, "s3-puts")
        self._asks = ThreadPoolExecutor(TOGETHER, "s3-asks")
        self._slots = threading.BoundedSemaphore(TOGETHER)

    def prepare(self) -> None:
        """Find out whether blobs can be put and listed; make the local folder."""
        self.check()
        with answers():
            next(self._probe.list(chunk_size=1), None)
        make_folder(self._local)

    def check(self) -> None:
        """Put a key of no use, unless it is there: which takes the same rights.

        A bucket that keeps versions does not fill with it.
        """
        with suppress(AlreadyExistsError), answers():
            self._probe.put(_READY, b"ready?", mode="create")

    def put(self, blobs: Mapping[str, bytes]) -> None:
        """Store blobs by their digests, at the same time; then they are durable.

        What is there is put again: its time is the only note that it is in use.
        """
        self.settle([self.draft(blobs)])

    def draft(self, blobs: Mapping[str, bytes]) -> S3Drafts:
        """Begin to put blobs; waits while many others are on their way.

        So no more than some blobs are held, however slow the store is.
        """
        drafts = S3Drafts([])
        try:
            for digest, data in blobs.items():
                drafts.puts.append(self._begin(digest, data))
        except BaseException:
            self.discard([drafts])
            raise
        return drafts

    def settle(self, many: Sequence[Drafts]) -> None:
        """Return when all blobs of drafts are in the bucket."""
        for put in _puts_of(many):
            put.result()

    def discard(self, many: Sequence[Drafts]) -> None:
        """Give up what did not begin yet; the rest belongs to nothing, until `gc`."""
        for put in _puts_of(many):
            put.cancel()

    def read(self, digest: str) -> bytes:
        """A blob's bytes; DamagedFile if it is gone, or not what was stored."""
        try:
            with answers(absent=True):
                content = self._store.get(place_of(digest)).bytes().to_bytes()
        except FileNotFoundError:
            raise self._gone(digest) from None
        if sha256_of(content) != digest:
            raise DamagedFile(digest, "is not what was stored")
        return content

    def whole(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob to read from; DamagedFile if it is gone or of another size."""
        found = self._find(digest)
        if found is None:
            raise self._gone(digest)
        if size_bytes is not None and found.size_bytes != size_bytes:
            raise _wrong_size(digest, found.size_bytes, size_bytes)
        return Blob(found.size_bytes, partial(self._part, digest))

    def intact(self, digest: str, *, size_bytes: int | None) -> Blob:
        """A blob whose content is what was stored; else DamagedFile."""
        if size_bytes is not None and size_bytes <= HELD:
            content = self.read(digest)
            if len(content) != size_bytes:
                raise _wrong_size(digest, len(content), size_bytes)
            return Blob(size_bytes, lambda first, end: content[first:end])
        blob = self.whole(digest, size_bytes=size_bytes)
        if blob.digest() != digest:
            raise DamagedFile(digest, "is not what was stored")
        return blob

    def require(self, digests: Iterable[str]) -> None:
        """Unsure of blobs that this process has not made or found lately.

        Of the others nothing is asked: nobody takes away what is so young.
        """
        unsure = [digest for digest in digests if digest not in self._made]
        if unsure:
            raise Unsure(unsure)

    def make_sure(self, digests: Iterable[str]) -> None:
        """TryLater if a blob is gone since it was put; sent again, it is put again."""
        asked, begun = list(digests), time.monotonic()
        if not all(self._asks.map(self._find, asked)):
            raise TryLater("a file was cleared away meanwhile; send the frame again")
        for digest in asked:
            self._made.add(digest, begun)

    def mend(self, blobs: Mapping[str, bytes]) -> None:
        """Put those of stored blobs again that are gone, or of another size."""
        found = zip(blobs, self._asks.map(self._find, blobs), strict=True)
        sizes = {digest: file.size_bytes for digest, file in found if file}
        lost = {
            digest: data
            for digest, data in blobs.items()
            if sizes.get(digest) != len(data)
        }
        if lost:
            self.put(lost)

    def remove(self, digests: Sequence[str], *, unused_since: float) -> dict[str, int]:
        """Take blobs away but for those put since; sizes of those that were taken.

        Those that are young stay in any case: some of them are not asked for.
        """
        young_s = YOUNG * self._made.trust_s
        until = min(unused_since, time.time() - young_s) if young_s else unused_since
        take = partial(self._remove, until=until)
        sizes = zip(digests, self._asks.map(take, digests), strict=True)
        return {digest: size for digest, size in sizes if size is not None}

    def adopt(self, file: Path) -> str:
        """Put a finished file, in parts if it is large, and take it from its folder."""
        digest = digest_of(file)
        with answers():
            self._store.put(place_of(digest), file, chunk_size=PART, max_concurrency=4)
        file.unlink()
        return digest

    def files(self) -> Iterator[StoredFile]:
        """Every blob below the prefix, in the order of its key."""
        with answers():
            for some in self._store.list(chunk_size=1000):
                for found in some:
                    blob = _BLOB.fullmatch(found["path"])
                    if blob is not None:
                        changed_at = found["last_modified"].timestamp()
                        yield StoredFile(blob[1], found["size"], changed_at)

    def leftovers(self) -> Iterator[tuple[Path, float]]:
        """Half exports on this machine, each with the time of its last change."""
        return leftovers(self._local)

    def temporary_folder(self) -> Path:
        """Where exports are written before they are put."""
        folder = self._local / "tmp"
        make_folder(folder)
        return folder

    def close(self) -> None:
        """Let the threads end, each when what it does is over."""
        self._puts.shutdown(wait=False, cancel_futures=True)
        self._asks.shutdown(wait=False, cancel_futures=True)

    def _begin(self, digest: str, data: bytes) -> Future[None]:
        if not self._slots.acquire(timeout=self._patience_s):
            raise StorageAway("too many blobs wait")
        try:
            put = self._puts.submit(self._put, digest, data)
        except BaseException:
            self._slots.release()
            raise
        put.add_done_callback(lambda _: self._slots.release())
        return put

    def _put(self, digest: str, data: bytes) -> None:
        key, begun = place_of(digest), time.monotonic()
        try:
            with answers():
                self._store.put(key, data, mode="create")
        except AlreadyExistsError:
            # Somebody may be about to take the old one away: see `Unsure`.
            with answers():
                self._store.put(key, data, use_multipart=False)
        else:
            self._made.add(digest, begun)

    def _part(self, digest: str, first: int, end: int) -> bytes:
        try:
            with answers(absent=True):
                part = self._store.get_range(place_of(digest), start=first, end=end)
        except FileNotFoundError:
            raise self._gone(digest) from None
        if len(part) != end - first:
            raise DamagedFile(digest, "was cut short")
        return part.to_bytes()

    def _find(self, digest: str) -> StoredFile | None:
        try:
            with answers(absent=True):
                found = self._store.head(place_of(digest))
        except FileNotFoundError:
            return None
        return StoredFile(digest, found["size"], found["last_modified"].timestamp())

    def _remove(self, digest: str, *, until: float) -> int | None:
        found = self._find(digest)
        if found is None or found.modified_at + CLOCK_S > until:
            return None
        self._made.discard(digest)
        with suppress(FileNotFoundError), answers(absent=True):
            self._store.delete(place_of(digest))
        return found.size_bytes

    def _gone(self, digest: str) -> AppError:
        """A blob is missing; or the whole bucket, which is not the blob's fault."""
        try:
            with answers():
                next(self._probe.list(chunk_size=1), None)
        except StorageAway as exc:
            return exc
        return DamagedFile(digest, "is missing")


class _LatelyMade:
    """Digests of blobs that this process has made, or made sure of."""

    def __init__(self, trust_s: float) -> None:
        self.trust_s = trust_s
        self._at: dict[str, float] = {}
        self._lock = threading.Lock()

    def add(self, digest: str, begun: float) -> None:
        """It was made, or found, after `begun`, a time of `time.monotonic`."""
        with self._lock:
            self._at.pop(digest, None)
            self._at[digest] = begun
            while len(self._at) > MOST_TRUSTED:
                del self._at[next(iter(self._at))]

    def discard(self, digest: str) -> None:
        """It is not there any more."""
        with self._lock:
            self._at.pop(digest, None)

    def __contains__(self, digest: str) -> bool:
        with self._lock:
            begun = self._at.get(digest)
        return begun is not None and time.monotonic() - begun < self.trust_s


def _puts_of(many: Sequence[Drafts]) -> Iterator[Future[None]]:
    for drafts in many:
        if not isinstance(drafts, S3Drafts):
            raise TypeError(f"drafts of another store: {drafts!r}")
        yield from drafts.puts


def _wrong_size(digest: str, found: int, size_bytes: int) -> DamagedFile:
    return DamagedFile(digest, f"has {found} of {size_bytes} bytes")


CONNECT_S: Final = 3
PROBE_S: Final = 5.0
"""How long one try to find out whether the store is there takes at most."""
MOST_RETRIES: Final = 4
TRUST_S: Final = 300.0
"""How long a blob that was made or found here is taken to be there without asking."""
NO_BUCKET: Final = "NoSuchBucket"
NO_KEYS: Final = "NoKeys"
_ROLES: Final = "169.254.169.254"
_CODE: Final = re.compile(r"<Code>(\w{1,64})</Code>")


@dataclass(frozen=True)
class S3Place:
    """Where a bucket is, and how patiently it is asked.

    An `endpoint` without TLS needs `plain`; no `region` is the one of the environment.
    `timeout_s` limits one try, and the time after which no other one begins.
    """

    bucket: Bucket
    endpoint: str
    region: str | None
    plain: bool
    timeout_s: float
    trust_s: float = TRUST_S


def patient(place: S3Place) -> S3Store:
    """A client that tries again."""
    return _opened(place, place.timeout_s, MOST_RETRIES)


def brief(place: S3Place) -> S3Store:
    """A client that answers or fails soon, to find out whether the store is there."""
    return _opened(place, min(PROBE_S, place.timeout_s), 1)


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
        place.bucket.name,
        prefix=place.bucket.prefix or None,
        config=config,
        client_options=client,
        retry_config=retry,
    )


@contextmanager
def answers(*, absent: bool = False) -> Iterator[None]:
    """Say in the service's words that the store does not do what was asked.

    With `absent` a FileNotFoundError is passed on, unless it is the bucket that is
    missing; AlreadyExistsError always is. What the library says is passed on nowhere:
    it quotes answers of the server, and those may quote headers of the request.
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
    error_log.warning("the store of the files does not answer: %s", reason)
    return StorageAway(reason)


def _reason(exc: Exception) -> str:
    """What S3 calls it, else what kind of failure it is."""
    text = str(exc)
    code = _CODE.search(text)
    if code:
        return code[1]
    # Without keys in the environment, the role of the machine is asked for some.
    return NO_KEYS if _ROLES in text else type(exc).__name__
