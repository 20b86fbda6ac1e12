"""Logging: records name their request, and contain no tokens and no line breaks.

One line of JSON per record where a program reads the log, plain text on a terminal.
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

# The three loggers of the service as a whole. A part that works by itself, such as a
# job, logs under the name of its module (docs/operations.md, "Logs").
access_log: Final = logging.getLogger("unghost.access")
error_log: Final = logging.getLogger("unghost.error")
server_log: Final = logging.getLogger("unghost.server")

TEXT: Final = "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"
_CONTROL: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
# The service logs no token by itself, but a client may send one in a path.
_TOKEN: Final = re.compile(r"(u[gscd]_)[A-Za-z0-9_-]{20,}")


@contextmanager
def logged_with(request_id: str) -> Iterator[None]:
    """Add this request id to all records that are logged within the block."""
    reset = current_request_id.set(request_id)
    try:
        yield
    finally:
        current_request_id.reset(reset)


def one_line(text: str) -> str:
    """The text with all control characters escaped: a record stays on one line."""
    return _CONTROL.sub(lambda match: f"\\u{ord(match.group()):04x}", text)


def sanitised(text: str) -> str:
    """The text on one line, with tokens left out."""
    return _TOKEN.sub(r"\1...", one_line(text))


class OneRecordPerLine(logging.Formatter):
    """Escapes control characters in messages and indents tracebacks.

    A class name or a file name with a line break must not look like a second record.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  # logging's name
        """The first line of a record."""
        record.request_id = current_request_id.get()
        record.message = sanitised(record.message)
        return super().formatMessage(record)

    def format(self, record: logging.LogRecord) -> str:
        """A record, followed by the call stack among its `facts`, if there is one."""
        calls = getattr(record, "facts", {}).get("stack", ())
        return "\n".join(
            [super().format(record), *(f"  | {sanitised(c)}" for c in calls)]
        )

    def formatException(self, ei: object) -> str:  # noqa: N802  # logging's name
        """A traceback, each line marked as a continuation."""
        text = super().formatException(ei)  # type: ignore[arg-type]  # as logging has it
        return "\n".join(f"  | {sanitised(line)}" for line in text.splitlines())


class JsonLines(logging.Formatter):
    """A record as one line of ASCII JSON, with a key for each of its `facts`."""

    def format(self, record: logging.LogRecord) -> str:
        at = datetime.fromtimestamp(record.created, timezone.utc)
        line: dict[str, object] = {
            "time": at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "request_id": current_request_id.get(),
            "message": sanitised(record.getMessage()),
        }
        for name, value in getattr(record, "facts", {}).items():
            line[name] = sanitised(value) if isinstance(value, str) else value
        if record.exc_info and record.exc_info[0] is not None:
            text = "".join(traceback.format_exception(*record.exc_info))
            line["traceback"] = [sanitised(each) for each in text.splitlines()]
        return json.dumps(line, separators=(",", ":"))


class AccessRecord(NamedTuple):
    """A request and its outcome; `status` is 0 if no response was begun."""

    method: str
    path: str
    route: str | None
    status: int
    seconds: float
    caller: str | None
    client: str | None


MAX_PATH: Final = 500
"""Characters of a path in the log: anybody may send longer ones, without a token."""


def log_access(record: AccessRecord) -> None:
    """Log one line for a request: no query string, no header, no body."""
    if not access_log.isEnabledFor(logging.INFO):
        return
    duration_ms = round(1e3 * record.seconds, 1)
    path = record.path
    if len(path) > MAX_PATH:
        path = f"{path[:MAX_PATH]}... ({len(path)} characters)"
    facts = {**record._asdict(), "path": path, "duration_ms": duration_ms}
    del facts["seconds"]
    access_log.info(
        "%s %s %d %.1f ms %s",
        record.method,
        path,
        record.status,
        duration_ms,
        record.caller or "-",
        extra={"facts": facts},
    )


def configure_logging(level: str, form: str, stream: TextIO | None = None) -> None:
    """Log everything of the service from this level on, and warnings of libraries.

    `form` is ``json``, ``text``, or ``auto``: text on a terminal, JSON elsewhere.
    `stream` is stderr unless given.
    """
    stream = stream or sys.stderr
    if form == "auto":
        form = "text" if stream.isatty() else "json"
    to_stream = logging.StreamHandler(stream)
    to_stream.setFormatter(JsonLines() if form == "json" else OneRecordPerLine(TEXT))
    logging.basicConfig(level=logging.WARNING, handlers=[to_stream], force=True)
    # The service logs these failures itself; uvicorn would add a second traceback.
    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
    for name in ("unghost", "app"):
        logging.getLogger(name).setLevel(level.upper())
