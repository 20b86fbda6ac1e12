"""Rings of points for the skins of vehicles, from their right halves."""

from __future__ import annotations

import numpy as np

from app.demo.paint import Paint
from filter_core.types import FloatArray


def ring(half: FloatArray) -> FloatArray:
    """A closed ring (K, 2) of y, z from its right half, which ends on the middle."""
    left = half[-2:0:-1] * np.array([-1.0, 1.0])
    return np.concatenate([half, left])


def mirrored_columns(paints: list[Paint]) -> list[Paint]:
    """Paints of a ring's strips, from those of its right half."""
    return [*paints, *reversed(paints)]


def section(x: float, half: FloatArray) -> FloatArray:
    """The ring of `half` at one place along a vehicle."""
    closed = ring(half)
    return np.column_stack([np.full(len(closed), x), closed])
