"""What every blob store has to do, tested with a folder and with an S3 bucket."""

import random
import time
from pathlib import Path

import pytest

from app.errors import DamagedFile, TryLater
from app.storage.base import PIECE, BlobStore, Drafts, sha256_of
from app.storage.folder import FolderStorage
from app.storage.s3 import S3Storage
from tests.support.s3_server import TestBucket

CONTENT = b"an image"
DIGEST = sha256_of(CONTENT)
OTHER = b"a segmentation"
LARGE = random.Random(7).randbytes(2 * PIECE + 12_345)


class DamageableStore:
    """A store, and methods that damage its files without its knowledge."""

    def __init__(self, folder: Path, bucket: TestBucket | None) -> None:
        self._bucket, self._blobs = bucket, folder / "blobs"
        self.store: BlobStore = FolderStorage(self._blobs)
        if bucket is not None:
            # It does not trust that blobs it has put itself still exist.
            self.store = S3Storage(bucket.place(trust_s=0), self._blobs)
        self.store.prepare()

    def overwrite(self, digest: str, content: bytes) -> None:
        if self._bucket:
            self._bucket.overwrite(digest, content)
        else:
            (self._blobs / digest[:2] / digest).write_bytes(content)

    def lose(self, digest: str) -> None:
        if self._bucket:
            self._bucket.delete(digest)
        else:
            (self._blobs / digest[:2] / digest).unlink()


@pytest.fixture(params=["folder", "s3"])
def place(request, tmp_path):
    bucket = None
    if request.param == "s3":
        bucket = request.getfixturevalue("s3").bucket()
    opened = DamageableStore(tmp_path / "data", bucket)
    yield opened
    opened.store.close()


@pytest.fixture
def store(place):
    return place.store


def stored_sizes(store):
    return {file.digest: file.size_bytes for file in store.files()}


def test_blob_stored_twice_is_read_and_listed_once_with_its_time(store):
    begun = time.time()
    for _ in range(2):
        store.put({DIGEST: CONTENT, sha256_of(OTHER): OTHER})

    assert (store.read(DIGEST), store.read(sha256_of(OTHER))) == (CONTENT, OTHER)
    files = list(store.files())
    assert len(files) == 2
    assert stored_sizes(store) == {DIGEST: len(CONTENT), sha256_of(OTHER): len(OTHER)}
    for file in files:
        assert begun - 2 <= file.modified_at <= time.time() + 2


def test_discarded_draft_does_not_prevent_storing_its_blob(store):
    store.discard([store.draft({DIGEST: CONTENT})])
    store.put({DIGEST: CONTENT})

    assert store.read(DIGEST) == CONTENT


def test_many_drafts_settled_together_are_all_stored(store):
    contents = [f"image {number}".encode() for number in range(100)]

    store.settle([store.draft({sha256_of(data): data}) for data in contents])

    assert set(stored_sizes(store)) == {sha256_of(data) for data in contents}


@pytest.mark.parametrize("damage", [b"", b"an imagf", b"an image!"])
def test_reading_a_damaged_blob_raises_damaged_file(place, damage):
    place.store.put({DIGEST: CONTENT})
    place.overwrite(DIGEST, damage)

    with pytest.raises(DamagedFile, match="has changed since it was stored"):
        place.store.read(DIGEST)
    with pytest.raises(DamagedFile):
        place.store.open_verified(DIGEST, size_bytes=len(CONTENT))


def test_opening_a_missing_blob_or_one_of_another_size_raises_damaged_file(place):
    place.store.put({DIGEST: CONTENT})
    place.overwrite(DIGEST, b"an")
    with pytest.raises(DamagedFile, match="has 2 of 8 bytes"):
        place.store.open(DIGEST, size_bytes=len(CONTENT))
    place.lose(DIGEST)

    for ask in (place.store.open, place.store.open_verified):
        with pytest.raises(DamagedFile, match="is missing"):
            ask(DIGEST, size_bytes=len(CONTENT))
    with pytest.raises(DamagedFile, match="is missing"):
        place.store.read(DIGEST)


def test_put_missing_replaces_a_damaged_blob(place):
    place.store.put({DIGEST: CONTENT})
    place.overwrite(DIGEST, b"half")

    place.store.put_missing({DIGEST: CONTENT, sha256_of(OTHER): OTHER})

    assert place.store.read(DIGEST) == CONTENT
    assert place.store.read(sha256_of(OTHER)) == OTHER


@pytest.mark.parametrize(
    ("first", "end"),
    [(0, None), (0, 1), (7, 7), (PIECE - 1, PIECE + 1), (len(LARGE) - 5, len(LARGE))],
)
def test_range_of_a_large_blob_is_read_in_pieces(store, first, end):
    name = sha256_of(LARGE)
    store.put({name: LARGE})

    blob = store.open_verified(name, size_bytes=len(LARGE))
    pieces = list(blob.pieces(first, end))

    assert b"".join(pieces) == LARGE[first:end]
    assert all(len(piece) <= PIECE for piece in pieces)


def test_range_of_a_small_blob_is_read(store):
    store.put({DIGEST: CONTENT})

    for ask in (store.open, store.open_verified):
        blob = ask(DIGEST, size_bytes=len(CONTENT))
        assert (blob.size_bytes, blob.digest()) == (len(CONTENT), DIGEST)
        assert b"".join(blob.pieces(3, 5)) == CONTENT[3:5]


def test_recently_stored_blob_is_not_removed_as_unused(store):
    store.put({DIGEST: CONTENT})
    (file,) = store.files()

    kept = store.remove([DIGEST], unused_since=file.modified_at - 1)
    store.put({DIGEST: CONTENT})

    assert kept == {}
    store.make_sure([DIGEST])
    assert store.remove([DIGEST], unused_since=time.time() - 3600) == {}


def test_removed_blob_is_missing_and_make_sure_raises_try_later(store):
    store.put({DIGEST: CONTENT, sha256_of(OTHER): OTHER})

    missing = sha256_of(b"never there")
    removed = store.remove([DIGEST, missing], unused_since=float("inf"))

    assert removed == {DIGEST: len(CONTENT)}
    assert set(stored_sizes(store)) == {sha256_of(OTHER)}
    store.make_sure([sha256_of(OTHER)])
    with pytest.raises(TryLater, match="send the frame again"):
        store.make_sure([sha256_of(OTHER), DIGEST])


@pytest.mark.parametrize("content", [CONTENT, LARGE], ids=["small", "in parts"])
def test_adopted_file_is_stored_under_its_digest(store, content):
    file = store.temporary_folder() / "export.zip"
    file.write_bytes(content)

    name = store.adopt(file)

    assert name == sha256_of(content)
    assert (store.read(name), file.exists()) == (content, False)


def test_incomplete_export_and_a_check_of_the_store_are_no_files(store):
    (store.temporary_folder() / "export-3").mkdir()
    for _ in range(2):
        store.check()

    assert [path.name for path, _ in store.leftovers()] == ["export-3"]
    assert stored_sizes(store) == {}


def test_what_no_store_has_made_raises_an_error(store):
    climbing = ("..", "../../etc/passwd", "../" * 21 + "x")
    for name in (*climbing, "A" * 64, "", "0" * 63):
        with pytest.raises(ValueError, match="not a SHA-256 digest"):
            store.read(name)
    with pytest.raises(TypeError, match="another store"):
        store.settle([Drafts()])
