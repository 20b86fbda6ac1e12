"""Reads stored boxes as columns, and builds the objects of responses from them.

`DecisionReader` reads boxes, by their ids or by their frames, as `StoredBoxes`:
columns, each unpacked on first use. Neighbours, pictures, counts and labels need only
columns. Responses need one object per box: `DecisionReader.records` builds them, with
the fields of `stored_decision`.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.boxes.counts import tallies_of
from app.boxes.current import TallyRepository
from app.boxes.filter import BoxFilter, TallyKey
from app.boxes.orders import BoxPages
from app.boxes.queries import (
    CurrentBoxes,
    FrameRepository,
    LatestAnswers,
    LatestReview,
    PageRequest,
)
from app.catalog.datasets import DatasetRepository
from app.db.base import filled, rfc3339
from app.db.pages import id_of_cursor
from app.db.tables import Dataset
from app.errors import NotFound
from app.measuring.active import active_config, active_digest
from app.measuring.evidence import (
    Geometry,
    to_evidence,
    unpack_channels,
    unpack_chosen_tag_counts,
    unpack_geometry,
    unpack_numbers,
)
from app.measuring.queries import EvidenceRepository, EvidenceRow
from app.verdicts import with_answer
from filter_core.arrays import NOT_MEASURED, FloatArray, IntArray
from filter_core.classes import accepts
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin, Cause, Doubts, bins_of, doubts, questions
from filter_core.decisions.explain import BoxName, FrameFacts
from filter_core.decisions.record import (
    Decision,
    decided_boxes,
    decision_columns,
    decision_dicts,
)
from filter_core.decisions.rules import decide
from filter_core.evidence.crowding import most_covering
from filter_core.evidence_numbers import Evidence
from filter_core.formats.decisions import table_columns
from filter_core.geometry.projection import BoxGeometry
from filter_core.segmentation.palettes import FAMILIES
from filter_core.verdicts import Answer, DecidedBoxes, DecisionColumns, Decisions
from unghost.wire import words
from unghost.wire.boxes import BOX_COLUMNS

_ANSWERS: Final = {
    None: Answer.NONE,
    "keep": Answer.KEEP,
    "reject": Answer.REJECT,
    "unsure": Answer.UNSURE,
}
_ABSENT: Final = (np.nan,) * 4


class AcceptedTag(TypedDict):
    """A tag whose pixels count for a box."""

    tag: int
    name: str
    rgb: list[int]


class CurrentReview(TypedDict):
    """A person's latest answer on a box."""

    verdict: str
    reviewer: str
    revision: int
    comment: str
    created_at: str


class AskedDecision(Decision):
    """The library's decision on a box, and its bin.

    With what an answer is worth, and why people are asked, if so.
    """

    bin: words.Bin
    doubt: int
    question: str | None


class StoredDecision(AskedDecision):
    """A decision of a stored box, as responses show it.

    `config` is not that of the library, but the digest of the run's version.
    """

    box_id: int
    frame_id: int
    run: int
    revision: int
    review: CurrentReview | None
    effective_verdict: words.Verdict
    accepted_tags: list[AcceptedTag]


class DecidedFrame(NamedTuple):
    """The values that the service adds to all decisions of a frame.

    `config` is the digest of the version that `run` applied; `family` is the palette
    family of the segmentation's tags.
    """

    frame_id: int
    run: int
    config: str
    family: str | None


def asked_decisions(
    decisions: Sequence[Decision], doubts: Doubts, sentences: Sequence[str | None]
) -> list[AskedDecision]:
    """Decisions with the bins of their boxes, and with the sentences of `questions`."""
    doubt = np.maximum(doubts.doubt, 0).tolist()
    bins = bins_of(doubts.doubt).tolist()
    return [
        {**decision, "bin": Bin(bin_).label, "doubt": worth, "question": sentence}
        for decision, bin_, worth, sentence in zip(
            decisions, bins, doubt, sentences, strict=True
        )
    ]


def covering_words(name: BoxName, gap: float) -> str:
    """A box whose rectangle overlaps another one's, for `questions`.

    `gap` is how much farther from the camera it is than the other box, in metres; NaN:
    unknown.
    """
    where = "nearer " if gap < 0 else "farther " if gap > 0 else ""
    return f"the {where}{name.class_name} {name.box_id}"


def stored_decision(
    decision: AskedDecision,
    box_id: int,
    frame: DecidedFrame,
    accept_mask: int,
    review: LatestReview | None,
) -> StoredDecision:
    """The wire form of a stored box: a decision and the fields of the service.

    `review` is the latest answer; it may be `clear`, which undoes the previous one.
    """
    answer = None if review is None else review.verdict
    return {
        **decision,
        "box_id": box_id,
        "frame_id": frame.frame_id,
        "run": frame.run,
        "config": frame.config,
        "revision": 0 if review is None else review.revision,
        "review": _in_force(review),
        "effective_verdict": with_answer(decision["verdict"], answer),
        "accepted_tags": _accepted_tags(frame.family, accept_mask),
    }


def _in_force(review: LatestReview | None) -> CurrentReview | None:
    if review is None or review.verdict == "clear":
        return None
    return {
        "verdict": review.verdict,
        "reviewer": review.reviewer,
        "revision": review.revision,
        "comment": review.comment,
        "created_at": rfc3339(review.created_at),
    }


@lru_cache(maxsize=1024)
def _accepted_tags(family: str | None, mask: int) -> list[AcceptedTag]:
    if family is None:
        return []
    tags = FAMILIES[family].tags
    accepted = accepts(mask, np.array([tag.tag for tag in tags]))
    return [
        {"tag": tags[place].tag, "name": tags[place].name, "rgb": list(tags[place].rgb)}
        for place in np.flatnonzero(accepted)
    ]


def list_boxes(
    session: Session, reader: DecisionReader, box_filter: BoxFilter, page: PageRequest
) -> tuple[list[StoredDecision], str | None]:
    """Decisions of one page, and the cursor of the next."""
    tallies = TallyRepository(session).of_dataset(box_filter.dataset_id)
    pages = BoxPages(session, box_filter, tallies)
    ids, cursor = pages.page(page.sort, page.cursor, page.limit)
    return reader.records(reader.read_boxes(ids)), cursor


def table_of_boxes(
    session: Session,
    reader: DecisionReader,
    box_filter: BoxFilter,
    names: Collection[str],
    page: PageRequest,
) -> tuple[dict[str, Sequence[object]], int, str | None]:
    """Boxes of the frames after the one whose id is the cursor, as columns.

    Returns the columns, plain values in the order of `BOX_COLUMNS`, of up to `limit`
    boxes, or those of one frame; how many these are; and as the next cursor the id of
    the last frame, None if there are no more.
    """
    repository = FrameRepository(session)
    after = 0 if page.cursor is None else id_of_cursor(page.cursor)
    frames, has_more = repository.places_of(box_filter, after=after, boxes=page.limit)
    boxes = reader.read(repository.boxes_between(box_filter, frames))
    places = {frame.id: frame for frame in frames}
    of_box = [places[frame_id] for frame_id in boxes.rows.frame_ids]
    columns: dict[str, Callable[[], Sequence[object]]] = {
        "box_id": lambda: boxes.rows.box_ids,
        "frame": lambda: [frame.key for frame in of_box],
        "map": lambda: [frame.map for frame in of_box],
        "camera": lambda: [frame.camera for frame in of_box],
        "sequence": lambda: [frame.sequence for frame in of_box],
        "weather": lambda: [frame.weather for frame in of_box],
        "revision": lambda: boxes.rows.revisions,
        "bin": lambda: [_BINS[min(doubt, Bin.ASK)] for doubt in boxes.rows.doubts],
    }
    if len(boxes):
        more = reader.columns(
            boxes,
            tags="hidden_by" in names,
            answers=not {"reviewer", "comment"}.isdisjoint(names),
        )
        columns |= table_columns(boxes.labels, more)
    table = {
        name: columns[name]() if len(boxes) else ()
        for name in BOX_COLUMNS
        if name in names
    }
    return table, len(boxes), str(frames[-1].id) if has_more else None


_BINS: Final = {int(bin_): bin_.label for bin_ in Bin}


def describe_box(session: Session, box_id: int) -> StoredDecision:
    """One decision; NotFound for a box that is not current."""
    reader, boxes = read_box(session, box_id)
    (decision,) = reader.records(boxes)
    return decision


def read_box(session: Session, box_id: int) -> tuple[DecisionReader, StoredBoxes]:
    """One box, and the reader of its dataset; NotFound if the box is not current."""
    rows = FrameRepository(session).current_boxes([box_id])
    if not rows.box_ids:
        raise NotFound("box", box_id)
    frame = FrameRepository(session).with_id(rows.frame_ids[0])
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    reader = DecisionReader(session, dataset)
    return reader, reader.read(rows)


def rectangles_of(
    session: Session, box_ids: Collection[int]
) -> dict[int, tuple[int, list[float]]]:
    """The frame and the rectangle of each box, by its id.

    Of current boxes of any datasets that have a rectangle in the image; in px.
    """
    repository, datasets = FrameRepository(session), DatasetRepository(session)
    rows = repository.current_boxes([*box_ids])
    frames = repository.with_ids(rows.frame_ids)
    frame_of = dict(zip(rows.box_ids, rows.frame_ids, strict=True))
    ids_of_dataset: dict[int, list[int]] = defaultdict(list)
    for box_id, frame_id in frame_of.items():
        ids_of_dataset[frames[frame_id].dataset_id].append(box_id)
    rectangles: dict[int, tuple[int, list[float]]] = {}
    for dataset_id, ids in ids_of_dataset.items():
        with suppress(NotFound):  # the dataset was deleted
            reader = DecisionReader(session, datasets.with_id(dataset_id))
            boxes = reader.read_boxes(ids)
            corners = zip(boxes.rows.box_ids, boxes.rectangles(), strict=True)
            rectangles |= {
                box_id: (frame_of[box_id], xyxy)
                for box_id, xyxy in corners
                if xyxy is not None
            }
    return rectangles


class DecisionReader:
    """Reads current boxes of one dataset; made for one request."""

    def __init__(self, session: Session, dataset: Dataset) -> None:
        self._session = session
        self._dataset = dataset
        self._digest = active_digest(session, dataset)
        self._config = active_config(session, dataset, self._digest)
        self._classes = DatasetRepository(session).classes(dataset.id)

    def read_boxes(self, box_ids: Sequence[int]) -> StoredBoxes:
        """Boxes in the order of `box_ids`; those that no longer exist are left out."""
        return self.read(FrameRepository(self._session).current_boxes(box_ids))

    def read_frames(self, frame_ids: Sequence[int]) -> StoredBoxes:
        """All boxes of frames, in order of id; none of a frame that was replaced."""
        rows = FrameRepository(self._session).current_boxes_of(frame_ids)
        return self.read(rows, frame_ids)

    def read(self, rows: CurrentBoxes, frame_ids: Sequence[int] = ()) -> StoredBoxes:
        """Boxes of this dataset, each once.

        The evidence of `frame_ids` is read even if these frames have none of the boxes.
        """
        frames = EvidenceRepository(self._session).of_frames(
            [*frame_ids, *rows.frame_ids], filled(self._dataset.active_measurement_id)
        )
        return StoredBoxes(rows, frames, self._config, self._classes)

    def records(self, boxes: StoredBoxes) -> list[StoredDecision]:
        """One object per box, as responses show it.

        The database is queried once for all boxes; values that all boxes of a frame
        share are computed once per frame.
        """
        if not len(boxes):
            return []
        rows, facts = boxes.rows, self._facts(boxes)
        composed = decision_dicts(
            [facts[frame_id] for frame_id in rows.frame_ids],
            rows.source_ids,
            boxes.evidence_with_tags(),
            boxes.decisions,
            boxes.projected(edges=True),
        )
        covering = boxes.covering()
        source_ids = self._source_ids(boxes, (box for box, _, _ in covering.values()))
        named = {
            row: covering_words(BoxName(source_ids[by_box], class_name), gap)
            for row, (by_box, class_name, gap) in covering.items()
        }
        evidence, of_boxes = boxes.evidence, boxes.doubts
        sentences = questions(of_boxes, evidence, self._config, boxes.decisions, named)
        decisions = asked_decisions(composed, of_boxes, sentences)
        reviews = self._reviews(boxes)
        run = filled(self._dataset.active_run_id)
        decided = {
            key: DecidedFrame(key, run, self._digest, of_frame.family)
            for key, of_frame in facts.items()
        }
        masks = boxes.evidence.accept_mask.tolist()
        return [
            stored_decision(
                decision, box_id, decided[frame_id], mask, reviews.get(box_id)
            )
            for decision, box_id, frame_id, mask in zip(
                decisions, rows.box_ids, rows.frame_ids, masks, strict=True
            )
        ]

    def columns(
        self, boxes: StoredBoxes, *, tags: bool = True, answers: bool = True
    ) -> DecisionColumns:
        """The columns of tables of decisions in addition to `StoredBoxes.labels`.

        Without `tags`, nothing hides a box; without `answers`, nobody has answered.
        """
        rows, facts = boxes.rows, self._facts(boxes)
        columns = decision_columns(
            [facts[frame_id] for frame_id in rows.frame_ids],
            boxes.evidence_with_tags() if tags else boxes.evidence,
            boxes.decisions,
        )
        if not answers:
            return replace(columns, config=self._digest)
        reviews = self._reviews(boxes)
        given_answers = [_in_force(reviews.get(box_id)) for box_id in rows.box_ids]
        return replace(
            columns,
            reviewer=[answer and answer["reviewer"] for answer in given_answers],
            comment=[answer and answer["comment"] for answer in given_answers],
            config=self._digest,
        )

    def _facts(self, boxes: StoredBoxes) -> dict[int, FrameFacts]:
        """The values that all boxes of a frame share, by the frame's id."""
        # Id and class of the boxes that explain these, by frame and position there.
        names: dict[int, dict[int, BoxName]] = {}
        explaining = boxes.explaining()
        source_ids = self._source_ids(boxes, (box for box, _ in explaining.values()))
        for (frame_id, position), (box_id, class_name) in explaining.items():
            of_frame = names.setdefault(frame_id, {})
            of_frame[position] = BoxName(source_ids[box_id], class_name)
        return {
            key: FrameFacts(
                key=frame.key,
                config=self._config,
                family=frame.palette,
                lossy=frame.lossy,
                names=names.get(key, {}),
            )
            for key, frame in boxes.frames.items()
        }

    def _reviews(self, boxes: StoredBoxes) -> Mapping[int, LatestReview]:
        """The latest answer on each answered box, by the box's id."""
        rows = boxes.rows
        return LatestAnswers(self._session).of(
            box_id
            for box_id, revision in zip(rows.box_ids, rows.revisions, strict=True)
            if revision
        )

    def _source_ids(
        self, boxes: StoredBoxes, box_ids: Iterable[int]
    ) -> Mapping[int, str]:
        """The senders' ids of boxes of the same frames."""
        source_ids = dict(zip(boxes.rows.box_ids, boxes.rows.source_ids, strict=True))
        others = {*box_ids} - source_ids.keys()
        if others:
            source_ids |= FrameRepository(self._session).source_ids(others)
        return source_ids


@dataclass(frozen=True, eq=False)
class StoredBoxes:
    """N different boxes of one dataset as columns, each computed on first use.

    `frames` has the packed numbers of their frames by id, and perhaps of frames without
    boxes here; `classes` the database's ids of the dataset's classes. They are decided
    by `config`.
    """

    rows: CurrentBoxes
    frames: Mapping[int, EvidenceRow]
    config: FilterConfig
    classes: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.rows.box_ids)

    @cached_property
    def labels(self) -> DecidedBoxes:
        """The columns for pictures and labels: rectangles, verdicts, answers."""
        lossy = [frame.lossy for frame in self.frames.values()]
        boxes = decided_boxes(
            self.rows.source_ids,
            self.evidence,
            self.decisions,
            self.projected(edges=False),
            lossy=np.array(lossy, np.bool_)[self._frame],
        )
        answers = [_ANSWERS[answer] for answer in self.rows.answers]
        return replace(boxes, answer=np.array(answers, np.uint8))

    def rows_by_frame(self) -> dict[int, slice]:
        """The rows of each frame that has boxes; the boxes must be in order of id."""
        first, rows = 0, {}
        for frame_id, count in Counter(self.rows.frame_ids).items():
            rows[frame_id] = slice(first, first + count)
            first += count
        return rows

    @cached_property
    def decisions(self) -> Decisions:
        """The decisions of the active configuration."""
        return decide(self.evidence, self.config)

    @cached_property
    def doubts(self) -> Doubts:
        return doubts(self.evidence, self.config, self.decisions)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence, without `tag_counts`."""
        packed = [frame.channels for frame in self.frames.values()]
        channels = unpack_channels(packed, self._counts)
        return to_evidence(
            self._records[self._place],
            self.classes,
            channels=None if channels is None else channels[self._place],
        )

    def evidence_with_tags(self) -> Evidence:
        """The evidence, with `tag_counts`."""
        packed = [frame.tag_counts for frame in self.frames.values()]
        counts = unpack_chosen_tag_counts(packed, self._counts, self._place)
        return replace(self.evidence, tag_counts=counts)

    def projected(self, *, edges: bool) -> BoxGeometry:
        """The rectangles of 3D boxes, and their edges if `edges` is true, else None."""
        rows, boxes = list(self._geometry), list(self._geometry.values())
        amodal, visible = np.full((2, len(self), 4), np.nan)
        lines: list[FloatArray | None] = [None] * len(self)
        if boxes:
            amodal[rows] = [box.amodal_xyxy or _ABSENT for box in boxes]
            visible[rows] = [box.visible_xyxy or _ABSENT for box in boxes]
        if boxes and edges:
            rounded = rounded_edges(np.concatenate([box.edges for box in boxes]))
            ends = np.cumsum([len(box.edges) for box in boxes])
            for row, part in zip(rows, np.split(rounded, ends[:-1]), strict=True):
                lines[row] = part
        return BoxGeometry.loaded(amodal, visible, lines)

    def rectangles(self) -> list[list[float] | None]:
        """Corrected rectangles; None for a box without a rectangle in the image."""
        corners: list[list[float]] = self.labels.xyxy.tolist()
        return [None if xyxy[0] != xyxy[0] else xyxy for xyxy in corners]

    def tallies(self) -> dict[TallyKey, int]:
        """How many of these boxes have each `TallyKey`: for the counts of a frame."""
        return tallies_of(
            zip(
                self._records["class_id"][self._place].tolist(),
                self.decisions.reason.tolist(),
                self.decisions.toss_up.tolist(),
                self.doubts.doubt.tolist(),
                self.rows.answers,
                strict=True,
            )
        )

    def neighbours(self, row: int) -> list[int]:
        """Ids of the boxes in the same frame that overlap the box of this row."""
        frame = self.frames[self.rows.frame_ids[row]]
        place = self.rows.box_ids[row] - frame.first_box_id
        xyxy = unpack_numbers([frame.numbers], [frame.box_count])["xyxy"]
        low, high = xyxy[:, :2], xyxy[:, 2:]
        overlapping = ((low[place] < high) & (low < high[place])).all(axis=1)
        overlapping[place] = False
        neighbours: list[int] = (
            np.flatnonzero(overlapping) + frame.first_box_id
        ).tolist()
        return neighbours

    def explaining(self) -> dict[tuple[int, int], tuple[int, str]]:
        """Id and class of the boxes of the same frames that explain some of these.

        By their frame and their position in it.
        """
        channels = self.evidence.channels
        if channels is None:
            return {}
        boxes = {}
        for row in np.flatnonzero(channels.explained_by != NOT_MEASURED).tolist():
            position = int(channels.explained_by[row])
            frame_id = self.rows.frame_ids[row]
            boxes[frame_id, position] = self._beside(row, position)
        return boxes

    def covering(self) -> dict[int, tuple[int, str, float]]:
        """The box that covers most of each box in doubt for it, by the latter's row.

        Its id and class, and how much farther from the camera it is, in metres; NaN:
        unknown.
        """
        covering_boxes = {}
        for row in np.flatnonzero(self.doubts.cause == Cause.COVERED).tolist():
            position = self.rows.box_ids[row] - self._first_of(row)
            start = int(self._place[row]) - position
            count = self.frames[self.rows.frame_ids[row]].box_count
            frame = self._records[start : start + count]
            at = most_covering(frame["xyxy"], frame["accept_mask"], position)
            gap = float(frame["distance"][at] - frame["distance"][position])
            covering_boxes[row] = (*self._beside(row, at), gap)
        return covering_boxes

    def _first_of(self, row: int) -> int:
        return self.frames[self.rows.frame_ids[row]].first_box_id

    def _beside(self, row: int, position: int) -> tuple[int, str]:
        """Id and class of the box of the same frame at this position there."""
        box_id = self._first_of(row) + position
        # A frame's boxes follow each other in `_records`, as their ids do.
        place = self._place[row] + box_id - self.rows.box_ids[row]
        class_id = int(self._records["class_id"][place])
        return box_id, self._class_of[class_id]

    @cached_property
    def _class_of(self) -> dict[int, str]:
        """The dataset's classes by the database's ids."""
        return {number: name for name, number in self.classes.items()}

    @cached_property
    def _counts(self) -> list[int]:
        return [frame.box_count for frame in self.frames.values()]

    @cached_property
    def _records(self) -> NDArray[np.void]:
        """The numbers of all boxes of the frames, one frame after the other."""
        packed = [frame.numbers for frame in self.frames.values()]
        return unpack_numbers(packed, self._counts)

    @cached_property
    def _frame(self) -> IntArray:
        """(N,): the place of each box's frame among the frames."""
        places = {frame_id: place for place, frame_id in enumerate(self.frames)}
        return np.array([places[key] for key in self.rows.frame_ids], np.int64)

    @cached_property
    def _place(self) -> IntArray:
        """(N,): the place of each box among all boxes of the frames."""
        firsts = [frame.first_box_id for frame in self.frames.values()]
        starts = np.cumsum([0, *self._counts])[:-1] - np.array(firsts, np.int64)
        places: IntArray = np.array(self.rows.box_ids, np.int64) + starts[self._frame]
        return places

    @cached_property
    def _geometry(self) -> dict[int, Geometry]:
        """The stored geometry of boxes that were sent in three dimensions, by row."""
        rows_of: dict[int, list[int]] = {}
        for row, frame_id in enumerate(self.rows.frame_ids):
            if self.frames[frame_id].geometry:
                rows_of.setdefault(frame_id, []).append(row)
        geometries: dict[int, Geometry] = {}
        for frame_id, rows in rows_of.items():
            frame = self.frames[frame_id]
            places = [self.rows.box_ids[row] - frame.first_box_id for row in rows]
            boxes = unpack_geometry(frame.geometry, frame.box_count, places)
            for row, box in zip(rows, boxes, strict=True):
                if box is not None:
                    geometries[row] = box
        return geometries


def rounded_edges(edges: FloatArray | NDArray[np.float32]) -> FloatArray:
    """Edges in the precision of responses: rounded single floats."""
    return np.asarray(edges.astype(np.float32).round(2), np.float64)
