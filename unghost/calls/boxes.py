"""Boxes, their history, and what people say about them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from unghost.calls.base import Calls
from unghost.results import (
    Answer,
    Decision,
    HistoryEntry,
    Review,
    ReviewBatch,
    Selection,
    UndoneBatch,
)
from unghost.transport import API, Call, body_of


class BoxCalls(Calls):
    """Methods on boxes and reviews."""

    def boxes(self, dataset: str, **filters: object) -> Iterator[Decision]:
        """The boxes of a dataset; filters and `sort` as in the API, `class_name` for
        `class`.
        """
        return self._all(Decision, f"{API}/boxes", _query(dataset, filters))

    def count_boxes(self, dataset: str, **filters: object) -> int:
        """How many boxes `boxes` would give."""
        query = {**_query(dataset, filters), "count": True, "limit": 1}
        response = self._transport.send(Call("GET", f"{API}/boxes", params=query))
        return int(body_of(response)["total"])

    def select_boxes(self, dataset: str, **filters: object) -> Selection:
        """All boxes of a filter as they are now, for `bulk_review`."""
        query = {**_query(dataset, filters), "count": True, "limit": 1}
        response = self._transport.send(Call("GET", f"{API}/boxes", params=query))
        found = body_of(response)
        del query["dataset"], query["count"], query["limit"]
        return Selection(
            dataset=dataset,
            filter=query,
            count=int(found["total"]),
            snapshot=str(found["snapshot"]),
        )

    def box(self, box_id: int) -> Decision:
        """One box with its decision and its neighbours."""
        return self._get(Decision, f"{API}/boxes/{box_id}")

    def history(self, box_id: int) -> Iterator[HistoryEntry]:
        """Every decision and review of a box, newest first."""
        path = f"{API}/boxes/{box_id}/history"
        return self._all(HistoryEntry, path, {"limit": None})

    def review(
        self,
        box_id: int,
        verdict: Answer,
        *,
        seen_revision: int,
        comment: str = "",
    ) -> Review:
        """Answer on one box; `StaleReview` if someone answered since.

        `seen_revision` is the `revision` of the decision that was looked at.
        """
        body = {"verdict": verdict, "seen_revision": seen_revision, "comment": comment}
        return self._post(Review, f"{API}/boxes/{box_id}/reviews", body)

    def bulk_review(
        self,
        dataset: str,
        verdict: Answer,
        boxes: Sequence[Decision] | Sequence[int] | Selection,
        *,
        comment: str = "",
    ) -> ReviewBatch:
        """One answer on many boxes: one act, one undo.

        Parameters
        ----------
        boxes
            Decisions: those boxes that nobody has answered since they were read.
            Ids: those boxes that have no answer. A selection: all of its boxes, if
            they are those that `select_boxes` counted, and as they were then.

        Returns
        -------
        ReviewBatch
            `stale` are boxes that were left alone because of an answer, `skipped`
            those that are gone.

        Raises
        ------
        StaleReview
            Boxes of the selection came, went, were decided anew or were answered
            since; `current` has their number (`total`) now.
        """
        body = {"dataset": dataset, "verdict": verdict, "comment": comment}
        return self._post(ReviewBatch, f"{API}/reviews/bulk", body | _which(boxes))

    def undo(self, batch_id: int) -> UndoneBatch:
        """Take a batch of reviews back, except where someone answered since."""
        return self._post(UndoneBatch, f"{API}/review-batches/{batch_id}/undo")


def _which(boxes: Sequence[Decision] | Sequence[int] | Selection) -> dict[str, Any]:
    if isinstance(boxes, Selection):
        return {"filter": boxes.filter, "snapshot": boxes.snapshot}
    if isinstance(boxes, Mapping):
        raise TypeError(
            "expected decisions, ids or what select_boxes answers, found a mapping"
        )
    seen = [box for box in boxes if isinstance(box, Decision)]
    if not seen:
        return {"box_ids": list(boxes)}
    if len(seen) != len(boxes):
        raise TypeError("expected decisions or ids, found both")
    return {
        "box_ids": [box.box_id for box in seen],
        "seen_revisions": [box.revision for box in seen],
    }


def _query(dataset: str, filters: Mapping[str, object]) -> dict[str, object]:
    # `class` is a keyword of Python: the filter is `class_name` here.
    query = {"dataset": dataset, **filters}
    if "class_name" in query:
        query["class"] = query.pop("class_name")
    return query
