"""Renames, merges and removes classes of a dataset.

A class is renamed or merged by a run, which measures its boxes as those of the other
class, and makes the change when it is done. The dataset remembers the former name:
boxes that come with it later get the present one, and annotations stay as they came in.
"""

from __future__ import annotations

from dataclasses import replace

from sqlalchemy.orm import Session

from app.access.audit import AuditTrail
from app.boxes.current import TallyRepository
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.tables import Dataset, Run
from app.errors import Conflict, NoSuchClass
from app.runs import service as runs
from filter_core.values import similar


def rename_class(
    context: ServiceContext, audit: AuditTrail, dataset: Dataset, former: str, name: str
) -> Run:
    """Request the run that gives a class a new name.

    Raises NoSuchClass if there is no such class, and Conflict: ``class_exists`` if
    there is a class of the new name, or boxes that came with that name are in another
    class; ``classes_frozen``; ``classes_change`` if an open run renames classes;
    ``too_many_classes`` if the new name would be one more than a dataset may have.
    """
    session = audit.session
    listed = _changeable(session, dataset, former)
    if name in listed:
        raise Conflict(
            f"dataset {dataset.name!r} has a class {name!r} already; merge {former!r} "
            f"into it to make them one",
            code="class_exists",
        )
    reading, _ = runs.coming_settings(session, dataset)
    owner = reading.renamed_classes.get(name, former)
    if owner != former:
        raise Conflict(
            f"boxes that come in as {name!r} are in class {owner!r}, which was called "
            f"so before; expected another name for {former!r}",
            code="class_exists",
        )
    DatasetRepository(session).add_unlisted_class(dataset, name)
    return _request(context, audit, dataset, former, name)


def merge_class(
    context: ServiceContext, audit: AuditTrail, dataset: Dataset, former: str, into: str
) -> Run:
    """Request the run that moves the boxes of a class to another one.

    Raises NoSuchClass if there is no such class, and Conflict: ``same_class`` if both
    are one class; ``classes_frozen``; ``classes_change``.
    """
    listed = _changeable(audit.session, dataset, former)
    _require_class(dataset, into, listed)
    if former == into:
        raise Conflict(
            f"class {former!r} cannot be merged into itself", code="same_class"
        )
    return _request(context, audit, dataset, former, into)


def remove_class(session: Session, dataset: Dataset, name: str) -> None:
    """Remove a class without boxes, at once.

    Raises NoSuchClass if there is no such class, and Conflict: ``class_in_use`` if it
    has boxes; ``classes_frozen``; ``classes_change``.
    """
    class_id = _changeable(session, dataset, name)[name]
    tallies = TallyRepository(session).of_dataset(dataset.id)
    boxes = sum(count for key, count in tallies.items() if key.class_id == class_id)
    if boxes:
        raise Conflict(
            f"class {name!r} of dataset {dataset.name!r} has {boxes} "
            f"{'box' if boxes == 1 else 'boxes'}; merge it into another class, or "
            "delete or replace their frames first",
            code="class_in_use",
        )
    DatasetRepository(session).remove_class(class_id)


def _changeable(session: Session, dataset: Dataset, name: str) -> dict[str, int]:
    """The dataset's classes with their ids, if class `name` may be changed."""
    listed = DatasetRepository(session).listed_classes(dataset.id)
    _require_class(dataset, name, listed)
    if dataset.classes_frozen_at is not None:
        raise Conflict(
            f"the classes of dataset {dataset.name!r} are frozen, since exported "
            f"labels refer to their numbers; a configuration with `classes: {{{name}: "
            "NAME}` measures its boxes as another class, and a new dataset can have "
            "other classes",
            code="classes_frozen",
        )
    if runs.is_renaming_classes(session, dataset):
        raise Conflict(
            f"a run is renaming classes of dataset {dataset.name!r}; change others "
            "when it has ended",
            code="classes_change",
        )
    return listed


def _require_class(dataset: Dataset, name: str, listed: dict[str, int]) -> None:
    if name not in listed:
        raise NoSuchClass(dataset.name, name, similar(name, listed))


def _request(
    context: ServiceContext, audit: AuditTrail, dataset: Dataset, former: str, name: str
) -> Run:
    session = audit.session
    DatasetRepository(session).keep_classes(dataset.id, (former, name))
    reading, config = runs.coming_settings(session, dataset)
    renamed = {
        sent: name if now == former else now
        for sent, now in reading.renamed_classes.items()
    }
    renamed = {sent: now for sent, now in renamed.items() if sent != name}
    coming = replace(reading, renamed_classes={**renamed, former: name})
    request = runs.RunRequest(config, audit.name, True, coming)
    return runs.request_run(context, session, dataset, request)
