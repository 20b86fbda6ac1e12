"""Hypothesis strategies for files and JSON documents that are damaged at random."""

import os
import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from hypothesis import settings
from hypothesis import strategies as st

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "10"))
MOST_BYTES_HELD = 96 * 1024**2
"""The most bytes of memory that reading a sample of a few kilobytes may take."""

fuzz_settings = settings(max_examples=EXAMPLES)

MEANINGFUL_PIECES = [
    *(b"\x00", b"\xff", b"\x7f", b"\x80", b"\n", b"\r\n", b" ", b"\t", b"\x1a", b'"'),
    *(
        b"-1",
        b"0",
        b"1e999",
        b"nan",
        b"inf",
        b"9" * 30,
        b"9" * 5000,
        b"null",
        b"{",
        b"[",
    ),
    *(b"%s", b"../", b"\xef\xbb\xbf", b"\xc3", b"\xed\xa0\x80", b"\xff\xff\xff\xff"),
    *(b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00", b"\x00" * 16, b"A" * 600, b"&a", b"*a"),
]
_pieces = st.one_of(st.sampled_from(MEANINGFUL_PIECES), st.binary(max_size=12))


@st.composite
def _edited(draw: st.DrawFn, content: bytes) -> bytes:
    start = draw(st.integers(0, len(content)))
    length = draw(st.sampled_from([0, 1, 2, 4, 8, 64]))
    taken = content[start : start + length]
    piece = draw(st.one_of(_pieces, st.just(taken * 2), st.just(b"")))
    kind = draw(st.sampled_from(["replace", "insert", "cut", "repeat"]))
    if kind == "cut":
        return content[:start]
    if kind == "insert":
        return content[:start] + piece + content[start:]
    if kind == "repeat":
        return content[:start] + content[: start + length] + content[start:]
    return content[:start] + piece + content[start + length :]


@st.composite
def damaged(draw: st.DrawFn, samples: Sequence[bytes]) -> bytes:
    """One of the samples, with up to five places changed."""
    content = draw(st.sampled_from(list(samples)))
    for _ in range(draw(st.integers(0, 5))):
        content = draw(_edited(content))
    return content


def damaged_text(samples: Sequence[str]) -> st.SearchStrategy[bytes]:
    """The same as `damaged`, for samples of text."""
    return damaged([sample.encode() for sample in samples])


json_values: st.SearchStrategy[object] = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(),
        st.sampled_from([0, -1, 1, 2**31, 2**63, 10**400, 1e308, "", "a", "\x00", "é"]),
        st.text(max_size=8),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=5),
        st.dictionaries(st.text(max_size=8), inner, max_size=4),
    ),
    max_leaves=12,
)


@st.composite
def mutated_json(draw: st.DrawFn, document: object) -> object:
    """A JSON document in which one value is replaced or removed."""
    if isinstance(document, dict) and document and draw(st.integers(0, 9)):
        key = draw(st.sampled_from(sorted(document)))
        changed = dict(document)
        if draw(st.integers(0, 7)) == 0:
            del changed[key]
        else:
            changed[key] = draw(mutated_json(document[key]))
        return changed
    if isinstance(document, list) and document and draw(st.integers(0, 9)):
        at = draw(st.integers(0, len(document) - 1))
        return [*document[:at], draw(mutated_json(document[at])), *document[at + 1 :]]
    return draw(json_values)


@contextmanager
def little_memory() -> Iterator[None]:
    """Fail if the block holds more than `MOST_BYTES_HELD` bytes at any moment."""
    tracemalloc.start()
    try:
        yield
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < MOST_BYTES_HELD, f"{most:,} bytes for a file of a few kilobytes"
