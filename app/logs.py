"""Log lines that name their request and that nobody can forge. No secrets."""

from __future__ import annotations

import logging
import re
import sys
from contextvars import ContextVar
from typing import Final

current_request_id: ContextVar[str] = ContextVar("current_request_id", default="-")

access_log: Final = logging.getLogger("unghost.access")
error_log: Final = logging.getLogger("unghost.error")

_FORMAT: Final = "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"
_CONTROL: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def one_line(text: str) -> str:
    """The text with everything escaped that could start a line or move a cursor."""
    return _CONTROL.sub(lambda found: f"\\u{ord(found.group()):04x}", text)


class OneRecordPerLine(logging.Formatter):
    """Escapes control characters in messages and indents tracebacks.

    A class name or a file name with a line break must not look like a second record.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  # logging's name
        """The first line of a record."""
        record.request_id = current_request_id.get()
        record.message = one_line(record.message)
        return super().formatMessage(record)

    def formatException(self, ei: object) -> str:  # noqa: N802  # logging's name
        """A traceback, each line marked as a continuation."""
        text = super().formatException(ei)  # type: ignore[arg-type]  # as logging has it
        return "\n".join(f"  | {one_line(line)}" for line in text.splitlines())


def configure_logging(level: str) -> None:
    """Send everything to stderr at this level; libraries speak up from warnings on."""
    to_stderr = logging.StreamHandler(sys.stderr)
    to_stderr.setFormatter(OneRecordPerLine(_FORMAT))
    logging.basicConfig(level=logging.WARNING, handlers=[to_stderr], force=True)
    # What it would say of failures, we say, without a second traceback.
    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
    for name in ("unghost", "app"):
        logging.getLogger(name).setLevel(level.upper())
