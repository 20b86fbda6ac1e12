"""What a run changed, as bytes: a row per box would cost as much as the run itself."""

from __future__ import annotations

from typing import Final

import numpy as np

from filter_core.types import IntArray

FLIP: Final = np.dtype([("box_id", "<i8"), ("before", "u1"), ("after", "u1")])
BOXES_PER_ROW: Final = 8192
"""80 KiB: little to read for the history of one box, few rows for a million."""


def pack_flips(box_ids: IntArray, before: IntArray, after: IntArray) -> bytes:
    """Boxes in order of id, with their reasons before and after."""
    record = np.zeros(len(box_ids), FLIP)
    record["box_id"], record["before"], record["after"] = box_ids, before, after
    return record.tobytes()


def find_flip(packed: bytes, box_id: int) -> tuple[int, int] | None:
    """Reasons before and after of one box; None if it did not change."""
    record = np.frombuffer(packed, FLIP)
    at = int(np.searchsorted(record["box_id"], box_id))
    if at == len(record) or record["box_id"][at] != box_id:
        return None
    return int(record["before"][at]), int(record["after"][at])
