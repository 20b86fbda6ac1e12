"""What each key of a configuration may hold, and how a wrong value is refused."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from filter_core.errors import ConfigError
from filter_core.values import place_of, pointer_token, shown, similar

Number = float | int

SEMANTIC: Final = "semantic"

AUTO: Final = "auto"

CHANNELS: Final = ("ordered", "depth", "depth_center", "instance", "lidar")
"""Every channel beside ``semantic``, by the name that configurations use."""

STRONGEST_FIRST: Final = ("instance", "depth", "ordered")
"""What ``auto`` tries before the segmentation alone."""

FILE_OF: Final[Mapping[str, str]] = {
    "depth": "depth",
    "depth_center": "depth",
    "instance": "instances",
    "lidar": "lidar",
}
"""The file that each channel reads; ``ordered`` needs none but the segmentation."""


@dataclass(frozen=True)
class NumberRange:
    """A number's permitted range, both ends included."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False
    nullable: bool = False

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        span = f"from {self.low:.15g} to {self.high:.15g}"
        unit = f" {self.unit}" if self.unit else ""
        return f"{kind} {span}{unit}{' or null' if self.nullable else ''}"


_PERCENT: Final = NumberRange(0, 100, "percent")

_METRES: Final = NumberRange(0, 1_000_000, "metres")

_METRES_OR_NULL: Final = NumberRange(0, 1_000_000, "metres", nullable=True)

# What a signed 32-bit column holds, so that every count can be stored anywhere.
_COUNT: Final = NumberRange(0, 2**31 - 1, whole=True)

NUMBERS: Final = {
    "threshold_small_box": _PERCENT,
    "size_big_box": _PERCENT,
    "threshold_big_box": _PERCENT,
    "min_visible_pixels": _COUNT,
    "min_distance": _METRES_OR_NULL,
    "max_distance": _METRES_OR_NULL,
    "depth_tolerance": _METRES,
    "ordered_min_pixels": _COUNT,
    "lidar_min_points": _COUNT,
}

CHOICES: Final = {
    "profile": ("paper", "carlasimu"),
    "evidence": (
        SEMANTIC,
        *CHANNELS,
        AUTO,
    ),
    "projection": ("clipped", "naive"),
    "palette": ("auto", "carla-0.9.0", "carla-0.9.10", "carla-0.9.14", "paper-table1"),
    "encoding": ("auto", "palette", "raw"),
    "channel_order": ("auto", "rgb", "bgr"),
    "lossy_segmentation": ("refuse", "nearest"),
}


def checked_number(key: str, value: object, *, at: str = "") -> Number | None:
    """The value of a numeric key in its one canonical form.

    Whole numbers become ``int`` and others ``float``, so that 10 and 10.0 are the same
    configuration with the same digest.

    Raises
    ------
    ConfigError
        Not a number, not finite, or out of range; names key, value and range.
    """
    allowed = NUMBERS[key]
    if value is None and allowed.nullable:
        return None
    # YAML's yes and no are booleans, which Python would take for 1 and 0.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _refused(key, value, str(allowed), at)
    inside = allowed.low <= value <= allowed.high  # False for NaN
    if not inside or (allowed.whole and value != int(value)):
        raise _refused(key, value, str(allowed), at)
    return int(value) if value == int(value) else value


def checked_choice(key: str, value: object) -> str:
    """The value of a key that takes one of a few words.

    Raises
    ------
    ConfigError
        Not one of the words; names the nearest.
    NotAvailable
        An evidence channel that this version does not measure yet.
    """
    words = CHOICES[key]
    if not isinstance(value, str) or value not in words:
        expected = f"one of {', '.join(words)}"
        close = similar(value, words)
        hint = f"; did you mean {close!r}?" if close else ""
        raise _refused(key, value, expected, hint=hint)
    return value


def refuse_unknown_keys(
    keys: Iterable[object], valid: Iterable[str], *, at: str = ""
) -> None:
    """Raise `ConfigError` for the first key that is none of the valid ones."""
    known = tuple(valid)
    for key in keys:
        if key not in known:
            close = similar(key, known)
            hint = (
                f"the nearest valid key is {close!r}"
                if close
                else f"expected one of {', '.join(known)}"
            )
            raise ConfigError(
                f"{place_of(at)}unknown key {_quoted(key)}; {hint}",
                pointer=f"{at}/{pointer_token(key)}",
                code="unknown_key",
            )


def _refused(
    key: str, value: object, expected: str, at: str = "", hint: str = ""
) -> ConfigError:
    return ConfigError(
        f"{place_of(at)}{key}: expected {expected}, found {shown(value)}{hint}",
        pointer=f"{at}/{key}",
    )


def _quoted(key: object) -> str:
    text = repr(key)
    return text if len(text) <= 60 else f"{text[:57]}..."


def files_for(channels: Iterable[str]) -> tuple[str, ...]:
    """The kinds of files that channels read, beside the segmentation."""
    kinds = (FILE_OF.get(name) for name in channels)
    return tuple(sorted({kind for kind in kinds if kind is not None}))
