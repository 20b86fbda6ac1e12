"""Selects all boxes of a filter for a bulk answer, if they are as the client saw them.

A list is sent with a *snapshot* of its filter: how many boxes it selects, and the ids
of the newest box, answer and run. Ids only grow. So if the filter later selects as many
boxes, and none of them is newer than the snapshot, they are the same boxes in the same
state. The service need not store which boxes were listed.
"""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import asdict, dataclass

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.counts import count_boxes
from app.boxes.filter import BoxProbes, filters_of, to_filter
from app.boxes.queries import LatestAnswers
from app.context import ServiceContext
from app.db.base import filled
from app.db.tables import Dataset
from app.errors import StaleSnapshot, TooLarge, Unprocessable
from unghost.wire.boxes import BoxSelection


@dataclass(frozen=True)
class Snapshot:
    """The state of a filter's boxes at one time; `filters` is the filter's digest."""

    filters: str
    total: int
    last_box: int
    last_review: int
    run: int

    def encoded(self) -> str:
        """The snapshot as text for the wire; equal for equal states."""
        text = json.dumps(list(asdict(self).values()), separators=(",", ":"))
        return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")

    @classmethod
    def decoded(cls, text: str) -> Snapshot:
        """The snapshot that `encoded` wrote; Unprocessable for any other text."""
        try:
            padded = text + "=" * (-len(text) % 4)
            filters, *numbers = json.loads(base64.urlsafe_b64decode(padded))
            ids = [int(number) for number in numbers]
            if not all(0 <= number < 2**63 for number in ids):
                raise ValueError("expected numbers that a database can store as ids")
            return cls(str(filters), *ids)
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise Unprocessable(
                "snapshot: expected one from the response of a list of boxes, found "
                f"{text[:80]!r}",
                code="bad_snapshot",
            ) from error


def take_snapshot(
    session: Session, dataset: Dataset, selection: BoxSelection, total: int
) -> str:
    """The snapshot of a filter that selects `total` boxes, as text for the wire."""
    return _snapshot(session, dataset, selection, total).encoded()


def select_boxes(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    selection: BoxSelection,
    seen: str,
) -> list[int]:
    """All boxes of a filter, if nothing has changed since the snapshot `seen`.

    Raises Unprocessable: the snapshot is invalid, or of another filter; StaleSnapshot:
    a box was added, removed, decided again or answered since; TooLarge: the filter
    selects more boxes than one bulk answer may change.
    """
    before = Snapshot.decoded(seen)
    boxes = to_filter(session, dataset, selection)
    total = count_boxes(context, session, dataset, boxes)
    now = _snapshot(session, dataset, selection, total)
    if now.filters != before.filters:
        raise Unprocessable(
            "snapshot: expected that of a list with this filter of this dataset, "
            "found that of another list",
            code="bad_snapshot",
        )
    limit = context.settings.max_bulk_boxes
    if total > limit:
        raise TooLarge(
            f"the filter selects {total} boxes, one bulk answer changes at most {limit}"
        )
    ids = np.sort(BoxProbes(session).every(boxes))
    # Those that are new, or were decided again or answered since.
    is_changed = ids > before.last_box
    if now.run != before.run:
        is_changed[:] = True
    elif now.last_review > before.last_review:
        answered = LatestAnswers(session).boxes_after(before.last_review)
        is_changed |= np.isin(ids, answered)
    changed = int(np.count_nonzero(is_changed))
    if changed or total != before.total:
        raise StaleSnapshot(
            expected=before.total,
            found=total,
            changed=changed,
            current={"total": total, "snapshot": now.encoded()},
        )
    return [int(box_id) for box_id in ids]


def _snapshot(
    session: Session, dataset: Dataset, selection: BoxSelection, total: int
) -> Snapshot:
    # A filter is told by its parameters, since the boxes it selects may change.
    parameters: dict[str, object] = {
        "dataset": dataset.id,
        "filter": filters_of(selection),
    }
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()
    return Snapshot(
        filters=digest[:16],
        total=total,
        last_box=BoxProbes(session).newest_id(),
        last_review=LatestAnswers(session).newest_id(),
        run=filled(dataset.active_run_id),
    )
