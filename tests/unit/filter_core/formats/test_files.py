"""A whole file: it appears when it is complete, and is written through no link."""

import os
import stat

import pytest

from filter_core.formats.files import whole_file, write_whole


def test_file_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "decisions.jsonl"

    with whole_file(path) as file:
        file.write(b"half")
        file.flush()
        assert not path.exists()
        file.write(b" and half")

    assert path.read_bytes() == b"half and half"
    assert list(tmp_path.iterdir()) == [path]
    path.chmod(0o600)

    write_whole(path, b"new")

    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def write_half(path, error):
    with whole_file(path) as file:
        file.write(b"half")
        raise error


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_interrupted_file_leaves_the_earlier_one_and_nothing_else(tmp_path, error):
    path = tmp_path / "decisions.jsonl"
    path.write_text("earlier")

    with pytest.raises(error):
        write_half(path, error)

    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("exists", [True, False], ids=["link", "dangling link"])
def test_link_of_the_name_is_replaced_and_not_followed(tmp_path, exists):
    path, private = tmp_path / "decisions.jsonl", tmp_path / "private.txt"
    if exists:
        private.write_text("mine")
    path.symlink_to(private)

    write_whole(path, b"new")

    assert not path.is_symlink()
    assert path.read_bytes() == b"new"
    assert private.exists() == exists
    assert not exists or private.read_text() == "mine"


def test_pipe_is_written_into_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    # Open for reading and writing, so that neither end waits for the other.
    descriptor = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)

    try:
        write_whole(pipe, b"new")
        written = os.read(descriptor, 100)
    finally:
        os.close(descriptor)

    assert written == b"new"
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]
