"""Datasets and their classes: reading, adding, renaming, listing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from sqlalchemy import ColumnElement, bindparam, exists, func, select, update
from sqlalchemy.orm import Session

from app.db.base import Repository, insert_row, utc_now
from app.db.bulk import run
from app.db.tables import Box, Dataset, DatasetClass, Frame, Run, Tally
from app.errors import Conflict, NoSuchDataset, NotFound, Unprocessable
from filter_core.decisions.doubt import DOUBT_VERSION
from filter_core.errors import AnnotationError
from filter_core.values import similar
from unghost.wire.datasets import MAX_CLASSES


def is_there() -> ColumnElement[bool]:
    """Condition: the dataset was not deleted."""
    return Dataset.removed_at.is_(None)


def is_deleted(session: Session, dataset_id: int) -> bool:
    """Whether a dataset was deleted, so that its rows are hidden."""
    dataset = session.get(Dataset, dataset_id)
    return dataset is None or dataset.removed_at is not None


_MOST_NAMES: Final = 1_000
"""Among so many datasets, the newest, the one is looked for that was meant."""


def no_dataset(session: Session, name: str) -> NoSuchDataset:
    """The error that names the nearest of the other datasets."""
    others = select(Dataset.name).where(is_there()).order_by(Dataset.id.desc())
    names = list(session.scalars(others.limit(_MOST_NAMES)))
    return NoSuchDataset(name, similar(name, names))


_NAMED: Final = select(Dataset).where(Dataset.name == bindparam("named"), is_there())


_CLASSES: Final = (
    select(DatasetClass.name, DatasetClass.id, DatasetClass.listed)
    .where(DatasetClass.dataset_id == bindparam("dataset"))
    .order_by(DatasetClass.position)
)


class DatasetRepository(Repository):
    """Rows of `datasets` and `dataset_classes`."""

    def named(self, name: str) -> Dataset:
        """The dataset; NotFound if there is none of this name."""
        dataset = self._session.scalar(_NAMED, {"named": name})
        if dataset is None:
            raise no_dataset(self._session, name)
        return dataset

    def with_id(self, dataset_id: int) -> Dataset:
        """The dataset with an id from another row; NotFound if it was deleted."""
        dataset = self._session.get(Dataset, dataset_id)
        if dataset is None or dataset.removed_at is not None:
            raise NotFound("dataset", dataset_id)
        return dataset

    def with_other_doubt(self) -> list[Dataset]:
        """Those whose stored doubt another version of this code has computed."""
        rows = select(Dataset).where(Dataset.doubt_version != DOUBT_VERSION, is_there())
        return list(self._session.scalars(rows))

    def has_this_doubt(self, dataset: Dataset) -> None:
        """Note that this version of the code has computed the doubt about all boxes."""
        dataset.doubt_version = DOUBT_VERSION

    def page(self, *, after: str, limit: int) -> list[Dataset]:
        """The next datasets by name."""
        rows = select(Dataset).where(Dataset.name > after, is_there())
        return list(self._session.scalars(rows.order_by(Dataset.name).limit(limit)))

    def add(self, dataset: Dataset, classes: Sequence[str]) -> Dataset:
        """Insert; Conflict if the name is taken, in upper or lower case."""
        # Only one transaction writes at a time, so nobody takes the name meanwhile.
        alike = func.lower(Dataset.name) == dataset.name.lower()
        taken = self._session.scalar(select(Dataset.name).where(alike, is_there()))
        if taken is not None:
            raise Conflict(f"a dataset {taken!r} exists already", code="dataset_exists")
        insert_row(self._session, dataset)
        self._append_classes(dataset.id, classes, start=0)
        return dataset

    def classes(self, dataset_id: int) -> dict[str, int]:
        """The names of all its classes in their order, with their ids.

        Also those that are not listed any more, which earlier measurements have.
        """
        rows = run(self._session, _CLASSES, dataset=dataset_id)
        return {row.name: row.id for row in rows}

    def listed_classes(self, dataset_id: int) -> dict[str, int]:
        """The names of the classes that it has now, with their ids, as exports do."""
        rows = run(self._session, _CLASSES, dataset=dataset_id)
        return {row.name: row.id for row in rows if row.listed}

    def class_ids(self, dataset: Dataset, names: Sequence[str]) -> dict[str, int]:
        """Ids of the dataset's classes, to which unknown ones of `names` are added.

        If there would be too many, new ones take the rows of those that no box has.
        Raises Unprocessable (``unknown_class``) if one is unknown, and an export has
        frozen the classes, and AnnotationError (``too_many_classes``) if there would be
        more than `MAX_CLASSES`.
        """
        listed = self.listed_classes(dataset.id)
        missing = [name for name in dict.fromkeys(names) if name not in listed]
        if not missing:
            return listed
        if dataset.classes_frozen_at is not None:
            raise Unprocessable(
                f"the classes of dataset {dataset.name!r} are frozen by an export; "
                f"expected one of {', '.join(listed)}, found {missing[0]!r}",
                code="unknown_class",
            )
        before = self.classes(dataset.id)
        new = [name for name in missing if name not in before]
        free: list[int] = []
        if new and len(before) + len(new) > MAX_CLASSES:
            free = self._classes_without_boxes(dataset.id)
        count = len(before) - len(free) + len(new)
        if new and count > MAX_CLASSES:
            raise AnnotationError(
                f"{_too_many(dataset, count)} those of this frame, "
                f"such as {new[0]!r}{_unlisted(len(before) - len(free) - len(listed))}",
                pointer="/boxes",
                code="too_many_classes",
            )
        self._list_classes(
            [before[name] for name in missing if name in before], listed=True
        )
        for class_id, name in zip(free, new, strict=False):
            row = update(DatasetClass).where(DatasetClass.id == class_id)
            self._session.execute(row.values(name=name, listed=True))
        self._append_classes(
            dataset.id, new[len(free) :], start=len(before), came_with_frame=True
        )
        return self.listed_classes(dataset.id)

    def forget_unused_classes(self, dataset: Dataset) -> None:
        """Do not list classes any more that came with frames and that no box has."""
        if dataset.classes_frozen_at is None:
            listed = (*_is_unused(dataset.id), DatasetClass.listed.is_(True))
            rows = update(DatasetClass).where(*listed)
            self._session.execute(rows.values(listed=False))

    def keep_classes(self, dataset_id: int, names: Sequence[str]) -> None:
        """Never give the rows of these classes to others: somebody has named them."""
        rows = update(DatasetClass).where(DatasetClass.dataset_id == dataset_id)
        named = rows.where(DatasetClass.name.in_(names))
        self._session.execute(named.values(came_with_frame=False))

    def _classes_without_boxes(self, dataset_id: int) -> list[int]:
        """Ids of classes that are not listed, and that no revision of a frame has."""
        rows = select(DatasetClass.id).where(
            *_is_unused(dataset_id), DatasetClass.listed.is_(False)
        )
        unused = list(self._session.scalars(rows.order_by(DatasetClass.position)))
        if not unused:
            return []
        earlier = (
            select(Box.class_id)
            .join(Frame, Frame.id == Box.frame_id)
            .where(Frame.dataset_id == dataset_id, Frame.superseded_at.is_not(None))
            .distinct()
        )
        used = set(self._session.scalars(earlier))
        return [class_id for class_id in unused if class_id not in used]

    def add_unlisted_class(self, dataset: Dataset, name: str) -> None:
        """Prepare a class that `rename_classes` lists later; nothing if it exists.

        If the run that renames does not succeed, it stays for the next one: numbers
        that were measured meanwhile refer to it. Raises Conflict
        (``too_many_classes``) if there would be more than `MAX_CLASSES`.
        """
        before = self.classes(dataset.id)
        if name in before:
            return
        count = len(before) + 1
        if count > MAX_CLASSES:
            unlisted = len(before) - len(self.listed_classes(dataset.id))
            raise Conflict(
                f"{_too_many(dataset, count)} {name!r}{_unlisted(unlisted)}; merge "
                "into a class that there is, or make a new dataset",
                code="too_many_classes",
            )
        self._append_classes(dataset.id, [name], start=len(before), listed=False)

    def rename_classes(self, dataset_id: int, renamed: Mapping[str, str]) -> None:
        """List the classes to which others were renamed, in place of those.

        A class that was not listed before takes the position of the one that it
        replaces. `renamed` may have names that were given up earlier as well.
        """
        of_dataset = select(DatasetClass).where(DatasetClass.dataset_id == dataset_id)
        rows = {row.name: row for row in self._session.scalars(of_dataset)}
        for former, name in renamed.items():
            old, new = rows.get(former), rows[name]
            if old is None or not old.listed:
                continue
            if not new.listed:
                places = old.position, new.position
                # No two classes may have one position, not even for a moment.
                for row, position in ((old, -1), (new, places[0]), (old, places[1])):
                    row.position = position
                    self._session.flush()
            old.listed, new.listed = False, True
        for name in renamed.values():
            rows[name].listed = True
        self._session.flush()

    def remove_class(self, class_id: int) -> None:
        """Do not list a class any more; its number is that of no other one."""
        self._list_classes([class_id], listed=False)

    def _list_classes(self, class_ids: Sequence[int], *, listed: bool) -> None:
        rows = update(DatasetClass).where(DatasetClass.id.in_(class_ids))
        self._session.execute(rows.values(listed=listed))

    def change(self, dataset: Dataset, values: Mapping[str, object]) -> None:
        """Set columns."""
        for name, value in values.items():
            setattr(dataset, name, value)
        self._session.flush()

    def freeze_classes(self, dataset_id: int) -> None:
        """Freeze the classes: from the first export on, their indexes are fixed."""
        is_open = Dataset.id == dataset_id, Dataset.classes_frozen_at.is_(None)
        rows = update(Dataset).where(*is_open)
        self._session.execute(rows.values(classes_frozen_at=utc_now()))

    def activate(self, dataset: Dataset, run: Run) -> None:
        """Make a run's configuration and measurement the current ones."""
        dataset.active_config_id = run.config_id
        dataset.active_run_id = run.id
        dataset.active_measurement_id = run.measurement_id
        self._session.flush()

    def hide(self, dataset: Dataset) -> None:
        """Delete a dataset: it is not found any more, and its name is free.

        Its rows are removed later, see `RemovalRepository`. The caller ends its jobs
        and clears its tallies.
        """
        # An invalid name for a dataset, so that no new one can have it.
        values = {"name": f"/{dataset.id}", "removed_at": utc_now()}
        rows = update(Dataset).where(Dataset.id == dataset.id)
        self._session.execute(rows.values(values))

    def _append_classes(
        self, dataset_id: int, names: Sequence[str], *, start: int, **values: bool
    ) -> None:
        self._session.add_all(
            DatasetClass(dataset_id=dataset_id, position=position, name=name, **values)
            for position, name in enumerate(names, start)
        )
        self._session.flush()


def _is_unused(dataset_id: int) -> tuple[ColumnElement[bool], ...]:
    """Conditions: a class came with a frame, and no current box has it."""
    has_boxes = exists().where(
        Tally.dataset_id == dataset_id,
        Tally.class_id == DatasetClass.id,
        Tally.boxes > 0,
    )
    of_dataset = DatasetClass.dataset_id == dataset_id
    return of_dataset, DatasetClass.came_with_frame.is_(True), ~has_boxes


def _too_many(dataset: Dataset, count: int) -> str:
    return (
        f"expected at most {MAX_CLASSES} classes in dataset {dataset.name!r}, "
        f"found {count} with"
    )


def _unlisted(count: int) -> str:
    """How many classes are not listed, which stored numbers may refer to."""
    if not count:
        return ""
    return f" ({count} of them {'was' if count == 1 else 'were'} renamed or removed)"
