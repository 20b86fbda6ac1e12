"""Columns of numbers in text labels."""

from __future__ import annotations

import math
from collections.abc import Sequence

from filter_core.errors import LayoutError


def read_columns(words: Sequence[str], at: str) -> list[float]:
    """Finite numbers; LayoutError names the place and the word."""
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise LayoutError(f"{at}: expected a finite number, found {word[:40]!r}")
        numbers.append(number)
    return numbers
