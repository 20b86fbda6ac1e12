"""`TarStream` reads archives in pieces of any size, and refuses bad members."""

import tarfile
import time
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.errors import TooLarge, UnsupportedMedia
from app.ingest.tar import BadArchive, TarLimits, TarStream
from tests.support.archives import END, tar_archive

LIMITS = TarLimits(max_archive_bytes=10**9, max_member_bytes=10_000, max_members=20)


def read(data, *cuts, limits=LIMITS):
    stream = TarStream(limits)
    places = [0, *sorted(cuts), len(data)]
    pairs = pairwise(places)
    members = [member for low, high in pairs for member in stream.feed(data[low:high])]
    stream.close()
    return members


def header(name, size=0, kind=tarfile.REGTYPE, form=tarfile.GNU_FORMAT, **more):
    member = tarfile.TarInfo(name)
    member.size, member.type = size, kind
    for key, value in more.items():
        setattr(member, key, value)
    return member.tobuf(form)


names = st.text("abcdé/._-", min_size=1, max_size=180).filter(
    lambda name: not name.startswith(("/", "./")) and not name.endswith("/")
)
safe_names = names.filter(lambda name: ".." not in name.split("/") and "//" not in name)


@given(
    members=st.lists(st.tuples(safe_names, st.binary(max_size=1500)), max_size=4),
    form=st.sampled_from([tarfile.GNU_FORMAT, tarfile.PAX_FORMAT]),
    data=st.data(),
)
def test_archives_of_tarfile_are_read_in_pieces_of_any_size(members, form, data):
    archive = tar_archive(members, form)
    cuts = data.draw(st.lists(st.integers(0, len(archive)), max_size=6))

    assert read(archive, *cuts) == members


LONG_NAME = "a" * 99 + "/b"
TOO_LARGE = header("a", 10_001) + bytes(10_001 + 239)


UNUSUAL = {
    "folders are skipped and a leading dot is removed": (
        header("./", kind=tarfile.DIRTYPE) + header("./a/b.json") + END,
        [("a/b.json", b"")],
    ),
    "a too large member is skipped without its content": (
        TOO_LARGE + header("b") + END,
        [("a", None), ("b", b"")],
    ),
    "a long name that is split after a slash is that of a file": (
        tar_archive([(LONG_NAME, b"1")], tarfile.GNU_FORMAT),
        [(LONG_NAME, b"1")],
    ),
}


@pytest.mark.parametrize(("archive", "members"), UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_members_are_read(archive, members):
    assert read(archive) == members


@pytest.mark.parametrize(
    ("data", "words"),
    [
        pytest.param(header("a", kind=tarfile.SYMTYPE), "^'a': .*a symbolic link",
         id="link"),
        pytest.param(header("a", kind=tarfile.LNKTYPE), "a link", id="hard link"),
        pytest.param(header("a", kind=tarfile.CHRTYPE), "a device", id="device"),
        pytest.param(header("a", kind=tarfile.FIFOTYPE), "a pipe", id="pipe"),
        pytest.param(header("a", kind=b"S"), "a sparse file", id="sparse"),
        pytest.param(header("a", kind=b"Q"), "type b'Q'", id="unknown"),
        pytest.param(header("/etc/passwd"), "within the archive", id="absolute"),
        pytest.param(header("a/../../b"), "within the archive", id="way out"),
        pytest.param(header("C:\\b"), "within the archive", id="drive"),
        pytest.param(header("x", 65_537, b"x"), "65537 bytes", id="PAX bomb"),
        pytest.param(header("x", 65_537, b"L"), "65537 bytes", id="name bomb"),
        pytest.param(header("x", 10, b"x") + b"9 path=a\n".ljust(512, b"\0"),
         "damaged", id="PAX that lies"),
        pytest.param(header("x", 19, b"x") + b"19 GNU.sparse.a=b\n\n".ljust(512, b"\0"),
         "damaged|size of a member", id="PAX sparse"),
        pytest.param(b"\1" * 512, "damaged", id="noise"),
        pytest.param(END + header("a"), "has data after its end", id="two archives"),
        pytest.param(header("a", 600) + bytes(512), "truncated", id="cut"),
        pytest.param(header("a") + bytes(512), "truncated", id="one block missing"),
    ],
)  # fmt: skip
def test_unsupported_or_damaged_member_is_refused(data, words):
    with pytest.raises(BadArchive, match=words):
        read(data + (b"" if words == "truncated" else END))


def header_with_size(field, kind=tarfile.REGTYPE):
    """A valid header with these bytes, padded to twelve, as its size."""
    block = header("a", kind=kind)
    block = block[:124] + field.ljust(12, b"\0") + block[136:]
    checksum = sum(block[:148]) + 8 * ord(" ") + sum(block[156:])
    return block[:148] + b"%06o\0 " % checksum + block[156:]


@pytest.mark.parametrize(
    "field",
    [
        pytest.param(b"zzzzzzzzzzz", id="no digits"),
        pytest.param(b"00000000189", id="digits that are not octal"),
        pytest.param(b"-1", id="a minus"),
        pytest.param(b"+1", id="a plus"),
        pytest.param(b"0o17", id="a prefix"),
        pytest.param(b"1_0", id="a line between digits"),
        pytest.param(b"1 0", id="a blank between digits"),
        pytest.param(b"\xff" * 12, id="binary, negative"),
        pytest.param(b"\xff" + bytes(11), id="binary, far below zero"),
        pytest.param(b"\x81" + bytes(11), id="binary, of 96 bits"),
    ],
)
@pytest.mark.parametrize("kind", [tarfile.REGTYPE, tarfile.DIRTYPE, b"x", b"L"])
@pytest.mark.timeout(10, func_only=True)
def test_invalid_member_size_is_refused(field, kind):
    with pytest.raises(
        BadArchive, match=r"^(the size of 'a/?':|a header of the archive) "
    ):
        read(header_with_size(field, kind) + bytes(512) + END)


@pytest.mark.parametrize(
    "field", [b"-1", b"zzzzzz", b"\xff" * 8, b"\x80" + b"\xff" * 7]
)
def test_invalid_checksum_is_a_damaged_header(field):
    block = header("a")

    with pytest.raises(BadArchive, match="damaged"):
        read(block[:148] + field.ljust(8, b"\0") + block[156:] + END)


@pytest.mark.parametrize(
    ("field", "size"),
    [
        pytest.param(b"", 0, id="nothing at all"),
        pytest.param(b"         17 ", 15, id="blanks around it"),
        pytest.param(b"\x80" + bytes(10) + b"\x0f", 15, id="binary"),
    ],
)
def test_valid_encodings_of_a_member_size_are_read(field, size):
    content = b"x" * size
    data = header_with_size(field) + content + bytes(-size % 512) + END

    assert read(data) == [("a", content)]


def seconds_of(data):
    """The processor time that reading takes: the least of three times."""

    def once():
        before = time.process_time()
        with suppress(BadArchive):
            read(data, limits=replace(LIMITS, max_member_bytes=10**6))
        return time.process_time() - before

    return min(once() for _ in range(3))


def extended_header(kind, content):
    return header("x", len(content), kind) + content + bytes(-len(content) % 512)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(extended_header(b"L", b"./" * 32_000 + b"b"), id="a name of dots"),
        pytest.param(extended_header(b"L", b"/" * 64_000), id="a name of slashes"),
        pytest.param(extended_header(b"x", b"5 a=\n" * 13_000), id="many records"),
        pytest.param(
            extended_header(b"x", b"9" * 64_000), id="a length without an end"
        ),
        pytest.param(extended_header(b"x", b" " * 64_000), id="a record of blanks"),
        pytest.param(bytes(64_000), id="empty blocks"),
    ],
)
def test_reading_time_is_not_quadratic_in_the_size(data):
    assert seconds_of(data + header("b") + END) < 0.03


def test_member_in_single_bytes_uses_memory_proportional_to_its_size():
    size = 100_000
    stream = TarStream(replace(LIMITS, max_member_bytes=size))
    list(stream.feed(header("a", size)))
    tracemalloc.start()
    try:
        for _ in range(size - 1):
            assert list(stream.feed(b"x")) == []
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak < 3 * size
    assert list(stream.feed(b"x")) == [("a", b"x" * size)]


@pytest.mark.parametrize(
    ("data", "error"),
    [
        pytest.param(header("a", 8**10), TooLarge, id="a huge size"),
        pytest.param(header("a", 2**70), TooLarge, id="a size of 71 bits"),
        pytest.param(header("a") * 21, TooLarge, id="too many members"),
        pytest.param(b"\x1f\x8b".ljust(512), UnsupportedMedia, id="gzip"),
        pytest.param(b"BZh".ljust(512), UnsupportedMedia, id="bzip2"),
    ],
)
def test_too_large_or_compressed_archive_is_refused(data, error):
    with pytest.raises(error):
        read(data + END)


def test_any_name_option_returns_names_outside_the_archive():
    stream = TarStream(LIMITS, any_name=True)

    members = list(stream.feed(header("../a") + header("/b") + END))

    assert members == [("../a", b""), ("/b", b"")]
