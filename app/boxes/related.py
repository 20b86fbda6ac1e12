"""Boxes that are like another one, and the same object in other frames."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import Final

from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.filter import to_filter
from app.boxes.orders import BoxPages
from app.boxes.queries import FrameRepository
from app.boxes.reader import StoredDecision, read_box
from app.catalog.datasets import DatasetRepository
from unghost.wire.boxes import BoxSelection

_BANDS_M: Final = (0.0, 50.0, 100.0, 150.0, 200.0)
_MOST_COMPARED: Final = 2000
_MOST_ALIKE: Final = 200
_NEARLY: Final = 10.0
"""Points by which the numbers of boxes that are probably the same differ at most."""

_HIDING: Final = 30.0
"""Percent of a box that a tag covers at least to be what hides it."""

_MOST_AROUND: Final = 5
_MOST_MOVED_M: Final = 15.0
"""Metres by which the distance of one object changes at most from frame to frame."""


def boxes_alike(session: Session, box_id: int) -> dict[str, object]:
    """Boxes without an answer of the same class, reason, cause, hider and band.

    A `wire.Alike` whose boxes are dicts. Raises NotFound: there is no such box.
    """
    reader, stored_box = read_box(session, box_id)
    (like,) = reader.records(stored_box)
    frame = FrameRepository(session).with_id(stored_box.rows.frame_ids[0])
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    filters: dict[str, object] = {"class": like["class"], "reason": like["reason"]}
    distance = like["distance"]
    if distance is not None:
        band = bisect_right(_BANDS_M, distance)
        filters["distance_min"] = _BANDS_M[band - 1]
        filters["distance_max"] = (*_BANDS_M, None)[band]
    selection = BoxSelection.model_validate({**filters, "review": "none"})
    pages = BoxPages(
        session,
        to_filter(session, dataset, selection),
        TallyRepository(session).of_dataset(dataset.id),
    )
    ids, _ = pages.page("id", None, _MOST_COMPARED)
    boxes = reader.read_boxes([near_id for near_id in ids if near_id != box_id])
    causes = boxes.doubts.cause.tolist()
    (cause,) = stored_box.doubts.cause.tolist()
    alike = [
        box
        for box, its_cause in zip(reader.records(boxes), causes, strict=True)
        if its_cause == cause and _hider(box) == _hider(like)
    ]
    probable = [box for box in alike if _is_nearly(box, like)]
    others = [box for box in alike if not _is_nearly(box, like)]
    items = [*probable, *others][:_MOST_ALIKE]
    shown_probable = min(len(probable), len(items))
    return {"items": items, "total": len(alike), "probable": shown_probable}


def _hider(decision: StoredDecision) -> str | None:
    """The tag that hides a large part of a box, if there is one."""
    hiding = decision["hidden_by"]
    return hiding[0]["name"] if hiding and hiding[0]["percent"] >= _HIDING else None


def _is_nearly(box: StoredDecision, other: StoredDecision) -> bool:
    pairs = (
        (box["match_percent"], other["match_percent"]),
        (box["crowding"], other["crowding"]),
    )
    return all(
        a == b or (a is not None and b is not None and abs(a - b) <= _NEARLY)
        for a, b in pairs
    )


def track_of(session: Session, box_id: int) -> list[Mapping[str, object]]:
    """The boxes of one object in the frames around, each a `wire.TrackedBox` as a dict.

    Raises NotFound: there is no such box.
    """
    reader, stored_box = read_box(session, box_id)
    frames = FrameRepository(session)
    frame = frames.with_id(stored_box.rows.frame_ids[0])
    offsets = frames.recorded_around(frame, _MOST_AROUND)
    ids = frames.boxes_named(offsets, frames.box(box_id))
    boxes = reader.records(reader.read_boxes(ids))
    by_offset = {offsets[box["frame_id"]]: box for box in boxes}
    track = {0: by_offset[0]}
    for step in (-1, 1):
        last_at = 0
        for at in range(step, step * (_MOST_AROUND + 1), step):
            box = by_offset.get(at)
            if box is None:
                continue
            a, b = track[last_at]["distance"], box["distance"]
            moved_most = _MOST_MOVED_M * abs(at - last_at)
            if a is not None and b is not None and abs(a - b) > moved_most:
                break
            track[at], last_at = box, at
    return [{**track[at], "offset": at} for at in sorted(track)]
