"""What a person sends cannot forge, hide or overwrite a line of the log."""

from __future__ import annotations

import io
import json
import logging
import sys

import pytest

from app.logs import JsonLines, OneRecordPerLine, configure_logging, one_line, sanitised

TOKEN = f"ug_{'Aa0_-' * 9}"


def formatted(message, *args, exc_info=None):
    record = logging.LogRecord("x", logging.INFO, "f", 1, message, args, exc_info)
    return OneRecordPerLine("%(levelname)s [%(request_id)s] %(message)s").format(record)


@pytest.mark.parametrize(
    "text", ["a\nb", "a\rb", "a\x1b[2Jb", "a\u2028b", "a\x85b", "a\x00b", "a\udc80b"]
)
def test_control_characters_are_escaped(text):
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


@pytest.fixture
def _logging_as_before():
    root = logging.getLogger()
    loggers = [root, *map(logging.getLogger, ("uvicorn.error", "unghost", "app"))]
    handlers, levels = root.handlers[:], [logger.level for logger in loggers]
    yield
    root.handlers = handlers
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)


def as_json(message, *args, exc_info=None, **more):
    record = logging.LogRecord("x", logging.INFO, "f", 1, message, args, exc_info)
    vars(record).update(more)
    line = JsonLines().format(record)
    assert line.isascii()
    assert line.isprintable()
    return json.loads(line)


def test_a_token_is_cut_out_wherever_it_stands():
    assert sanitised(f"GET /login/{TOKEN}?") == "GET /login/ug_...?"
    assert sanitised("ug_short is no token") == "ug_short is no token"


def test_a_record_as_json_has_its_facts_as_keys():
    line = as_json("a %s", "b", facts={"status": 200, "path": "/\n\x1b[2J\x7f"})

    assert line.pop("time").endswith("Z")
    assert line == {
        "level": "info",
        "logger": "x",
        "request_id": "-",
        "message": "a b",
        "status": 200,
        "path": "/\\u000a\\u001b[2J\\u007f",
    }


def test_a_traceback_as_json_stays_in_its_line():
    try:
        raise ValueError(f"one\n\x1b[2J{TOKEN}")
    except ValueError:
        line = as_json("failed", exc_info=sys.exc_info())

    assert line["traceback"][0] == "Traceback (most recent call last):"
    assert line["traceback"][-2:] == ["ValueError: one", "\\u001b[2Jug_..."]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.usefixtures("_logging_as_before")
@pytest.mark.parametrize(
    ("stream", "form", "is_json"),
    [
        (Terminal, "auto", False),
        (io.StringIO, "auto", True),
        (Terminal, "json", True),
        (io.StringIO, "text", False),
    ],
)
def test_people_read_text_and_programs_json(stream, form, is_json):
    out = stream()

    configure_logging("info", form, out)
    logging.getLogger("unghost.test").info("hello")

    assert out.getvalue().startswith("{") is is_json
    assert "hello" in out.getvalue()
