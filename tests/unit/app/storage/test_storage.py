"""Blobs in a folder are flushed before they can be used, and never incomplete."""

import os
from pathlib import Path

import pytest

from app.storage.base import left_over, leftovers, sha256_of, stored_files
from app.storage.durable import make_folder
from app.storage.folder import FolderStorage

CONTENT = b"an image"
DIGEST = sha256_of(CONTENT)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """The calls of fsync and rename, in order; they are carried out as well."""
    noted: list[tuple[str, str]] = []
    fsync, replace = os.fsync, os.replace

    def name_of(descriptor: int) -> str:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        return "folder" if path.is_dir() else path.name[:5]

    def recording_fsync(descriptor: int) -> None:
        noted.append(("fsync", name_of(descriptor)))
        fsync(descriptor)

    def recording_replace(source: str, target: str) -> None:
        noted.append(("rename", f"{Path(source).name[:5]} to {Path(target).name[:5]}"))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", recording_fsync)
    monkeypatch.setattr(os, "replace", recording_replace)
    return noted


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/fd").exists(), reason="needs /proc"
)


@needs_proc
def test_put_flushes_the_file_then_renames_it_then_flushes_the_folder(tmp_path, calls):
    storage = FolderStorage(tmp_path / "blobs")
    storage.put({DIGEST: CONTENT})
    stored = calls.copy()
    calls.clear()

    # The process that wrote it may not have flushed the folder yet.
    storage.put({DIGEST: CONTENT})

    assert calls == [("fsync", "folder")]
    # The parent once the folder is created, the folder with its 256, the parent again.
    assert stored[:3] == [("fsync", "folder")] * 3
    assert stored[3:] == [
        ("fsync", ".new-"),
        ("rename", f".new- to {DIGEST[:5]}"),
        ("fsync", "folder"),
    ]


@needs_proc
def test_make_folder_flushes_the_parent_of_each_new_folder(tmp_path, calls):
    """A new folder is durable only after the folder that contains it was flushed."""
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")

    assert calls == [("fsync", "folder"), ("fsync", "folder")]


def test_write_that_fails_leaves_no_file(tmp_path, monkeypatch):
    storage = FolderStorage(tmp_path / "blobs")

    def raise_no_space(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", raise_no_space)
        with pytest.raises(OSError, match="No space"):
            storage.put({DIGEST: CONTENT})

    assert not storage.path(DIGEST).exists()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    storage.put({DIGEST: CONTENT})
    assert storage.read(DIGEST) == CONTENT


@pytest.mark.parametrize("damage", [b"", CONTENT[:-1]])
def test_incomplete_file_is_rewritten_when_it_is_put_again(tmp_path, damage):
    """That a file of this name exists does not mean that it is complete."""
    storage = FolderStorage(tmp_path / "blobs")
    storage.put({DIGEST: CONTENT})
    storage.path(DIGEST).write_bytes(damage)

    storage.put({DIGEST: CONTENT})

    assert storage.read(DIGEST) == CONTENT


def test_a_file_that_is_put_again_is_not_removed_as_unused(tmp_path):
    storage = FolderStorage(tmp_path / "blobs")
    storage.put({DIGEST: CONTENT})
    os.utime(storage.path(DIGEST), (1, 1))
    long_ago = storage.path(DIGEST).stat().st_mtime

    storage.put({DIGEST: CONTENT})

    assert storage.remove([DIGEST], unused_since=long_ago) == {}
    storage.require([DIGEST])


def test_files_of_exports_at_work_are_not_left_over(tmp_path):
    storage = FolderStorage(tmp_path / "blobs")
    for name in ("export-7", "export-7-0f3a", "export-77-0f3a"):
        (storage.temporary_folder() / name).mkdir()

    left = left_over(storage, [7], until=float("inf"))

    assert [path.name for path in left] == ["export-77-0f3a"]


def test_stored_files_are_listed_apart_from_leftovers(tmp_path):
    storage = FolderStorage(tmp_path / "blobs")
    storage.put({DIGEST: CONTENT})
    storage.draft({sha256_of(b"half"): b"half"})
    (storage.temporary_folder() / "export-3").mkdir()

    stored = [(file.digest, file.size_bytes) for file in stored_files(storage.folder)]
    left = [path.name[:5] for path, _ in leftovers(storage.folder)]

    assert stored == [(DIGEST, len(CONTENT))]
    assert left == [".new-", "expor"]
