"""A pin of the bytes that evidence and flips are stored as, from fixed arrays."""

from dataclasses import replace
from typing import Any

import numpy as np

from app.measuring.evidence import (
    Geometry,
    pack_channels,
    pack_geometry,
    pack_numbers,
    pack_tag_counts,
)
from app.runs.queries import pack_flips
from filter_core.evidence_numbers import N_TAGS, ChannelNumbers, Evidence
from filter_core.verdicts import Reason, Verdict
from tests.support.evidence import absent_evidence

_BOXES = 3


def found() -> dict[str, Any]:
    counts = np.zeros((_BOXES, N_TAGS), np.int32)
    counts[0, [1, 14]] = 5, 70_000
    counts[2, N_TAGS - 1] = 9
    lines = np.arange(8, dtype=np.float32).reshape(2, 4) + 0.5
    shown = Geometry((1.5, 2.5, 30.0, 40.0), None, lines)
    flips = np.array([7, 8, 2**40]), np.array([0, 1, 2]), np.array([3, 4, 5])
    return {
        "numbers": pack_numbers(_evidence(counts), [41, 7]).hex(" ", 4),
        "tag_counts": pack_tag_counts(counts).hex(" ", 4),
        "geometry": pack_geometry([shown, None, shown]).hex(" ", 4),
        "channels": (pack_channels(_channels()) or b"").hex(" ", 4),
        "flips": pack_flips(*flips).hex(" ", 4),
        "reasons": {reason.name.lower(): int(reason) for reason in Reason},
        "verdicts": [verdict.value for verdict in Verdict],
    }


def _evidence(counts: np.ndarray) -> Evidence:
    whole = np.arange(_BOXES, dtype=np.int64)
    part = np.array([0.0, 33.25, np.nan])
    return replace(
        absent_evidence(("car", "walker"), np.array([1, 0, 1], np.int32)),
        state=np.array([0, 1, 2], np.uint8),
        measured=np.array([True, False, True]),
        accept_mask=whole + 2**40,
        box_pixels=whole + 100,
        matched_pixels=whole + 10,
        image_pixels=whole + 6144,
        match_percent=part + 1,
        area_percent=part + 2,
        crowding=part + 3,
        distance=part + 4,
        xyxy=np.arange(12, dtype=np.float64).reshape(3, 4) + 0.25,
        tag_counts=counts,
    )


def _channels() -> ChannelNumbers:
    numbers = ChannelNumbers.absent(_BOXES)
    numbers.owned_pixels[:] = 4, 0, -1
    numbers.explained_by[:] = -1, 2, 0
    numbers.depth_pixels[1] = 12
    numbers.nearer_percent[0] = 66.5
    numbers.depth_gap[2] = -1.25
    numbers.center_gap[0] = 0.125
    numbers.instance_pixels[2] = 70_000
    numbers.lidar_points[0] = 9
    numbers.tight_xyxy[1] = 1, 2, 3, 4
    return numbers
