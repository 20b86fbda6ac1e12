"""Datasets and their classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from sqlalchemy import ColumnElement, bindparam, delete, func, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import run
from app.db.tables import Dataset, DatasetClass, Export, Run, Tally
from app.errors import Conflict, NotFound, Unprocessable

_CLASSES: Final = (
    select(DatasetClass.name, DatasetClass.id)
    .where(DatasetClass.dataset_id == bindparam("dataset"))
    .order_by(DatasetClass.position)
)


def is_there() -> ColumnElement[bool]:
    """That a dataset was not deleted."""
    return Dataset.removed_at.is_(None)


def is_deleted(session: Session, dataset_id: int) -> bool:
    """Whether what belongs to a dataset is not to be seen any more."""
    found = session.get(Dataset, dataset_id)
    return found is None or found.removed_at is not None


class DatasetRepository:
    """Rows of `datasets` and `dataset_classes`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def named(self, name: str) -> Dataset:
        """The dataset; NotFound if there is none of this name."""
        rows = select(Dataset).where(Dataset.name == name, is_there())
        found = self._session.scalar(rows)
        if found is None:
            raise NotFound("dataset", name)
        return found

    def with_id(self, dataset_id: int) -> Dataset:
        """The dataset that another row refers to; NotFound if it was deleted."""
        found = self._session.get(Dataset, dataset_id)
        if found is None or found.removed_at is not None:
            raise NotFound("dataset", dataset_id)
        return found

    def page(self, *, after: str, limit: int) -> list[Dataset]:
        """The next datasets by name."""
        rows = (
            select(Dataset)
            .where(Dataset.name > after, is_there())
            .order_by(Dataset.name)
            .limit(limit)
        )
        return list(self._session.scalars(rows))

    def add(self, dataset: Dataset, classes: Sequence[str]) -> Dataset:
        """Insert; Conflict if the name is taken."""
        self._session.add(dataset)
        try:
            self._session.flush()
        except IntegrityError as error:
            raise Conflict(
                f"a dataset {dataset.name!r} exists already", code="dataset_exists"
            ) from error
        self._append_classes(dataset.id, classes, start=0)
        return dataset

    def classes(self, dataset_id: int) -> dict[str, int]:
        """Class names in their frozen order, with their ids."""
        rows: Any = run(self._session, _CLASSES, dataset=dataset_id)
        return dict(rows.all())

    def class_ids(self, dataset: Dataset, names: Sequence[str]) -> dict[str, int]:
        """Ids of these classes; unknown ones are appended unless classes are frozen."""
        known = self.classes(dataset.id)
        missing = [name for name in dict.fromkeys(names) if name not in known]
        if not missing:
            return known
        if dataset.classes_frozen_at is not None:
            raise Unprocessable(
                f"the classes of dataset {dataset.name!r} are frozen by an export; "
                f"expected one of {', '.join(known)}, found {missing[0]!r}",
                code="unknown_class",
            )
        self._append_classes(dataset.id, missing, start=len(known))
        return self.classes(dataset.id)

    def change(self, dataset: Dataset, values: Mapping[str, Any]) -> None:
        """Set columns."""
        for name, value in values.items():
            setattr(dataset, name, value)
        self._session.flush()

    def freeze_classes(self, dataset_id: int) -> None:
        """From the first export on, an index means the same class for ever."""
        self._session.execute(
            update(Dataset)
            .where(Dataset.id == dataset_id, Dataset.classes_frozen_at.is_(None))
            .values(classes_frozen_at=utc_now())
        )

    def hide(self, dataset: Dataset) -> None:
        """Delete: from now on nobody sees it, and its name is free.

        What belongs to it goes later, see `RemovalRepository`; jobs and tallies, which
        are counted over all datasets, go now.
        """
        for table in (Run, Export):
            self._session.execute(
                update(table)
                .where(
                    table.dataset_id == dataset.id,
                    table.state.in_(("queued", "running")),
                )
                .values(state="cancelled", finished_at=utc_now())
            )
        self._session.execute(delete(Tally).where(Tally.dataset_id == dataset.id))
        # No dataset can be given such a name.
        values = {"name": f"/{dataset.id}", "removed_at": utc_now()}
        self._session.execute(
            update(Dataset).where(Dataset.id == dataset.id).values(values)
        )

    def count(self) -> int:
        """How many datasets there are."""
        rows = select(func.count()).select_from(Dataset).where(is_there())
        return self._session.scalar(rows) or 0

    def _append_classes(
        self, dataset_id: int, names: Sequence[str], *, start: int
    ) -> None:
        self._session.add_all(
            DatasetClass(dataset_id=dataset_id, position=position, name=name)
            for position, name in enumerate(names, start)
        )
        self._session.flush()
