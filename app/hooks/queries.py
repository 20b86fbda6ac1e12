"""SQL of hooks and their deliveries, and of the datasets that they wait for."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Final

from sqlalchemy import Row, delete, func, or_, select
from sqlalchemy.orm import Session

from app.catalog.datasets import is_there
from app.db.base import Repository, existing, rfc3339, utc_now
from app.db.bulk import insert_into
from app.db.pages import NewestPage
from app.db.tables import (
    Dataset,
    Export,
    Hook,
    HookDelivery,
    JobRow,
    PendingReview,
    Tally,
)
from app.verdicts import REVIEW_STATES
from filter_core.decisions.doubt import Bin
from unghost.wire.words import DeliveredEvent, HookEvent

KEPT: Final = 200
"""How many deliveries of a hook that are over its log keeps."""


class HookRepository(Repository):
    """Rows of `hooks`, without those of deleted datasets.

    In its statements, `is_there` holds for hooks without a dataset, too.
    """

    def page(self, page: NewestPage) -> list[Row[Hook, str | None]]:
        """A page of hooks with the names of their datasets, newest first.

        It has one more if there is a next page.
        """
        rows = select(Hook, Dataset.name).outerjoin(Dataset).where(is_there())
        return list(self._session.execute(page.of(rows, Hook.id)))

    def with_id(self, hook_id: int) -> Hook:
        """One hook; NotFound if there is none."""
        rows = select(Hook).outerjoin(Dataset).where(Hook.id == hook_id, is_there())
        return existing(self._session.scalar(rows), "hook", hook_id)

    def delete(self, hook: Hook) -> None:
        """Delete a hook; its deliveries go by cascade."""
        self._session.delete(hook)
        self._session.flush()

    def told(self, event: HookEvent, dataset_id: int) -> list[Hook]:
        """The hooks that are told of an event of a dataset."""
        of_dataset = or_(Hook.dataset_id.is_(None), Hook.dataset_id == dataset_id)
        rows = select(Hook).where(of_dataset).order_by(Hook.id)
        return [hook for hook in self._session.scalars(rows) if event in hook.events]


class DeliveryRepository(Repository):
    """Rows of `hook_deliveries`."""

    def queue(
        self, hooks: Iterable[Hook], event: DeliveredEvent, data: Mapping[str, object]
    ) -> list[HookDelivery]:
        """Add a delivery of an event for each hook, which is due at once."""
        now = utc_now()
        content = {"type": event, "timestamp": rfc3339(now), "data": data}
        body = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
        rows = [
            HookDelivery(
                hook_id=hook.id,
                webhook_id=f"msg_{secrets.token_hex(12)}",
                event=event,
                body=body,
                due_at=now,
                created_at=now,
            )
            for hook in hooks
        ]
        self._session.add_all(rows)
        self._session.flush()
        return rows

    def page(self, hook_id: int, page: NewestPage) -> list[HookDelivery]:
        """The deliveries of a page, newest first, and one more if there is a next."""
        rows = select(HookDelivery).where(HookDelivery.hook_id == hook_id)
        return list(self._session.scalars(page.of(rows, HookDelivery.id)))

    def hooks_due(self, now: datetime) -> list[int]:
        """Ids of the hooks of which a delivery is due, none of a deleted dataset."""
        rows = select(HookDelivery.hook_id).join(Hook).outerjoin(Dataset)
        rows = rows.where(HookDelivery.due_at <= now, is_there()).distinct()
        return list(self._session.scalars(rows.order_by(HookDelivery.hook_id)))

    def due(self, hook_id: int, now: datetime) -> list[Row[HookDelivery, Hook]]:
        """The deliveries of a hook that are due, oldest first, each with its hook."""
        rows = select(HookDelivery, Hook).join(Hook).where(Hook.id == hook_id)
        rows = rows.where(HookDelivery.due_at <= now).order_by(HookDelivery.id)
        return list(self._session.execute(rows))

    def note_attempt(
        self,
        delivery_id: int,
        answered: int | None,
        error: str | None,
        due_at: datetime | None,
    ) -> None:
        """Store the outcome of an attempt; nothing if the hook was deleted meanwhile.

        If it was the last one, deliveries that the log keeps no longer are deleted.
        """
        row = self._session.get(HookDelivery, delivery_id)
        if row is None:
            return
        row.attempts += 1
        row.answered, row.error, row.due_at = answered, error, due_at
        if due_at is not None:
            return
        row.finished_at = utc_now()
        self._session.flush()
        over = HookDelivery.hook_id == row.hook_id, HookDelivery.due_at.is_(None)
        ids = select(HookDelivery.id).where(*over).order_by(HookDelivery.id.desc())
        oldest = self._session.scalar(ids.offset(KEPT).limit(1))
        if oldest is not None:
            old = delete(HookDelivery).where(*over, HookDelivery.id <= oldest)
            self._session.execute(old)


class PendingReviewRepository(Repository):
    """Datasets of which some hook wants to know when they have been reviewed."""

    def changes(self) -> tuple[set[int], set[int]]:
        """Datasets whose boxes to review have begun or ended.

        First those that have begun to have some, then those that have none left.
        """
        event: HookEvent = "dataset.reviewed"
        hooks = self._session.scalars(select(Hook))
        dataset_ids = {hook.dataset_id for hook in hooks if event in hook.events}
        seen = set(self._session.scalars(select(PendingReview.dataset_id)))
        if not dataset_ids:
            return set(), seen
        rows = select(Tally.dataset_id).join(Dataset, Dataset.id == Tally.dataset_id)
        is_undecided = Tally.review.in_(REVIEW_STATES["undecided"].answers)
        rows = rows.where(is_there(), Tally.bin == Bin.ASK, is_undecided)
        if None not in dataset_ids:
            rows = rows.where(Tally.dataset_id.in_(dataset_ids))
        having = rows.group_by(Tally.dataset_id).having(func.sum(Tally.boxes) > 0)
        waiting = set(self._session.scalars(having))
        return waiting - seen, seen - waiting

    def begin(self, dataset_id: int) -> None:
        """Note that a dataset has boxes to review."""
        new = insert_into(self._session, PendingReview).values(dataset_id=dataset_id)
        self._session.execute(new.on_conflict_do_nothing())

    def end(self, dataset_id: int) -> Dataset | None:
        """Note that a dataset has no box to review.

        Returns the dataset; None if it was deleted, or if this was noted already.
        """
        gone = delete(PendingReview).where(PendingReview.dataset_id == dataset_id)
        noted = self._session.execute(gone.returning(PendingReview.dataset_id)).first()
        rows = select(Dataset).where(Dataset.id == dataset_id, is_there())
        return None if noted is None else self._session.scalar(rows)


def job_ended(session: Session, row: JobRow) -> None:
    """Queue the event of a run or an export that ends in this transaction."""
    event: HookEvent = "export.ended" if isinstance(row, Export) else "run.ended"
    hooks = HookRepository(session).told(event, row.dataset_id)
    dataset = session.get(Dataset, row.dataset_id)
    if not hooks or dataset is None:
        return
    kind = row.job_kind
    data: dict[str, object] = {
        "dataset": dataset.name,
        kind: row.id,
        "state": row.state,
        "error": None if row.error is None else row.error.get("detail"),
        "url": f"/api/v1/{kind}s/{row.id}",
    }
    if isinstance(row, Export):
        data |= {"format": row.format, "name": row.name, "version": row.version}
    DeliveryRepository(session).queue(hooks, event, data)
