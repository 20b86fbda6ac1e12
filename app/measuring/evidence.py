"""Packs and unpacks rows of evidence, and recounts them for other configurations.

A database row per box would need thirty inserts per frame, and seconds to load a
million rows. A frame's evidence never changes, so it is packed into one value: records
of little-endian numbers of fixed width, readable with ``numpy.frombuffer`` alone.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from app.measuring.queries import EvidenceRow
from filter_core.arrays import FloatArray, IntArray
from filter_core.config.measure import MeasureConfig
from filter_core.evidence.semantic import with_accept_sets
from filter_core.evidence_numbers import (
    N_TAGS,
    ChannelNumbers,
    Evidence,
    NumberColumn,
    number_columns,
)
from filter_core.pipeline import MeasuredFrame

_COUNT: Final = np.dtype([("box", "<u2"), ("tag", "u1"), ("pixels", "<u4")])
_ABSENT: Final = (float("nan"),) * 4
_EDGES: Final = struct.Struct("<h")
_RECTANGLES: Final = struct.Struct("<8d")
_EDGE_BYTES: Final = 16


@dataclass(frozen=True)
class Geometry:
    """Rectangles and edges of a box that was sent in three dimensions."""

    amodal_xyxy: tuple[float, ...] | None
    visible_xyxy: tuple[float, ...] | None
    edges: NDArray[np.float32]


class RecordLayout:
    """Columns of numbers as records of fixed width, one for each box.

    Records are written in the newest layout. Records of older layouts lack the columns
    that were added since; they are recognised by their bytes per box, and missing
    columns are read as "nothing measured". `columns` describes each, by its name.
    """

    def __init__(self, columns: Mapping[str, NumberColumn]) -> None:
        self.columns = columns
        newest = max(column.since for column in columns.values())
        in_turn = sorted(columns.items(), key=lambda item: item[1].since)
        # The columns of each layout, in the order in which they were added.
        self._layouts: list[np.dtype[np.void]] = [
            np.dtype(
                [
                    (
                        name,
                        np.dtype(each.stored or each.dtype).newbyteorder("<"),
                        each.shape,
                    )
                    for name, each in in_turn
                    if each.since <= layout
                ]
            )
            for layout in range(1, newest + 1)
        ]
        self.dtype = self._layouts[-1]
        self._nothing = np.zeros(1, self.dtype)
        for name, column in columns.items():
            self._nothing[name] = column.missing

    def read(
        self, packed: Sequence[bytes | None], counts: Sequence[int]
    ) -> NDArray[np.void]:
        """The records of many frames, one after the other, in the newest layout.

        `packed` are the bytes of each frame, None for one of which nothing was
        measured; `counts` are its boxes. ValueError if the number of bytes fits no
        layout for this number of boxes.
        """
        size = self.dtype.itemsize
        lengths = [-1 if each is None else len(each) for each in packed]
        if lengths == [size * boxes for boxes in counts]:
            return np.frombuffer(b"".join(filter(None, packed)), self.dtype)
        frames = zip(packed, counts, strict=True)
        return np.concatenate([self._in_newest(each, boxes) for each, boxes in frames])

    def _in_newest(self, packed: bytes | None, boxes: int) -> NDArray[np.void]:
        records = np.repeat(self._nothing, boxes)
        if packed is None:
            return records
        sizes = [layout.itemsize for layout in self._layouts]
        fitting = [size * boxes == len(packed) for size in sizes]
        if True not in fitting:
            raise ValueError(
                f"expected records of {' or '.join(map(str, sizes))} bytes for {boxes} "
                f"boxes, found {len(packed)} bytes"
            )
        older = np.frombuffer(packed, self._layouts[fitting.index(True)])
        for name in older.dtype.names or ():
            records[name] = older[name]
        return records


_CLASS_ID: Final = NumberColumn("the database's id of its class", "", "i4", 0)

_EVIDENCE: Final = number_columns(Evidence)


def _row(values: FloatArray) -> tuple[float, ...] | None:
    return None if np.isnan(values[0]) else tuple(values.tolist())


def pack_channels(numbers: ChannelNumbers | None) -> bytes | None:
    """Pack the numbers of channels; None if none was measured."""
    if numbers is None:
        return None
    record = np.zeros(len(numbers), CHANNEL_NUMBERS.dtype)
    for name in CHANNEL_NUMBERS.columns:
        record[name] = getattr(numbers, name)
    return record.tobytes()


def pack_geometry(boxes: Sequence[Geometry | None]) -> bytes:
    """Pack, per box, the number of edges (-1: no 3D box), two rectangles, the edges."""
    parts = []
    for box in boxes:
        if box is None:
            parts.append(struct.pack("<h", -1))
            continue
        amodal, visible = box.amodal_xyxy or _ABSENT, box.visible_xyxy or _ABSENT
        parts.append(struct.pack("<h8d", len(box.edges), *amodal, *visible))
        parts.append(np.asarray(box.edges, "<f4").tobytes())
    return b"".join(parts) if any(box is not None for box in boxes) else b""


def pack_numbers(evidence: Evidence, class_ids: Sequence[int]) -> bytes:
    """Pack evidence; `class_ids` are the database's ids of ``evidence.class_names``."""
    record = np.zeros(len(evidence), NUMBERS.dtype)
    record["class_id"] = np.asarray(class_ids, np.int32)[evidence.class_index]
    for name, column in _EVIDENCE.items():
        values = getattr(evidence, name)
        record[name] = column.missing if values is None else values
    return record.tobytes()


def pack_tag_counts(counts: NDArray[np.int32] | None) -> bytes:
    """Pack the counts (N, N_TAGS) of the tags that occur: most of them are zero.

    None, where no segmentation was counted, is read again as zeros.
    """
    if counts is None:
        return b""
    box, tag = np.nonzero(counts)
    record = np.zeros(len(box), _COUNT)
    record["box"], record["tag"] = box, tag
    record["pixels"] = counts[box, tag]
    return record.tobytes()


def packed(measured: MeasuredFrame, class_ids: Sequence[int]) -> dict[str, object]:
    """The columns of an evidence row."""
    boxes = measured.geometry
    geometry = [
        None
        if edges is None
        else Geometry(
            _row(boxes.amodal_xyxy[row]),
            _row(boxes.visible_xyxy[row]),
            edges.astype(np.float32),
        )
        for row, edges in enumerate(boxes.edges)
    ]
    return {
        "numbers": pack_numbers(measured.evidence, class_ids),
        "tag_counts": pack_tag_counts(measured.evidence.tag_counts),
        "geometry": pack_geometry(geometry),
        "channels": pack_channels(measured.evidence.channels),
        "segmentation": measured.segmentation,
        "lossy": measured.lossy,
    }


CHANNEL_NUMBERS: Final = RecordLayout(number_columns(ChannelNumbers))

NUMBERS: Final = RecordLayout({"class_id": _CLASS_ID, **_EVIDENCE})


def unpack_numbers(packed: Sequence[bytes], counts: Sequence[int]) -> NDArray[np.void]:
    """The records of many frames, one after the other; `counts` are their boxes."""
    return NUMBERS.read(packed, counts)


def to_evidence(
    record: NDArray[np.void],
    classes: Mapping[str, int],
    tag_counts: NDArray[np.int32] | None = None,
    channels: ChannelNumbers | None = None,
) -> Evidence:
    """Evidence from records; `classes` are the ids of the dataset's classes, by name.

    `tag_counts` and `channels` have the rows of `record`.
    """
    ids = list(classes.values())
    index_of = np.full(max(ids, default=0) + 1, -1, np.int32)
    index_of[ids] = np.arange(len(ids), dtype=np.int32)
    return Evidence(
        class_names=tuple(classes),
        class_index=index_of[record["class_id"]],
        tag_counts=tag_counts,
        channels=channels,
        **_columns(record, _EVIDENCE),
    )


def unpack_channels(
    packed: Sequence[bytes | None], counts: Sequence[int]
) -> ChannelNumbers | None:
    """The channels' numbers of many frames; `counts` are their boxes.

    None if no frame has any. A frame without them gets "nothing measured".
    """
    if not any(packed):
        return None
    record = CHANNEL_NUMBERS.read(packed, counts)
    return ChannelNumbers(**_columns(record, CHANNEL_NUMBERS.columns))


def _columns(
    record: NDArray[np.void], columns: Mapping[str, NumberColumn]
) -> dict[str, Any]:
    """Each column as a contiguous array of its type in memory."""
    return {
        name: np.ascontiguousarray(record[name], column.dtype)
        for name, column in columns.items()
    }


def unpack_tag_counts(packed: bytes, boxes: int) -> NDArray[np.int32]:
    """(boxes, N_TAGS) int32."""
    return unpack_chosen_tag_counts([packed], [boxes], np.arange(boxes))


def unpack_chosen_tag_counts(
    packed: Sequence[bytes], counts: Sequence[int], chosen: IntArray
) -> NDArray[np.int32]:
    """(N, N_TAGS) int32 of N boxes among those of many frames.

    `packed` are the bytes of each frame, and `counts` its boxes; `chosen` (N,) int64
    are indexes into the boxes of all frames, one frame after the other; none twice.
    """
    record = np.frombuffer(b"".join(packed), _COUNT)
    starts = np.cumsum([0, *counts])
    sizes = [len(each) // _COUNT.itemsize for each in packed]
    row_of = np.full(starts[-1], -1)
    row_of[chosen] = np.arange(len(chosen))
    rows = row_of[record["box"] + np.repeat(starts[:-1], sizes)]
    is_chosen = rows >= 0
    table = np.zeros((len(chosen), N_TAGS), np.int32)
    table[rows[is_chosen], record["tag"][is_chosen]] = record["pixels"][is_chosen]
    return table


def unpack_geometry(
    packed: bytes, boxes: int, chosen: Sequence[int] | None = None
) -> list[Geometry | None]:
    """The inverse of `pack_geometry`, for all boxes of a frame or for chosen ones."""
    places = range(boxes) if chosen is None else chosen
    if not packed:
        return [None] * len(places)
    starts, at = [], 0
    for _ in range(boxes):
        starts.append(at)
        (edges,) = _EDGES.unpack_from(packed, at)
        at += _EDGES.size
        if edges >= 0:
            at += _RECTANGLES.size + edges * _EDGE_BYTES
    return [_geometry_at(packed, starts[place]) for place in places]


def _geometry_at(packed: bytes, at: int) -> Geometry | None:
    (edges,) = _EDGES.unpack_from(packed, at)
    if edges < 0:
        return None
    at += _EDGES.size
    numbers = _RECTANGLES.unpack_from(packed, at)
    lines = np.frombuffer(packed, "<f4", edges * 4, at + _RECTANGLES.size)
    # NaN, which alone differs from itself, stands for a rectangle that there is not.
    amodal, visible = (
        None if xyxy[0] != xyxy[0] else xyxy for xyxy in (numbers[:4], numbers[4:])
    )
    return Geometry(amodal, visible, lines.reshape(edges, 4))


def recount(
    row: EvidenceRow, classes: Mapping[str, int], config: MeasureConfig
) -> Evidence:
    """A frame's stored evidence as `config` would have measured it, without images.

    Its accept sets and class names come from `config`, the counts of tags are those
    that are stored. `classes` are the database's ids of the dataset's classes.
    """
    evidence = to_evidence(
        unpack_numbers([row.numbers], [row.box_count]),
        classes,
        unpack_tag_counts(row.tag_counts, row.box_count),
    )
    names = tuple(config.renamed.get(name, name) for name in classes)
    evidence = replace(evidence, class_names=names)
    return with_accept_sets(evidence, config, row.palette)


def recounted_row(
    row: EvidenceRow,
    evidence: Evidence,
    classes: Mapping[str, int],
    measurement_id: int,
) -> dict[str, object]:
    """An evidence row with recounted numbers and otherwise the same content."""
    class_ids = [classes[name] for name in evidence.class_names]
    same = ("tag_counts", "geometry", "channels", "segmentation", "lossy")
    return {
        "frame_id": row.frame_id,
        "measurement_id": measurement_id,
        "numbers": pack_numbers(evidence, class_ids),
        **{name: getattr(row, name) for name in same},
    }
