"""What a person sends cannot forge, hide or overwrite a line of the log."""

from __future__ import annotations

import logging
import sys

import pytest

from app.logs import OneRecordPerLine, one_line


def formatted(message, *args, exc_info=None):
    record = logging.LogRecord("x", logging.INFO, "f", 1, message, args, exc_info)
    return OneRecordPerLine("%(levelname)s [%(request_id)s] %(message)s").format(record)


@pytest.mark.parametrize(
    "text", ["a\nb", "a\rb", "a\x1b[2Jb", "a\u2028b", "a\x85b", "a\x00b", "a\udc80b"]
)
def test_what_moves_a_cursor_is_escaped(text):
    assert one_line(text) == f"a\\u{ord(text[1]):04x}{text[2:]}"


def test_ordinary_text_stays_as_it_is():
    assert one_line("Straße 日本 100 %") == "Straße 日本 100 %"


def test_a_line_break_in_an_argument_stays_in_its_record():
    line = formatted("class %s", "car\nINFO [-] all is well")

    assert line == "INFO [-] class car\\u000aINFO [-] all is well"


def test_lines_of_a_traceback_are_marked():
    try:
        raise ValueError("one\nINFO [-] forged")
    except ValueError:
        text = formatted("failed", exc_info=sys.exc_info())

    first, *rest = text.splitlines()
    assert first == "INFO [-] failed"
    assert all(line.startswith("  | ") for line in rest)
