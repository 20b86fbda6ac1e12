"""What a person sends cannot forge, hide or overwrite a line of the log."""

import io
import json
import logging
import sys

import pytest

from app.logs import JsonLines, OneRecordPerLine, configure_logging, one_line, sanitised

TOKEN = f"ug_{'Aa0_-' * 9}"


def format_record(message, *args, exc_info=None):
    record = logging.LogRecord("x", logging.INFO, "f", 1, message, args, exc_info)
    return OneRecordPerLine("%(levelname)s [%(request_id)s] %(message)s").format(record)


@pytest.mark.parametrize(
    "text", ["a\nb", "a\rb", "a\x1b[2Jb", "a\u2028b", "a\x85b", "a\x00b", "a\udc80b"]
)
def test_control_characters_are_escaped_and_ordinary_text_is_not(text):
    escaped = f"a\\u{ord(text[1]):04x}{text[2:]}"

    assert one_line(text) == escaped
    assert format_record("class %s", text) == f"INFO [-] class {escaped}"
    assert one_line("Straße 日本 100 %") == "Straße 日本 100 %"


def test_traceback_lines_are_prefixed_in_text_logs():
    try:
        raise ValueError("one\nINFO [-] forged")
    except ValueError:
        text = format_record("failed", exc_info=sys.exc_info())

    first, *rest = text.splitlines()
    assert first == "INFO [-] failed"
    assert all(line.startswith("  | ") for line in rest)


@pytest.fixture
def restore_logging():
    root = logging.getLogger()
    loggers = [root, *map(logging.getLogger, ("uvicorn.error", "unghost", "app"))]
    handlers, levels = root.handlers[:], [logger.level for logger in loggers]
    yield
    root.handlers = handlers
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)


def format_as_json(message, *args, exc_info=None, **more):
    record = logging.LogRecord("x", logging.INFO, "f", 1, message, args, exc_info)
    vars(record).update(more)
    line = JsonLines().format(record)
    assert line.isascii()
    assert line.isprintable()
    return json.loads(line)


def test_token_is_masked_anywhere_in_a_text():
    assert sanitised(f"GET /login/{TOKEN}?") == "GET /login/ug_...?"
    assert sanitised("ug_short is no token") == "ug_short is no token"


def test_json_log_record_has_its_facts_as_keys():
    line = format_as_json("a %s", "b", facts={"status": 200, "path": "/\n\x1b[2J\x7f"})

    assert line.pop("time").endswith("Z")
    assert line == {
        "level": "info",
        "logger": "x",
        "request_id": "-",
        "message": "a b",
        "status": 200,
        "path": "/\\u000a\\u001b[2J\\u007f",
    }


def test_traceback_in_a_json_log_record_stays_in_one_line():
    try:
        raise ValueError(f"one\n\x1b[2J{TOKEN}")
    except ValueError:
        line = format_as_json("failed", exc_info=sys.exc_info())

    assert line["traceback"][0] == "Traceback (most recent call last):"
    assert line["traceback"][-2:] == ["ValueError: one", "\\u001b[2Jug_..."]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.usefixtures("restore_logging")
@pytest.mark.parametrize(
    ("stream", "form", "is_json"),
    [
        (Terminal, "auto", False),
        (io.StringIO, "auto", True),
        (Terminal, "json", True),
        (io.StringIO, "text", False),
    ],
)
def test_log_format_auto_is_text_on_a_terminal_and_json_elsewhere(
    stream, form, is_json
):
    out = stream()

    configure_logging("info", form, out)
    logging.getLogger("unghost.test").info("hello")

    assert out.getvalue().startswith("{") is is_json
    assert "hello" in out.getvalue()
