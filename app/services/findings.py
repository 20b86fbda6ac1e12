"""What a check of `unghost doctor` found, and how bad it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

MOST_EXAMPLES: Final = 5


class Severity(str, Enum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """What one check found; `todo` says what to do, for all but the best."""

    check: str
    severity: Severity
    found: str
    todo: str = ""
    count: int = 0
    examples: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """As it is printed."""
        return {**vars(self), "severity": self.severity.value}
