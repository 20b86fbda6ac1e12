"""A multipart form is read completely, however it is cut; a broken one is refused."""

import asyncio
from contextlib import suppress
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from app.errors import AppError, BadRequest, TooLarge
from app.http.bodies import read_parts
from tests.support.threads import in_thread

BOUNDARY = b"b0undary"
MEDIA_TYPE = 'multipart/form-data; boundary="b0undary"'
HIGH_LIMITS = {"max_parts": 100, "max_part_bytes": 10**6}

# Contents that look like boundaries or parts of them.
contents = st.lists(
    st.sampled_from([b"\r", b"\n", b"-", b"--", BOUNDARY, b"\r\n--b0un", b"\0", b"x"])
).map(b"".join)
names = st.text(st.characters(exclude_characters='"\\\r\n*', codec="utf-8"))
parts_of_a_form = st.lists(st.tuples(names, contents), max_size=5)


def form(parts, *, is_file=True):
    filename = b'; filename="a.png"' if is_file else b""
    pieces = [
        b"--%b\r\nContent-Disposition: form-data%b; name=%b\r\n"
        b"Content-Type: image/png\r\n\r\n%b\r\n"
        % (BOUNDARY, filename, b'"%b"' % name.encode(), content)
        for name, content in parts
    ]
    return b"".join([*pieces, b"--", BOUNDARY, b"--\r\n"])


def read(body, limits=HIGH_LIMITS, *, cuts=(), media_type=MEDIA_TYPE):
    """The parts that are read from a body, which is cut into pieces at `cuts`."""

    async def stream():
        edges = sorted({0, *cuts, len(body)})
        for start, end in pairwise(edges):
            yield body[start:end]

    return in_thread(asyncio.run, read_parts(media_type, stream(), **limits))


def error_of_reading(*args, **options):
    with pytest.raises(AppError) as refused:
        read(*args, **options)
    return refused.value


@given(parts_of_a_form, st.booleans(), st.lists(st.integers(0, 300)))
def test_form_is_read_the_same_for_any_split_into_pieces(parts, is_file, cuts):
    assume(not any(b"\r\n--" + BOUNDARY in b"\r\n" + each for _, each in parts))
    body = form(parts, is_file=is_file)

    contents = read(body, cuts=[cut for cut in cuts if cut < len(body)])

    assert contents == parts


@given(parts_of_a_form, st.data())
def test_truncated_form_is_refused(parts, data):
    body = form(parts).removesuffix(b"--\r\n")
    end = data.draw(st.integers(0, len(body)))

    assert error_of_reading(body[:end]).kind == "bad_multipart"


@given(st.binary())
def test_body_that_is_not_a_form_is_refused_or_has_no_parts(body):
    with suppress(BadRequest):
        assert read(body) == []


@pytest.mark.parametrize(
    "media_type",
    ["multipart/form-data", "multipart/form-data; boundary=", "multipart/form-data; b"],
)
def test_media_type_without_a_boundary_is_refused(media_type):
    assert error_of_reading(form([]), media_type=media_type).kind == "bad_multipart"


def test_part_without_a_name_is_refused():
    body = b"--%b\r\nContent-Type: text/plain\r\n\r\nx\r\n--%b--\r\n"

    assert "name" in str(error_of_reading(body % (BOUNDARY, BOUNDARY)))


def test_more_parts_than_allowed_are_refused():
    parts = [(str(number), b"") for number in range(3)]

    assert read(form(parts), {"max_parts": 3, "max_part_bytes": 10}) == parts
    with pytest.raises(TooLarge, match="more than 2 parts"):
        read(form(parts), {"max_parts": 2, "max_part_bytes": 10})


def test_too_large_part_is_refused_before_it_is_read_completely():
    body, taken = form([("image", b"x" * 10_000)]), 0

    async def stream():
        nonlocal taken
        for start in range(0, len(body), 100):
            taken += 100
            yield body[start : start + 100]

    reading = read_parts(MEDIA_TYPE, stream(), max_parts=3, max_part_bytes=1000)
    with pytest.raises(TooLarge, match=r"'image'.*1000 bytes"):
        in_thread(asyncio.run, reading)
    assert taken < 1500


def test_bytes_before_and_after_a_form_are_ignored():
    parts = [("image", b"x")]

    assert read(b"\r\n" + form(parts) + b"epilogue") == parts


def test_too_long_media_type_is_refused():
    media_type = 'multipart/form-data; boundary="b0undary"' + ";" * 1000

    assert "1040 characters" in str(error_of_reading(form([]), media_type=media_type))


@pytest.mark.parametrize(
    ("headers", "words"),
    [
        pytest.param(b"X-%d: 1\r\n" * 9 % tuple(range(9)), "header count", id="many"),
        pytest.param(b"X: " + b"1" * 4100 + b"\r\n", "header size", id="long"),
        pytest.param(b"X" * 4100 + b": 1\r\n", "header size", id="long name"),
        pytest.param(b"X" * 4100, "header size", id="without an end"),
    ],
)
def test_part_with_too_many_or_too_long_headers_is_refused(headers, words):
    body = b"--%b\r\n%bContent-Disposition: form-data; name=a\r\n\r\n1\r\n--%b--\r\n"

    refused = error_of_reading(
        body % (BOUNDARY, headers, BOUNDARY), cuts=range(0, 4000, 7)
    )

    assert refused.kind == "bad_multipart"
    assert words in str(refused)
