"""SQL of frames, their files, blobs and boxes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from sqlalchemy import (
    ColumnElement,
    Executable,
    Row,
    Select,
    Text,
    and_,
    bindparam,
    case,
    delete,
    exists,
    func,
    literal_column,
    or_,
    select,
    type_coerce,
    update,
)
from sqlalchemy.orm import undefer

from app.boxes.filter import BoxFilter
from app.catalog.datasets import is_deleted
from app.catalog.frames import current_in, only_in
from app.db import bulk
from app.db.base import Repository, existing, utc_now
from app.db.pages import id_of_cursor, name_of_cursor
from app.db.tables import Blob, Box, Decision, Frame, FrameFile, IdBlock, Review
from app.errors import NotFound
from app.verdicts import REVIEW_STATES, is_effective
from filter_core.arrays import IntArray
from filter_core.verdicts import Verdict

# Built once: every upload executes it, and building takes longer than executing.
_TAKE_IDS: Final = (
    update(IdBlock)
    .values(
        next_id=IdBlock.next_id
        + case(
            (IdBlock.name == "frames", bindparam("frames")),
            (IdBlock.name == "boxes", bindparam("boxes")),
            else_=0,
        )
    )
    .returning(IdBlock.name, IdBlock.next_id)
)


class FileRow(NamedTuple):
    """A file of a frame."""

    kind: str
    sha256: str
    size_bytes: int
    media_type: str


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list, and in which order; ``-`` before `sort` reverses it."""

    sort: str
    cursor: str | None
    limit: int


class CurrentBoxes(NamedTuple):
    """Boxes of the newest revisions of frames with their latest answers, as columns.

    `source_ids` are the sender's own ids. An answer is None if there is none or it was
    undone; `revisions` count undone answers as well. `doubts` are those of
    `filter_core.decisions.doubt`.
    """

    box_ids: Sequence[int] = ()
    frame_ids: Sequence[int] = ()
    source_ids: Sequence[str] = ()
    answers: Sequence[str | None] = ()
    revisions: Sequence[int] = ()
    doubts: Sequence[int] = ()


_CURRENT_BOXES: Final = select(
    Decision.box_id,
    Decision.frame_id,
    Box.source_id,
    Decision.review,
    Decision.revision,
    Decision.doubt,
).join(Box, Box.id == Decision.box_id)

_NAMED_BOXES: Final = _CURRENT_BOXES.where(
    Decision.box_id.in_(bindparam("boxes", expanding=True))
)


PlaceRow: TypeAlias = (
    "Row[int, str, str | None, str | None, str | None, str | None, int]"
)
"""Columns of a frame, by name: `box_count`, and what tables repeat for each box."""


# Statements of a filter are kept: to build one takes as long as to read its rows.
@lru_cache
def _frames_after(
    box_filter: BoxFilter,
) -> Select[int, str, str | None, str | None, str | None, str | None, int]:
    places = (Frame.map, Frame.camera, Frame.sequence, Frame.weather)
    return (
        select(Frame.id, Frame.key, *places, Frame.box_count)
        .where(*box_filter.frame_conditions(), Frame.id > bindparam("after"))
        .order_by(Frame.id)
        .limit(bindparam("most"))
    )


@lru_cache
def _boxes_between(
    box_filter: BoxFilter,
) -> Select[int, int, str, str | None, int, int]:
    return _CURRENT_BOXES.where(
        Decision.frame_id.between(bindparam("first"), bindparam("last")),
        *box_filter.conditions_by_id(),
    ).order_by(Decision.frame_id, Decision.box_id)


_BoxRow: TypeAlias = Row[int, int, str, str | None, int, int]


def _columns(rows: Iterable[_BoxRow]) -> CurrentBoxes:
    box_ids: list[int] = []
    frame_ids: list[int] = []
    source_ids: list[str] = []
    answers: list[str | None] = []
    revisions: list[int] = []
    doubts: list[int] = []
    # One row at a time: thousands of live rows keep the garbage collector busy.
    for row in rows:
        box_ids.append(row[0])
        frame_ids.append(row[1])
        source_ids.append(row[2])
        answers.append(row[3])
        revisions.append(row[4])
        doubts.append(row[5])
    return CurrentBoxes(box_ids, frame_ids, source_ids, answers, revisions, doubts)


class FrameOfPart(NamedTuple):
    """What tells the part of a frame; the last two as its annotation says."""

    key: str
    map: str | None
    sequence: str | None
    split: str | None


PLACES: Final = ("map", "weather", "camera", "sequence")
"""Columns of frames that say where, how and by what they were recorded."""


class FrameRepository(Repository):
    """Rows of `frames`, `frame_files`, `blobs` and `boxes`."""

    def current(self, dataset_id: int, key: str) -> Frame:
        """The newest revision under a key; raises NotFound."""
        rows = select(Frame).where(*current_in(dataset_id), Frame.key == key)
        return existing(self._session.scalar(rows), "frame", key)

    def with_id(self, frame_id: int, *, annotation: bool = False) -> Frame:
        """A frame, with its annotation on request; raises NotFound."""
        options = [undefer(Frame.annotation)] if annotation else []
        frame = self._session.get(Frame, frame_id, options=options)
        if frame is None or is_deleted(self._session, frame.dataset_id):
            raise NotFound("frame", frame_id)
        return frame

    def with_ids(
        self, frame_ids: Iterable[int], *, annotation: bool = False
    ) -> dict[int, Frame]:
        """Frames by id, with their annotations on request."""
        rows = select(Frame).where(Frame.id.in_(set(frame_ids)))
        if annotation:
            rows = rows.options(undefer(Frame.annotation))
        return {frame.id: frame for frame in self._session.scalars(rows)}

    def current_boxes(self, box_ids: Sequence[int]) -> CurrentBoxes:
        """Boxes in the order of `box_ids`; those that no longer exist are left out."""
        rows_by_id: dict[int, _BoxRow] = {}
        for chunk in bulk.chunks(box_ids):
            rows = self._session.connection().execute(_NAMED_BOXES, {"boxes": chunk})
            rows_by_id |= {row[0]: row for row in rows}
        return _columns(
            [rows_by_id[box_id] for box_id in box_ids if box_id in rows_by_id]
        )

    def current_boxes_of(self, frame_ids: Iterable[int]) -> CurrentBoxes:
        """All boxes of frames, in order of id; none of a frame that was replaced."""
        rows = _CURRENT_BOXES.where(Decision.frame_id.in_(list(frame_ids)))
        # By the connection, not the session: a third faster for thousands of rows.
        boxes = self._session.connection().execute(rows.order_by(Decision.box_id))
        return _columns(boxes)

    def places_of(
        self, box_filter: BoxFilter, *, after: int, boxes: int
    ) -> tuple[list[PlaceRow], bool]:
        """The next frames that can have such boxes, by id, and whether more follow.

        As many as have `boxes` boxes together, at least one.
        """
        places: list[PlaceRow] = []
        total = 0
        rows = bulk.run(
            self._session, _frames_after(box_filter), after=after, most=boxes
        )
        with closing(rows):
            for row in rows:
                total += row.box_count
                if places and total > boxes:
                    return places, True
                places.append(row)
        return places, len(places) == boxes

    def boxes_between(
        self, box_filter: BoxFilter, frames: Sequence[PlaceRow]
    ) -> CurrentBoxes:
        """The boxes of a filter in consecutive frames, by frame and id."""
        if not frames:
            return CurrentBoxes()
        ends = {"first": frames[0].id, "last": frames[-1].id}
        connection = self._session.connection()
        return _columns(connection.execute(_boxes_between(box_filter), ends))

    def source_ids(self, box_ids: Iterable[int]) -> dict[int, str]:
        """The senders' own ids of boxes."""
        source_ids: dict[int, str] = {}
        for chunk in bulk.chunks(box_ids):
            rows = select(Box.id, Box.source_id).where(Box.id.in_(chunk))
            source_ids |= {row[0]: row[1] for row in self._session.execute(rows)}
        return source_ids

    def page(
        self,
        dataset_id: int,
        page: PageRequest,
        key_prefix: str = "",
        boxes: BoxFilter | None = None,
    ) -> list[Frame]:
        """The next current frames, sorted by ``key`` or ``id``.

        One more than the limit if there are more. With `boxes`, only those that have
        such a box. BadCursor if the cursor cannot be a key or an id.
        """
        by_key, ascending = page.sort.endswith("key"), not page.sort.startswith("-")
        column = Frame.key if by_key else Frame.id
        order = (Frame.dataset_id, column)
        rows = (
            select(Frame)
            .where(only_in(dataset_id), Frame.superseded_at.is_(None))
            .order_by(*(order if ascending else [each.desc() for each in order]))
            .limit(page.limit + 1)
        )
        if page.cursor is not None:
            read = name_of_cursor if by_key else id_of_cursor
            after = read(page.cursor)
            rows = rows.where(column > after if ascending else column < after)
        if key_prefix:
            rows = rows.where(
                Frame.key >= key_prefix, Frame.key < key_prefix + "\U0010ffff"
            )
        if boxes is not None:
            of_frame = Decision.frame_id == Frame.id
            rows = rows.where(exists().where(of_frame, *boxes.conditions()))
        return list(self._session.scalars(rows))

    def next_frames(self, dataset_id: int, *, after: str, limit: int) -> list[Frame]:
        """Up to `limit` current frames whose keys come after `after`, by key."""
        rows = select(Frame).where(*current_in(dataset_id), Frame.key > after)
        return list(self._session.scalars(rows.order_by(Frame.key).limit(limit)))

    def counts_by_place(self, dataset_id: int) -> dict[str, dict[str, tuple[int, int]]]:
        """Current frames and their boxes by map, weather, camera and sequence.

        Only those of the frames that name one; in order of name.
        """
        columns = {name: getattr(Frame, name) for name in PLACES}
        rows = (
            select(*columns.values(), func.count(), func.sum(Frame.box_count))
            .where(*current_in(dataset_id))
            .group_by(*columns.values())
        )
        counts: dict[str, dict[str, tuple[int, int]]] = {name: {} for name in PLACES}
        for *places, frames, boxes in self._session.execute(rows):
            for of, name in zip(counts.values(), places, strict=True):
                if name is not None:
                    frames_before, boxes_before = of.get(name, (0, 0))
                    of[name] = (frames_before + frames, boxes_before + int(boxes))
        return {what: dict(sorted(of.items())) for what, of in counts.items()}

    def keys(self, dataset_id: int) -> set[str]:
        """The keys of all current frames."""
        rows = select(Frame.key).where(*current_in(dataset_id))
        return set(self._session.scalars(rows))

    def parts_told(self, dataset_id: int) -> Iterator[FrameOfPart]:
        """What tells the parts of the current frames, by key."""
        said = (self._said("sequence"), self._said("split"))
        rows = select(Frame.key, Frame.map, *said).where(*current_in(dataset_id))
        for row in self._session.execute(rows.order_by(Frame.key)):
            yield FrameOfPart(*row)

    def _said(self, key: str) -> ColumnElement[str | None]:
        """The text that annotations have under a key."""
        text = type_coerce(Frame.annotation, Text)
        if self._session.connection().dialect.name == "postgresql":
            return text.op("::")(literal_column("json")).op("->>")(key)
        return func.json_extract(text, f"$.{key}")

    def recorded_around(self, frame: Frame, most: int) -> dict[int, int]:
        """Frames of the same recording around this one, by id: how much later they are.

        At most `most` before it and `most` after it; 0 is the frame itself. They are in
        its folder, and of its sequence if it has one.
        """
        folder = frame.key.rpartition("/")[0]
        sequence = self._session.scalar(
            select(self._said("sequence")).where(Frame.id == frame.id)
        )
        rows = select(Frame.id, Frame.key).where(*current_in(frame.dataset_id))
        if sequence is not None:
            rows = rows.where(self._said("sequence") == sequence)
        offsets = {frame.id: 0}
        for step, side, order in (
            (-1, Frame.key < frame.key, Frame.key.desc()),
            (1, Frame.key > frame.key, Frame.key),
        ):
            beside = self._session.execute(rows.where(side).order_by(order).limit(most))
            for number, (frame_id, key) in enumerate(beside, 1):
                if key.rpartition("/")[0] != folder:
                    break
                offsets[frame_id] = step * number
        return offsets

    def boxes_named(self, frame_ids: Iterable[int], like: Box) -> list[int]:
        """Ids of the boxes of these frames with the id and the class of another one."""
        rows = select(Box.id).where(
            Box.frame_id.in_(list(frame_ids)),
            Box.source_id == like.source_id,
            Box.class_id == like.class_id,
        )
        return list(self._session.scalars(rows))

    def annotation_texts(self, frame_ids: Iterable[int]) -> dict[int, str]:
        """Annotations by frame as the stored JSON text, not decoded."""
        rows = select(Frame.id, type_coerce(Frame.annotation, Text)).where(
            Frame.id.in_(list(frame_ids))
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def neighbours(self, frame: Frame) -> tuple[int | None, int | None]:
        """Ids of the frames before and after this one, in order of key."""
        rows = select(Frame.id).where(*current_in(frame.dataset_id)).limit(1)
        before = rows.where(Frame.key < frame.key).order_by(Frame.key.desc())
        after = rows.where(Frame.key > frame.key).order_by(Frame.key)
        return self._session.scalar(before), self._session.scalar(after)

    def count(self, dataset_id: int) -> int:
        """How many current frames a dataset has."""
        rows = select(func.count()).select_from(Frame)
        return self._session.scalar(rows.where(*current_in(dataset_id))) or 0

    def first_with_image(self, dataset_id: int) -> int | None:
        """The first frame with an image, which is the picture of the dataset."""
        rows = (
            select(Frame.id)
            .join(FrameFile, FrameFile.frame_id == Frame.id)
            .where(*current_in(dataset_id), FrameFile.kind == "image")
            .order_by(Frame.id)
            .limit(1)
        )
        return self._session.scalar(rows)

    def files(self, frame_ids: Iterable[int]) -> dict[int, dict[str, FileRow]]:
        """Files of frames by kind."""
        files: dict[int, dict[str, FileRow]] = {key: {} for key in frame_ids}
        columns = (Blob.sha256, Blob.size_bytes, Blob.media_type)
        rows = (
            select(FrameFile.frame_id, FrameFile.kind, *columns)
            .join(Blob, Blob.sha256 == FrameFile.sha256)
            .where(FrameFile.frame_id.in_(files))
        )
        for row in self._session.execute(rows):
            files[row[0]][row[1]] = FileRow._make(row[1:])
        return files

    def take_ids(self, frames: int, boxes: int) -> tuple[int, int]:
        """Reserve this many ids of frames and of boxes; returns the first of each."""
        rows = bulk.run(self._session, _TAKE_IDS, frames=frames, boxes=boxes)
        after = dict(rows.all())
        if not after.keys() >= {"frames", "boxes"}:
            raise RuntimeError(f"the table id_blocks has only {sorted(after)}")
        return after["frames"] - frames, after["boxes"] - boxes

    def add(
        self,
        frames: Sequence[Mapping[str, object]],
        files: Mapping[int, Sequence[FileRow]],
    ) -> None:
        """Insert frames and their files; `files` has the frames' ids as keys."""
        session = self._session
        distinct = {file.sha256: file for each in files.values() for file in each}
        blobs = [
            {
                "sha256": file.sha256,
                "size_bytes": file.size_bytes,
                "media_type": file.media_type,
                "created_at": utc_now(),
            }
            for file in distinct.values()
        ]
        bulk.run_each(session, _new_blobs(session.connection().dialect.name), blobs)
        bulk.insert_rows(session, Frame, frames)
        files_of_frames = [
            {"frame_id": frame_id, "kind": file.kind, "sha256": file.sha256}
            for frame_id, each in files.items()
            for file in each
        ]
        bulk.insert_rows(session, FrameFile, files_of_frames)

    def add_boxes(self, columns: Mapping[str, Sequence[object]]) -> None:
        """Insert boxes; `app.boxes.current.add` inserts their decisions."""
        bulk.insert_columns(self._session, Box, columns)

    def remove(self, dataset_id: int, key: str) -> None:
        """Delete every revision under a key."""
        self._session.execute(
            delete(Frame).where(Frame.dataset_id == dataset_id, Frame.key == key)
        )

    def box(self, box_id: int) -> Box:
        """A box; raises NotFound."""
        return existing(self._session.get(Box, box_id), "box", box_id)


@lru_cache
def _new_blobs(dialect: str) -> Executable:
    return bulk.insert_of_dialect(dialect, Blob).on_conflict_do_nothing()


class LatestReview(NamedTuple):
    """The latest answer on a box."""

    box_id: int
    revision: int
    verdict: str
    comment: str
    reviewer: str
    batch_id: int | None
    undoes: int | None
    created_at: datetime
    imported_by: str | None
    looked_ms: int | None


class LatestAnswers(Repository):
    """Reads the latest answers on boxes; only `app.review` writes answers."""

    def of(self, box_ids: Iterable[int]) -> dict[int, LatestReview]:
        """The latest answer on each box that has one."""
        columns = [getattr(Review, name) for name in LatestReview._fields]
        answers: dict[int, LatestReview] = {}
        for chunk in bulk.chunks(box_ids):
            newest = (
                select(Review.box_id, func.max(Review.revision).label("revision"))
                .where(Review.box_id.in_(chunk))
                .group_by(Review.box_id)
                .subquery()
            )
            is_newest = Review.revision == newest.c.revision
            rows = select(*columns).join(
                newest, (Review.box_id == newest.c.box_id) & is_newest
            )
            for row in self._session.execute(rows):
                answers[row[0]] = LatestReview._make(row)
        return answers

    def decided(self, dataset_id: int) -> dict[int, bool]:
        """By box, ascending: whether it is kept, where that is the latest answer."""
        keep = (Decision.review == "keep").label("keep")
        rows = select(Decision.box_id, keep).where(
            Decision.dataset_id == dataset_id, REVIEW_STATES["decided"].condition()
        )
        answers = self._session.execute(rows.order_by(Decision.box_id))
        return {answer.box_id: answer.keep for answer in answers}

    def last_id(self, dataset_id: int) -> int:
        """The id of the newest answer in a dataset; 0 if there is none."""
        rows = (
            select(func.max(Review.id))
            .join(Decision, Decision.box_id == Review.box_id)
            .where(Decision.dataset_id == dataset_id)
        )
        return self._session.scalar(rows) or 0

    def newest_id(self) -> int:
        """The id of the newest answer of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Review.id))) or 0

    def boxes_after(self, review_id: int) -> IntArray:
        """The box of each answer after this one, of all datasets."""
        # Not distinct: SQLite would read all answers in the order of their boxes.
        rows = select(Review.box_id).where(Review.id > review_id)
        return np.fromiter(self._session.scalars(rows), np.int64)

    def reviewers_of(self, dataset_id: int, key: str) -> dict[str, int]:
        """How many answers each person gave on a frame, in all of its revisions."""
        rows = (
            select(Review.reviewer, func.count())
            .join(Box, Box.id == Review.box_id)
            .join(Frame, Frame.id == Box.frame_id)
            .where(Frame.dataset_id == dataset_id, Frame.key == key)
            .group_by(Review.reviewer)
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}


BANDS_M: Final = (50, 100, 150, 200)
"""Ends of the bands of distance of a report."""


class GhostRepository(Repository):
    """SQL about where the ghosts of a dataset are."""

    def by_place(
        self, dataset_id: int
    ) -> list[tuple[str | None, str | None, int | None, int, str | None, int]]:
        """How many boxes each map, weather, band, reason and answer have together.

        The band is given by its first metre, if all that is known of the distance of a
        box is in it; else it is None.
        """
        distance, low = Decision.distance, Decision.distance_from
        high = Decision.distance_to
        ends = [
            (or_(distance < end, and_(low >= end - 50, high <= end)), end - 50)
            for end in BANDS_M
        ]
        beyond = or_(distance.is_not(None), low >= BANDS_M[-1])
        band = case(*ends, (beyond, BANDS_M[-1]), else_=None)
        key = Frame.map, Frame.weather, band, Decision.reason, Decision.review
        rows = (
            select(*key, func.count())
            .join(Frame, Frame.id == Decision.frame_id)
            .where(Decision.dataset_id == dataset_id)
            .group_by(*key)
        )
        return [tuple(row) for row in self._session.execute(rows)]

    def worst_frames(self, dataset_id: int, limit: int) -> list[int]:
        """The ids of the frames with the most rejected boxes, the worst first."""
        rows = (
            select(Decision.frame_id)
            .where(Decision.dataset_id == dataset_id, is_effective(Verdict.REJECTED))
            .group_by(Decision.frame_id)
            .order_by(func.count().desc(), Decision.frame_id)
            .limit(limit)
        )
        return list(self._session.scalars(rows))
