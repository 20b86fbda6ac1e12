"""Reading untrusted JSON: bad or oversized text is refused quickly, before parsing."""

import json
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.errors import JsonError
from filter_core.json_text import JsonLimits, read_json

SMALL = JsonLimits(2_000_000, max_depth=3, max_values=10, max_keys=2)
LONG_AFTER_TEXTS = "a number of more than 100 characters, at character 214"


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"", "a fault at line 1, column 1: Expecting value"),
        (b'{"a": 1,\n x}', "a fault at line 2, column 2: Expecting property name"),
        (b'"\xff"', "other bytes at offset 1"),
        (b'"\xed\xa0\x80"', "other bytes at offset 1"),
        (b'{"a": "\\ud800"}', "half of a surrogate pair, \\ud800, at character 7"),
        (b'["\\\\\\uDC00"]', "half of a surrogate pair, \\uDC00, at character 4"),
        (b'["\\ud800\\ud83d\\ude00"]', "half of a surrogate pair, \\ud800"),
        (b"[[[[1]]]]", "JSON that is nested deeper than 3 levels"),
        (b'["]]]", [[[1]]]]', "JSON that is nested deeper than 3 levels"),
        (b'["\\"]]", [[[1]]]]', "JSON that is nested deeper than 3 levels"),
        (b"[" * 1_000_000, "JSON of more than 10 values"),
        (b"[1,2,3,4,5,6,7,8,9,10]", "JSON of more than 10 values"),
        (b'{"a":1,"b":2,"c":3}', "JSON of more than 2 keys"),
        (b" " * 2_000_001, "JSON of more than 2000000 bytes"),
        (b"1" * 5000, "a number of more than 100 characters, at character 0"),
        (
            b"[0." + b"5" * 99 + b"]",
            "a number of more than 100 characters, at character 1",
        ),
        (b'{"a\\"":"' + b"1" * 200 + b'","b":-' + b"1" * 100 + b"}", LONG_AFTER_TEXTS),
    ],
)
def test_error_of_invalid_json_says_what_was_found(raw, words):
    with pytest.raises(JsonError) as refused:
        read_json(raw, SMALL)

    assert refused.value.found.startswith(words)
    assert (
        refused.value.detail == f"expected JSON in UTF-8, found {refused.value.found}"
    )


@pytest.mark.parametrize(
    ("raw", "value"),
    [
        (b"[[[1]]]", [[[1]]]),
        (b'[[["[[[[", "]"]]]', [[["[[[[", "]"]]]),
        (b'["\\\\", [["\\"[["]]]', ["\\", [['"[[']]]),
        (b'"' + b"," * 1000 + b'"', "," * 1000),
        (b'{"a":":::::","b":2}', {"a": ":::::", "b": 2}),
        (b'["\\ud83d\\ude00", "\\\\ud800"]', ["\N{GRINNING FACE}", "\\ud800"]),
        (b"\xef\xbb\xbf[1]", [1]),
        (b"[" + b"1" * 100 + b"]", [int("1" * 100)]),
        (b'["' + b"1" * 5000 + b'", 2]', ["1" * 5000, 2]),
        (b'["\\\\", "\\"' + b"1" * 5000 + b'"]', ["\\", '"' + "1" * 5000]),
        ('["ü"]', ["ü"]),
    ],
)
def test_json_within_the_limits_is_read(raw, value):
    assert read_json(raw, SMALL) == value


values = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(allow_nan=False),
        st.text(st.characters(exclude_categories=["Cs"])),
        st.text('[]{}",:\\u', max_size=9),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text('a[{"\\:', max_size=3), inner, max_size=4),
    ),
)


def depth_of(value):
    inner = value.values() if isinstance(value, dict) else value
    if not isinstance(value, (dict, list)):
        return 0
    return 1 + max(map(depth_of, inner), default=0)


def keys_in(value):
    if isinstance(value, dict):
        return len(value) + sum(map(keys_in, value.values()))
    return sum(map(keys_in, value)) if isinstance(value, list) else 0


@given(value=values, ascii_only=st.booleans())
def test_depth_and_key_limits_are_exact(value, ascii_only):
    raw = json.dumps(value, ensure_ascii=ascii_only).encode()
    depth, keys = depth_of(value), keys_in(value)
    within = JsonLimits(max_depth=depth, max_keys=keys)

    assert read_json(raw, within) == value
    if depth:
        with pytest.raises(JsonError, match="nested deeper"):
            read_json(raw, JsonLimits(max_depth=depth - 1))
    if keys:
        with pytest.raises(JsonError, match="keys"):
            read_json(raw, JsonLimits(max_keys=keys - 1))


@pytest.mark.parametrize(
    "raw",
    [
        pytest.param(b"[" + b"1e999," * 2_700_000 + b"1]", id="numbers"),
        pytest.param(b'{"":' * 4_000_000, id="objects"),
        pytest.param(b'["' + b'\\"' * 8_000_000, id="quotes in a text without end"),
        pytest.param(b'"' * 16_000_000, id="quotes"),
    ],
)
def test_oversized_json_is_refused_with_bounded_memory(raw):
    tracemalloc.start()
    try:
        with pytest.raises(JsonError):
            read_json(raw)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()

    assert most < 12 * len(raw)


HALFWAY = b"9007199254740993." + b"0" * 980 + b"1,"
"""A number halfway between two floats: only its last digit decides which is nearer."""


def test_overlong_numbers_are_refused_quickly():
    raw = b"[" + HALFWAY * 16_000 + b"1]"

    began = time.process_time()
    with pytest.raises(JsonError, match="a number of more than 100 characters"):
        read_json(raw)

    assert time.process_time() - began < 1
