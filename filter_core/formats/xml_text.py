"""Text for XML files that are written piece by piece."""

from __future__ import annotations

import re
from typing import Final
from xml.sax.saxutils import escape, quoteattr

_IMPOSSIBLE: Final = re.compile(
    "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
)
"""What XML 1.0 cannot hold, not even escaped."""


def element(name: str, value: object) -> str:
    """``<name>value</name>``."""
    return f"<{name}>{escaped(value)}</{name}>"


def escaped(value: object) -> str:
    """Text between tags; letters that XML cannot hold become U+FFFD."""
    return escape(_possible(value))


def attributes(**values: object) -> str:
    """`` a="1" b="x"``, quoted."""
    return "".join(
        f" {name}={quoteattr(_possible(value))}" for name, value in values.items()
    )


def _possible(value: object) -> str:
    return _IMPOSSIBLE.sub("\ufffd", str(value))
