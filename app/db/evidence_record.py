"""Evidence as bytes: one frame's numbers in one row, many frames in one array.

A database row per box would cost thirty inserts a frame and seconds to load a million
of them. A frame's evidence never changes, so it is packed column-wise into one value:
little-endian, fixed width, readable with ``numpy.frombuffer`` alone.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from filter_core.types import N_TAGS, ChannelNumbers, Evidence

NUMBERS: Final = np.dtype(
    [
        ("class_id", "<i4"),
        ("state", "u1"),
        ("measured", "?"),
        ("accept_mask", "<i8"),
        ("box_pixels", "<i8"),
        ("matched_pixels", "<i8"),
        ("image_pixels", "<i8"),
        ("match_percent", "<f8"),
        ("area_percent", "<f8"),
        ("crowding", "<f8"),
        ("distance", "<f8"),
        ("xyxy", "<f8", (4,)),
    ]
)
_SCALARS: Final = [
    name for name in NUMBERS.names or () if name not in ("class_id", "xyxy")
]
CHANNEL_NUMBERS: Final = np.dtype(
    [
        ("owned_pixels", "<i8"),
        ("explained_by", "<i4"),
        ("depth_pixels", "<i8"),
        ("nearer_percent", "<f8"),
        ("depth_gap", "<f8"),
        ("center_gap", "<f8"),
        ("instance_pixels", "<i8"),
        ("lidar_points", "<i8"),
        ("tight_xyxy", "<f8", (4,)),
    ]
)
_COUNT: Final = np.dtype([("box", "<u2"), ("tag", "u1"), ("pixels", "<u4")])
_ABSENT: Final = (float("nan"),) * 4


@dataclass(frozen=True)
class Geometry:
    """Rectangles and edges of a box that came in three dimensions."""

    amodal_xyxy: tuple[float, ...] | None
    visible_xyxy: tuple[float, ...] | None
    edges: NDArray[np.float32]


def pack_numbers(evidence: Evidence, class_ids: Sequence[int]) -> bytes:
    """Pack evidence; `class_ids` are the database's ids of ``evidence.class_names``."""
    record = np.zeros(len(evidence), NUMBERS)
    record["class_id"] = np.asarray(class_ids, np.int32)[evidence.class_index]
    for name in _SCALARS:
        record[name] = getattr(evidence, name)
    record["xyxy"] = np.nan if evidence.xyxy is None else evidence.xyxy
    return record.tobytes()


def unpack_numbers(packed: Sequence[bytes]) -> NDArray[np.void]:
    """The records of many frames, one after the other, without a copy per box."""
    return np.frombuffer(b"".join(packed), NUMBERS)


def to_evidence(
    record: NDArray[np.void],
    class_names: Sequence[str],
    class_ids: Sequence[int],
    tag_counts: NDArray[np.int32] | None = None,
) -> Evidence:
    """Evidence whose classes are named again; without what the channels say."""
    index_of = np.full(max(class_ids, default=0) + 1, -1, np.int32)
    index_of[list(class_ids)] = np.arange(len(class_ids), dtype=np.int32)
    columns: dict[str, Any] = {
        name: np.ascontiguousarray(record[name]) for name in _SCALARS
    }
    return Evidence(
        class_names=tuple(class_names),
        class_index=index_of[record["class_id"]],
        xyxy=np.ascontiguousarray(record["xyxy"]),
        tag_counts=tag_counts,
        **columns,
    )


def pack_channels(numbers: ChannelNumbers | None) -> bytes | None:
    """What the channels say; None if none was measured."""
    if numbers is None:
        return None
    record = np.zeros(len(numbers), CHANNEL_NUMBERS)
    for name in CHANNEL_NUMBERS.names or ():
        record[name] = getattr(numbers, name)
    return record.tobytes()


def unpack_channels(
    packed: Sequence[bytes | None], counts: Sequence[int]
) -> ChannelNumbers | None:
    """The channels' numbers of many frames; `counts` are their boxes.

    None if no frame has any. A frame without is one of which nothing was measured.
    """
    if not any(packed):
        return None
    absent = ChannelNumbers.absent(1)
    empty = np.zeros(1, CHANNEL_NUMBERS)
    for name in CHANNEL_NUMBERS.names or ():
        empty[name] = getattr(absent, name)
    parts = [
        np.repeat(empty, boxes) if not one else np.frombuffer(one, CHANNEL_NUMBERS)
        for one, boxes in zip(packed, counts, strict=True)
    ]
    record = np.concatenate(parts)
    columns = {
        name: np.ascontiguousarray(record[name]) for name in CHANNEL_NUMBERS.names or ()
    }
    columns["explained_by"] = columns["explained_by"].astype(np.int64)
    return ChannelNumbers(**columns)


def pack_tag_counts(counts: NDArray[np.int32] | None) -> bytes:
    """Only the tags that occur; most of a histogram is zeros."""
    if counts is None:
        return b""
    box, tag = np.nonzero(counts)
    record = np.zeros(len(box), _COUNT)
    record["box"], record["tag"] = box, tag
    record["pixels"] = counts[box, tag]
    return record.tobytes()


def unpack_tag_counts(packed: bytes, boxes: int) -> NDArray[np.int32]:
    """(boxes, N_TAGS) int32."""
    counts = np.zeros((boxes, N_TAGS), np.int32)
    record = np.frombuffer(packed, _COUNT)
    counts[record["box"], record["tag"]] = record["pixels"]
    return counts


def pack_geometry(boxes: Sequence[Geometry | None]) -> bytes:
    """Per box: number of edges (-1: not given in 3D), two rectangles, the edges."""
    parts = []
    for box in boxes:
        if box is None:
            parts.append(struct.pack("<h", -1))
            continue
        amodal, visible = box.amodal_xyxy or _ABSENT, box.visible_xyxy or _ABSENT
        parts.append(struct.pack("<h8d", len(box.edges), *amodal, *visible))
        parts.append(np.asarray(box.edges, "<f4").tobytes())
    return b"".join(parts) if any(box is not None for box in boxes) else b""


def unpack_geometry(packed: bytes, boxes: int) -> list[Geometry | None]:
    """Inverse of `pack_geometry`."""
    if not packed:
        return [None] * boxes
    found: list[Geometry | None] = []
    at = 0
    for _ in range(boxes):
        (edges,) = struct.unpack_from("<h", packed, at)
        at += 2
        if edges < 0:
            found.append(None)
            continue
        numbers = struct.unpack_from("<8d", packed, at)
        at += 64
        lines = np.frombuffer(packed, "<f4", edges * 4, at).reshape(edges, 4)
        at += edges * 16
        found.append(Geometry(_given(numbers[:4]), _given(numbers[4:]), lines))
    return found


def _given(rectangle: tuple[float, ...]) -> tuple[float, ...] | None:
    return None if rectangle[0] != rectangle[0] else rectangle
