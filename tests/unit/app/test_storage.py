"""Blobs are durable before anyone can refer to them, and never half there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app.storage import FolderStorage, sha256_of

CONTENT = b"an image"
DIGEST = sha256_of(CONTENT)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What the operating system was asked for, in order; it still does it."""
    noted: list[tuple[str, str]] = []
    fsync, replace = os.fsync, os.replace

    def name_of(descriptor: int) -> str:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        return "folder" if path.is_dir() else path.name[:5]

    def noting_fsync(descriptor: int) -> None:
        noted.append(("fsync", name_of(descriptor)))
        fsync(descriptor)

    def noting_replace(source: str, target: str) -> None:
        noted.append(("rename", f"{Path(source).name[:5]} to {Path(target).name[:5]}"))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", noting_fsync)
    monkeypatch.setattr(os, "replace", noting_replace)
    return noted


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_file_then_name_then_folder_reach_the_disk(tmp_path, calls):
    storage = FolderStorage(tmp_path / "blobs")
    calls.clear()

    storage.put({DIGEST: CONTENT})

    assert calls == [
        ("fsync", ".new-"),
        ("rename", f".new- to {DIGEST[:5]}"),
        ("fsync", "folder"),
    ]


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_all_folders_reach_the_disk_before_the_first_file(tmp_path, calls):
    FolderStorage(tmp_path / "blobs").put({DIGEST: CONTENT})

    assert [call for call, _ in calls] == ["fsync", "fsync", "rename", "fsync"]
    assert calls[0] == ("fsync", "folder")


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_a_blob_that_is_there_is_not_written_but_its_name_reaches_the_disk(
    tmp_path, calls
):
    """Whoever wrote it may not have come to flush the folder yet."""
    storage = FolderStorage(tmp_path / "blobs")
    storage.put({DIGEST: CONTENT})
    calls.clear()

    storage.put({DIGEST: CONTENT})

    assert calls == [("fsync", "folder")]


def test_a_write_that_fails_leaves_no_trace(tmp_path, monkeypatch):
    storage = FolderStorage(tmp_path / "blobs")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            storage.put({DIGEST: CONTENT})

    assert not storage.path(DIGEST).exists()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    storage.put({DIGEST: CONTENT})
    assert storage.read(DIGEST) == CONTENT


def test_a_finished_file_is_adopted_under_its_digest(tmp_path):
    storage = FolderStorage(tmp_path / "blobs")
    file = storage.temporary_folder() / "export.zip"
    file.write_bytes(CONTENT)

    assert storage.adopt(file) == DIGEST
    assert (storage.read(DIGEST), file.exists()) == (CONTENT, False)


@pytest.mark.parametrize("name", ["", "..", "../" * 21 + "x", "A" * 64, DIGEST[:-1]])
def test_only_a_digest_is_a_name(tmp_path, name):
    with pytest.raises(ValueError, match="not a SHA-256"):
        FolderStorage(tmp_path).path(name)
