"""Log lines that name their request and that nobody can forge. No secrets.

JSON, a line per record, wherever a program reads; plain text on a terminal.
"""

from __future__ import annotations

import json
import logging
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime, timezone
from typing import Final, NamedTuple, TextIO

current_request_id: ContextVar[str] = ContextVar("current_request_id", default="-")

access_log: Final = logging.getLogger("unghost.access")
error_log: Final = logging.getLogger("unghost.error")
server_log: Final = logging.getLogger("unghost.server")

TEXT: Final = "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"
_CONTROL: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
# Nothing here logs a token; somebody may put one into an address all the same.
_TOKEN: Final = re.compile(r"(u[gscd]_)[A-Za-z0-9_-]{20,}")


@contextmanager
def known_as(request_id: str) -> Iterator[None]:
    """What is written within the block belongs to this request."""
    reset = current_request_id.set(request_id)
    try:
        yield
    finally:
        current_request_id.reset(reset)


def one_line(text: str) -> str:
    """The text with everything escaped that could start a line or move a cursor."""
    return _CONTROL.sub(lambda found: f"\\u{ord(found.group()):04x}", text)


def harmless(text: str) -> str:
    """One line of text without tokens."""
    return _TOKEN.sub(r"\1...", one_line(text))


class OneRecordPerLine(logging.Formatter):
    """Escapes control characters in messages and indents tracebacks.

    A class name or a file name with a line break must not look like a second record.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  # logging's name
        """The first line of a record."""
        record.request_id = current_request_id.get()
        record.message = harmless(record.message)
        return super().formatMessage(record)

    def format(self, record: logging.LogRecord) -> str:
        """A record, and below it the calls that it may name."""
        calls = getattr(record, "facts", {}).get("stack", ())
        return "\n".join(
            [super().format(record), *(f"  | {harmless(c)}" for c in calls)]
        )

    def formatException(self, ei: object) -> str:  # noqa: N802  # logging's name
        """A traceback, each line marked as a continuation."""
        text = super().formatException(ei)  # type: ignore[arg-type]  # as logging has it
        return "\n".join(f"  | {harmless(line)}" for line in text.splitlines())


class JsonLines(logging.Formatter):
    """A record as one line of JSON, in ASCII; what a record is about are keys of it."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        at = datetime.fromtimestamp(record.created, timezone.utc)
        line: dict[str, object] = {
            "time": at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "request_id": current_request_id.get(),
            "message": harmless(record.getMessage()),
        }
        for name, value in getattr(record, "facts", {}).items():
            line[name] = harmless(value) if isinstance(value, str) else value
        if record.exc_info and record.exc_info[0] is not None:
            text = "".join(traceback.format_exception(*record.exc_info))
            line["traceback"] = [harmless(each) for each in text.splitlines()]
        return json.dumps(line, separators=(",", ":"))


class Answered(NamedTuple):
    """A request and what became of it; `status` 0 if nobody waited for the answer."""

    method: str
    path: str
    route: str | None
    status: int
    seconds: float
    caller: str | None
    client: str | None


def log_answer(answered: Answered) -> None:
    """One line per request: no query, no header, no body."""
    if not access_log.isEnabledFor(logging.INFO):
        return
    duration_ms = round(1e3 * answered.seconds, 1)
    facts = {**answered._asdict(), "duration_ms": duration_ms}
    del facts["seconds"]
    access_log.info(
        "%s %s %d %.1f ms %s",
        answered.method,
        answered.path,
        answered.status,
        duration_ms,
        answered.caller or "-",
        extra={"facts": facts},
    )


def configure_logging(level: str, form: str, stream: TextIO | None = None) -> None:
    """Send everything to stderr at this level; libraries speak up from warnings on.

    `form` is ``json``, ``text``, or ``auto``: text on a terminal, JSON elsewhere.
    """
    stream = stream or sys.stderr
    if form == "auto":
        form = "text" if stream.isatty() else "json"
    to_stream = logging.StreamHandler(stream)
    to_stream.setFormatter(JsonLines() if form == "json" else OneRecordPerLine(TEXT))
    logging.basicConfig(level=logging.WARNING, handlers=[to_stream], force=True)
    # What it would say of failures, we say, without a second traceback.
    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
    for name in ("unghost", "app"):
        logging.getLogger(name).setLevel(level.upper())
