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
        """Answer on one box; `StaleReview` if someone answered since."""
        body = {"verdict": verdict, "seen_revision": seen_revision, "comment": comment}
        return self._post(Review, f"{API}/boxes/{box_id}/reviews", body)

    def bulk_review(
        self,
        dataset: str,
        verdict: Answer,
        boxes: Sequence[int] | Mapping[str, Any],
        *,
        expected_count: int | None = None,
        comment: str = "",
    ) -> ReviewBatch:
        """One answer on many boxes: their ids, or all that match a filter.

        With a filter `expected_count` guards against answering for boxes that came
        since: another number is a `Conflict`.
        """
        by_filter = isinstance(boxes, Mapping)
        body = {
            "dataset": dataset,
            "verdict": verdict,
            "filter" if by_filter else "box_ids": boxes if by_filter else list(boxes),
            "expected_count": expected_count,
            "comment": comment,
        }
        given = {key: value for key, value in body.items() if value is not None}
        return self._post(ReviewBatch, f"{API}/reviews/bulk", given)

    def undo(self, batch_id: int) -> UndoneBatch:
        """Take a batch of reviews back, except where someone answered since."""
        return self._post(UndoneBatch, f"{API}/review-batches/{batch_id}/undo")


def _query(dataset: str, filters: Mapping[str, object]) -> dict[str, object]:
    # `class` is a keyword of Python: the filter is `class_name` here.
    query = {"dataset": dataset, **filters}
    if "class_name" in query:
        query["class"] = query.pop("class_name")
    return query
