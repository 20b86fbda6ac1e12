"""Archives in pieces of any size, and what no archive of frames has."""

from __future__ import annotations

import io
import tarfile
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.errors import TooLarge, UnsupportedMedia
from app.services.tar_stream import BadArchive, Member, TarLimits, TarStream

LIMITS = TarLimits(max_archive_bytes=10**9, max_member_bytes=10_000, max_members=20)
END = bytes(1024)


def read(data, *cuts, limits=LIMITS):
    stream = TarStream(limits)
    places = [0, *sorted(cuts), len(data)]
    pairs = pairwise(places)
    found = [one for low, high in pairs for one in stream.feed(data[low:high])]
    stream.close()
    return found


def header(name, size=0, kind=tarfile.REGTYPE, form=tarfile.GNU_FORMAT, **more):
    member = tarfile.TarInfo(name)
    member.size, member.type = size, kind
    for key, value in more.items():
        setattr(member, key, value)
    return member.tobuf(form)


def packed(members, form):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=form) as archive:
        for name, content in members:
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()


names = st.text("abcdé/._-", min_size=1, max_size=180).filter(
    lambda name: not name.startswith(("/", "./")) and not name.endswith("/")
)
safe_names = names.filter(lambda name: ".." not in name.split("/") and "//" not in name)


@given(
    members=st.lists(st.tuples(safe_names, st.binary(max_size=1500)), max_size=4),
    form=st.sampled_from([tarfile.GNU_FORMAT, tarfile.PAX_FORMAT]),
    data=st.data(),
)
def test_it_reads_what_python_writes_however_it_is_cut(members, form, data):
    archive = packed(members, form)
    cuts = data.draw(st.lists(st.integers(0, len(archive)), max_size=6))

    assert read(archive, *cuts) == [Member(*one) for one in members]


def test_folders_are_passed_over_and_a_leading_dot_does_not_count():
    data = header("./", kind=tarfile.DIRTYPE) + header("a/", kind=tarfile.DIRTYPE)

    assert read(data + header("./a/b.json") + END) == [Member("a/b.json", b"")]


def test_a_large_member_is_passed_over_without_being_held():
    data = header("a", 10_001) + bytes(10_001 + 239) + header("b") + END

    assert read(data) == [Member("a", None), Member("b", b"")]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        pytest.param(
            header("a", kind=tarfile.SYMTYPE), "^'a': .*a symbolic link", id="link"
        ),
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
        pytest.param(
            header("x", 10, b"x") + b"9 path=a\n".ljust(512, b"\0"),
            "damaged",
            id="PAX that lies",
        ),
        pytest.param(
            header("x", 19, b"x") + b"19 GNU.sparse.a=b\n\n".ljust(512, b"\0"),
            "damaged|size of a member",
            id="PAX sparse",
        ),
        pytest.param(b"\1" * 512, "damaged", id="noise"),
        pytest.param(END + header("a"), "goes on after its end", id="two archives"),
        pytest.param(header("a", 600) + bytes(512), "cut short", id="cut"),
        pytest.param(header("a") + bytes(512), "cut short", id="one block missing"),
    ],
)
def test_what_no_archive_of_frames_has_is_refused(data, words):
    with pytest.raises(BadArchive, match=words):
        read(data + (b"" if words == "cut short" else END))


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
def test_what_is_too_large_or_compressed_is_refused(data, error):
    with pytest.raises(error):
        read(data + END)
