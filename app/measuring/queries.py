"""SQL of datasets, classes, configurations, measurements, evidence, refused frames.

Refused frames (`problems`) are here because one statement reads a frame's key and its
problem.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from sqlalchemy import (
    ColumnElement,
    Engine,
    Select,
    and_,
    bindparam,
    delete,
    exists,
    func,
    select,
    update,
)
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import chunks, first_row, insert_rows, run
from app.db.engine import once_committed
from app.db.tables import (
    Box,
    ConfigVersion,
    Dataset,
    DatasetClass,
    Frame,
    FrameEvidence,
    Measurement,
    Problem,
    Run,
    Tally,
)
from app.errors import Conflict, NoSuchDataset, NotFound, Unprocessable
from app.measuring.frame_files import described
from app.metrics import REFUSED
from filter_core.decisions.doubt import DOUBT_VERSION
from filter_core.errors import AnnotationError, FilterError
from filter_core.pipeline import SegmentationReport
from filter_core.values import similar
from unghost.wire.datasets import MAX_CLASSES

# Built once: building a statement takes longer than executing it.
_ACTIVE: Final = (
    select(
        Dataset.id,
        Dataset.active_config_id,
        Dataset.active_run_id,
        Dataset.active_measurement_id,
        ConfigVersion.digest,
        Measurement.digest,
        Dataset.classes_frozen_at.is_not(None),
    )
    .join(ConfigVersion, ConfigVersion.id == Dataset.active_config_id)
    .join(Measurement, Measurement.id == Dataset.active_measurement_id)
    .where(Dataset.name == bindparam("name"), Dataset.removed_at.is_(None))
)
_ACTIVE_AND_KEY: Final = _ACTIVE.add_columns(
    Frame.id,
    Frame.content_digest,
    exists().where(Problem.dataset_id == Dataset.id, Problem.key == bindparam("key")),
).outerjoin(
    Frame,
    and_(
        Frame.dataset_id == Dataset.id,
        Frame.key == bindparam("key"),
        Frame.superseded_at.is_(None),
    ),
)


class ActiveRow(NamedTuple):
    """The active configuration, run and measurement of a dataset."""

    dataset_id: int
    config_id: int
    run_id: int
    measurement_id: int
    config_digest: str
    measurement_digest: str
    classes_are_frozen: bool


_WIDTH: Final = len(ActiveRow._fields)

_CLASSES: Final = (
    select(DatasetClass.name, DatasetClass.id, DatasetClass.listed)
    .where(DatasetClass.dataset_id == bindparam("dataset"))
    .order_by(DatasetClass.position)
)

_FRAMES: Final = 20_000
"""Frames that are read together, and the maximum number in a range."""

_FORGET_PROBLEMS: Final = delete(Problem).where(
    Problem.dataset_id == bindparam("dataset"), Problem.key == bindparam("frame")
)


def is_there() -> ColumnElement[bool]:
    """Condition: the dataset was not deleted."""
    return Dataset.removed_at.is_(None)


def is_deleted(session: Session, dataset_id: int) -> bool:
    """Whether a dataset was deleted, so that its rows are hidden."""
    found = session.get(Dataset, dataset_id)
    return found is None or found.removed_at is not None


_MOST_NAMES: Final = 1_000
"""Among so many datasets, the newest, the one is looked for that was meant."""


def _no_dataset(session: Session, name: str) -> NoSuchDataset:
    """The error that names the nearest of the other datasets."""
    others = select(Dataset.name).where(is_there()).order_by(Dataset.id.desc())
    known = list(session.scalars(others.limit(_MOST_NAMES)))
    return NoSuchDataset(name, similar(name, known))


_NAMED: Final = select(Dataset).where(Dataset.name == bindparam("named"), is_there())


class DatasetRepository:
    """Rows of `datasets` and `dataset_classes`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def named(self, name: str) -> Dataset:
        """The dataset; NotFound if there is none of this name."""
        found = self._session.scalar(_NAMED, {"named": name})
        if found is None:
            raise _no_dataset(self._session, name)
        return found

    def with_id(self, dataset_id: int) -> Dataset:
        """The dataset with an id from another row; NotFound if it was deleted."""
        found = self._session.get(Dataset, dataset_id)
        if found is None or found.removed_at is not None:
            raise NotFound("dataset", dataset_id)
        return found

    def with_other_doubt(self) -> list[Dataset]:
        """Those whose stored doubt another version of this code has computed."""
        rows = select(Dataset).where(Dataset.doubt_version != DOUBT_VERSION, is_there())
        return list(self._session.scalars(rows))

    def has_this_doubt(self, dataset: Dataset) -> None:
        """Note that this version of the code has computed the doubt about all boxes."""
        dataset.doubt_version = DOUBT_VERSION

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
        """Insert; Conflict if the name is taken, in upper or lower case."""
        # Only one transaction writes at a time, so nobody takes the name meanwhile.
        alike = func.lower(Dataset.name) == dataset.name.lower()
        taken = self._session.scalar(select(Dataset.name).where(alike, is_there()))
        if taken is not None:
            raise Conflict(f"a dataset {taken!r} exists already", code="dataset_exists")
        self._session.add(dataset)
        self._session.flush()
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

        Raises
        ------
        Unprocessable
            ``unknown_class``: one is unknown, and an export has frozen the classes.
        AnnotationError
            ``too_many_classes``: there would be more than `MAX_CLASSES`.
        """
        known = self.listed_classes(dataset.id)
        missing = [name for name in dict.fromkeys(names) if name not in known]
        if not missing:
            return known
        if dataset.classes_frozen_at is not None:
            raise Unprocessable(
                f"the classes of dataset {dataset.name!r} are frozen by an export; "
                f"expected one of {', '.join(known)}, found {missing[0]!r}",
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
                f"such as {new[0]!r}{_unlisted(len(before) - len(free) - len(known))}",
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
            self._session.execute(
                update(DatasetClass)
                .where(*_is_unused(dataset.id), DatasetClass.listed.is_(True))
                .values(listed=False)
            )

    def keep_classes(self, dataset_id: int, names: Sequence[str]) -> None:
        """Never give the rows of these classes to others: somebody has named them."""
        self._session.execute(
            update(DatasetClass)
            .where(DatasetClass.dataset_id == dataset_id, DatasetClass.name.in_(names))
            .values(came_with_frame=False)
        )

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
        that were measured meanwhile refer to it.

        Raises
        ------
        Conflict
            ``too_many_classes``: there would be more than `MAX_CLASSES`.
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
        rows = {
            row.name: row
            for row in self._session.scalars(
                select(DatasetClass).where(DatasetClass.dataset_id == dataset_id)
            )
        }
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
        self._session.execute(
            update(DatasetClass)
            .where(DatasetClass.id.in_(class_ids))
            .values(listed=listed)
        )

    def change(self, dataset: Dataset, values: Mapping[str, object]) -> None:
        """Set columns."""
        for name, value in values.items():
            setattr(dataset, name, value)
        self._session.flush()

    def freeze_classes(self, dataset_id: int) -> None:
        """Freeze the classes: from the first export on, their indexes are fixed."""
        self._session.execute(
            update(Dataset)
            .where(Dataset.id == dataset_id, Dataset.classes_frozen_at.is_(None))
            .values(classes_frozen_at=utc_now())
        )

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
        self._session.execute(
            update(Dataset).where(Dataset.id == dataset.id).values(values)
        )

    def _append_classes(
        self,
        dataset_id: int,
        names: Sequence[str],
        *,
        start: int,
        **values: bool,
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
    mine = DatasetClass.dataset_id == dataset_id
    return mine, DatasetClass.came_with_frame.is_(True), ~has_boxes


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


class ConfigRepository:
    """Rows of `config_versions`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def find(self, dataset_id: int, digest: str) -> ConfigVersion | None:
        """A dataset's version with this digest."""
        return self._session.scalar(
            select(ConfigVersion).where(
                ConfigVersion.dataset_id == dataset_id, ConfigVersion.digest == digest
            )
        )

    def with_id(self, config_id: int) -> ConfigVersion:
        """The version with an id from another row."""
        found = self._session.get(ConfigVersion, config_id)
        if found is None:
            raise NotFound("config", config_id)
        return found

    def with_digest(self, digest: str) -> ConfigVersion:
        """A version with this digest, of any dataset, as all of them are equal."""
        rows = (
            select(ConfigVersion)
            .join(Dataset, Dataset.id == ConfigVersion.dataset_id)
            .where(ConfigVersion.digest == digest, is_there())
        )
        found = self._session.scalar(rows.order_by(ConfigVersion.id).limit(1))
        if found is None:
            raise NotFound("config", digest)
        return found

    def add(self, version: ConfigVersion) -> ConfigVersion:
        """Insert."""
        self._session.add(version)
        self._session.flush()
        return version

    def digests(self, config_ids: Iterable[int]) -> dict[int, str]:
        """Digests by id."""
        rows = select(ConfigVersion.id, ConfigVersion.digest).where(
            ConfigVersion.id.in_(set(config_ids))
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}


class EvidenceRow(NamedTuple):
    """The packed numbers of one frame; see `app.measuring.evidence`."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    tag_counts: bytes
    geometry: bytes
    segmentation: SegmentationReport | None
    channels: bytes | None
    key: str

    @property
    def palette(self) -> str | None:
        """The tag family of the segmentation; None if none was measured."""
        return None if self.segmentation is None else self.segmentation["palette"]

    @property
    def lossy(self) -> bool:
        """Whether the segmentation had lost colours."""
        return self.segmentation is not None and self.segmentation["lossy"]


class NumbersRow(NamedTuple):
    """The columns of a frame's evidence that decisions need."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    channels: bytes | None


def _numbers(measurement_id: int) -> Select[int, int, int, bytes, bytes | None]:
    return (
        select(
            Frame.id,
            Frame.first_box_id,
            Frame.box_count,
            FrameEvidence.numbers,
            FrameEvidence.channels,
        )
        .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
        .where(FrameEvidence.measurement_id == measurement_id)
    )


class EvidenceRepository:
    """Rows of `evidence` and `measurements`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def measurement(self, dataset_id: int, digest: str) -> Measurement | None:
        """The measurement of a dataset with these options."""
        return self._session.scalar(
            select(Measurement).where(
                Measurement.dataset_id == dataset_id, Measurement.digest == digest
            )
        )

    def measurement_with_id(self, measurement_id: int) -> Measurement:
        """The measurement with an id from another row."""
        found = self._session.get(Measurement, measurement_id)
        if found is None:
            raise NotFound("measurement", measurement_id)
        return found

    def add_measurement(self, measurement: Measurement) -> Measurement:
        """Insert; returns the existing one if another transaction has inserted it."""
        self._session.add(measurement)
        try:
            with self._session.begin_nested():
                self._session.flush()
        except IntegrityError:
            found = self.measurement(measurement.dataset_id, measurement.digest)
            if found is None:
                raise
            return found
        return measurement

    def add(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Insert evidence of frames."""
        insert_rows(self._session, FrameEvidence, rows)

    def of_frames(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, EvidenceRow]:
        """Evidence by frame."""
        found: dict[int, EvidenceRow] = {}
        for chunk in chunks(dict.fromkeys(frame_ids)):
            found |= self._of_frames(chunk, measurement_id)
        return found

    def _of_frames(
        self, frame_ids: list[int], measurement_id: int
    ) -> dict[int, EvidenceRow]:
        rows = (
            select(
                FrameEvidence.frame_id,
                Frame.first_box_id,
                Frame.box_count,
                FrameEvidence.numbers,
                FrameEvidence.tag_counts,
                FrameEvidence.geometry,
                FrameEvidence.segmentation,
                FrameEvidence.channels,
                Frame.key,
            )
            .join(Frame, Frame.id == FrameEvidence.frame_id)
            .where(
                FrameEvidence.frame_id.in_(frame_ids),
                FrameEvidence.measurement_id == measurement_id,
            )
        )
        return {row[0]: EvidenceRow(*row) for row in self._session.execute(rows)}

    def reports(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, SegmentationReport | None]:
        """How the segmentations of frames were read, by frame."""
        rows = select(FrameEvidence.frame_id, FrameEvidence.segmentation).where(
            FrameEvidence.frame_id.in_(list(frame_ids)),
            FrameEvidence.measurement_id == measurement_id,
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def lossy_boxes(self, measurement_id: int) -> int:
        """How many current boxes have a lossy segmentation."""
        rows = (
            select(func.coalesce(func.sum(Frame.box_count), 0))
            .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
            .where(
                FrameEvidence.measurement_id == measurement_id,
                FrameEvidence.lossy.is_(True),
                Frame.superseded_at.is_(None),
            )
        )
        return int(self._session.scalar(rows) or 0)

    def numbers(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        frames: tuple[int, int] | None = None,
    ) -> list[NumbersRow]:
        """The numbers of current frames, in order of id.

        `frames` are the first and the last id of a range; None selects all frames.
        """
        rows = (
            _numbers(measurement_id)
            .where(Frame.dataset_id == dataset_id, Frame.superseded_at.is_(None))
            .order_by(Frame.id)
        )
        if frames is not None:
            rows = rows.where(Frame.id.between(*frames))
        return [NumbersRow(*row) for row in self._session.execute(rows)]

    def numbers_of_frames(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> list[NumbersRow]:
        """The numbers of these frames."""
        found: list[NumbersRow] = []
        for chunk in chunks(dict.fromkeys(frame_ids)):
            rows = _numbers(measurement_id).where(Frame.id.in_(chunk))
            found += [NumbersRow(*row) for row in self._session.execute(rows)]
        return found

    def unmeasured_frames(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        after: int = 0,
        until: int | None = None,
        limit: int | None = None,
    ) -> list[int]:
        """Current frames that this measurement does not cover yet, in order of id."""
        rows = (
            select(Frame.id)
            .where(*_unmeasured(dataset_id, measurement_id), Frame.id > after)
            .order_by(Frame.id)
            .limit(limit)
        )
        if until is not None:
            rows = rows.where(Frame.id <= until)
        return list(self._session.scalars(rows))

    def lacking(self, frame_ids: Iterable[int], measurement_id: int) -> set[int]:
        """Which of the frames exist and have no evidence in this measurement yet.

        Only one transaction writes at a time: the result stays valid until the commit.
        """
        found: set[int] = set()
        for chunk in chunks(frame_ids):
            rows = select(Frame.id).where(
                Frame.id.in_(chunk), ~_covered(measurement_id)
            )
            found.update(self._session.scalars(rows))
        return found

    def count_unmeasured(self, dataset_id: int, measurement_id: int) -> int:
        """How many frames `unmeasured_frames` would find."""
        rows = (
            select(func.count())
            .select_from(Frame)
            .where(*_unmeasured(dataset_id, measurement_id))
        )
        return self._session.scalar(rows) or 0


def _unmeasured(dataset_id: int, measurement_id: int) -> list[ColumnElement[bool]]:
    covered = _covered(measurement_id)
    return [Frame.dataset_id == dataset_id, Frame.superseded_at.is_(None), ~covered]


def _covered(measurement_id: int) -> ColumnElement[bool]:
    return (
        select(FrameEvidence.frame_id)
        .where(
            FrameEvidence.frame_id == Frame.id,
            FrameEvidence.measurement_id == measurement_id,
        )
        .exists()
    )


class ProblemRepository:
    """Rows of `problems`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def forget(self, dataset_id: int, key: str) -> None:
        """Delete the problem of a frame that was stored after all."""
        run(self._session, _FORGET_PROBLEMS, dataset=dataset_id, frame=key)

    def count(self, dataset_id: int) -> int:
        """How many frames of a dataset were refused and not stored since."""
        rows = (
            select(func.count())
            .select_from(Problem)
            .where(Problem.dataset_id == dataset_id)
        )
        return self._session.scalar(rows) or 0


def note_problem(
    session: Session, dataset_id: int, key: str, error: FilterError
) -> None:
    """Store a frame's refusal, so that people can find out why it is missing."""
    ProblemRepository(session).forget(dataset_id, key)
    session.add(Problem(dataset_id=dataset_id, key=key, error=described(error)))
    session.flush()
    once_committed(session, REFUSED.inc)


class KeyRow(NamedTuple):
    """The state of a frame's key: `frame_id` is None if there is no frame."""

    frame_id: int | None
    content_digest: str | None
    has_problem: bool


def key_rows(
    session: Session, dataset_id: int, keys: Collection[str]
) -> dict[str, KeyRow]:
    """The state of each of these keys in a dataset."""
    frames = select(Frame.key, Frame.id, Frame.content_digest).where(
        Frame.dataset_id == dataset_id,
        Frame.key.in_(keys),
        Frame.superseded_at.is_(None),
    )
    refused = select(Problem.key).where(
        Problem.dataset_id == dataset_id, Problem.key.in_(keys)
    )
    found = {row.key: (row.id, row.content_digest) for row in session.execute(frames)}
    problems = set(session.scalars(refused))
    absent = (None, None)
    return {key: KeyRow(*found.get(key, absent), key in problems) for key in keys}


def active_row(session: Session, name: str) -> ActiveRow:
    """The active row of a dataset, by its name; raises NotFound."""
    found = run(session, _ACTIVE, name=name).first()
    if found is None:
        raise _no_dataset(session, name)
    return ActiveRow._make(found)


def active_row_and_key(
    session: Session, name: str, key: str
) -> tuple[ActiveRow, KeyRow]:
    """The active row of a dataset and the state of a frame's key; raises NotFound."""
    found = run(session, _ACTIVE_AND_KEY, name=name, key=key).first()
    return _active_and_key(found, name)


def read_active_snapshot(
    engine: Engine, name: str, key: str
) -> tuple[ActiveRow, KeyRow]:
    """As `active_row_and_key`, without a transaction: read it again before writing."""
    return _active_and_key(first_row(engine, _ACTIVE_AND_KEY, name=name, key=key), name)


def _active_and_key(
    found: Sequence[object] | None, name: str
) -> tuple[ActiveRow, KeyRow]:
    if found is None:
        raise NotFound("dataset", name)
    return ActiveRow._make(found[:_WIDTH]), KeyRow._make(found[_WIDTH:])


def frame_ranges(
    session: Session, dataset_id: int, *, boxes: int
) -> Iterator[tuple[int, int]]:
    """First and last id of ranges that together contain all current frames."""
    after = 0
    while rows := _page(session, dataset_id, after):
        held, last = 0, rows[0][0]
        for frame_id, count in rows:
            if held and held + count > boxes:
                break
            held, last = held + count, frame_id
        yield rows[0][0], last
        after = last


def _page(session: Session, dataset_id: int, after: int) -> list[tuple[int, int]]:
    rows = (
        select(Frame.id, Frame.box_count)
        .where(
            Frame.dataset_id == dataset_id,
            Frame.superseded_at.is_(None),
            Frame.id > after,
        )
        .order_by(Frame.id)
        .limit(_FRAMES)
    )
    return [(row[0], row[1]) for row in session.execute(rows)]


def frames_state(session: Session, dataset_id: int) -> tuple[int, int]:
    """A value that changes whenever boxes are added or removed: newest id and count.

    Ids only grow and are never reused. The count is read from the tallies: counting the
    frames of a large dataset would take longer than deciding them.
    """
    newest = (
        select(Frame.id)
        .where(only_in(dataset_id))
        .order_by(Frame.dataset_id.desc(), Frame.id.desc())
        .limit(1)
    )
    boxes = select(func.sum(Tally.boxes)).where(Tally.dataset_id == dataset_id)
    return session.scalar(newest) or 0, session.scalar(boxes) or 0


def frame_before(session: Session, dataset_id: int, frame_id: int) -> int:
    """The id of the frame that was stored before this one; 0 if it was the first.

    Ids of frames are given in turn to all datasets, so that the two may be far apart.
    """
    rows = select(func.max(Frame.id)).where(
        Frame.dataset_id == dataset_id,
        Frame.superseded_at.is_(None),
        Frame.id < frame_id,
    )
    return session.scalar(rows) or 0


def only_in(dataset_id: int) -> ColumnElement[bool]:
    """Condition: frames of one dataset, for queries sorted by dataset and then id.

    It is written as a range. With an equality, PostgreSQL sorts by the id alone, and
    may scan the frames of all datasets in order of id.
    """
    return Frame.dataset_id.between(dataset_id, dataset_id)
