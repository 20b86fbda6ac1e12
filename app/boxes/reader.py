"""Decided boxes: read as columns, and as the records that are answered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, TypedDict

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.boxes.current import CurrentRow, DecisionRepository, TallyRepository
from app.boxes.filter import BoxFilter
from app.boxes.orders import BoxPages
from app.boxes.queries import FrameRepository, LatestAnswers, LatestReview
from app.db.tables import Dataset, Frame
from app.errors import NotFound
from app.measuring.active import active_version, config_of
from app.measuring.evidence import (
    Geometry,
    to_evidence,
    unpack_channels,
    unpack_geometry,
    unpack_numbers,
    unpack_tag_counts,
)
from app.measuring.queries import DatasetRepository, EvidenceRepository, EvidenceRow
from app.verdicts import effective_verdict
from filter_core.classes import accepts
from filter_core.config.filter import FilterConfig
from filter_core.decisions.record import (
    Decision,
    FrameFacts,
    decided_boxes,
    decision_dicts,
)
from filter_core.decisions.rules import decide
from filter_core.geometry.projection import BoxGeometry
from filter_core.segmentation.palettes import FAMILIES
from filter_core.types import (
    NOT_MEASURED,
    Answer,
    ChannelNumbers,
    DecidedBoxes,
    Evidence,
    FloatArray,
)

_ANSWERS: Final = {
    None: Answer.NONE,
    "keep": Answer.KEEP,
    "reject": Answer.REJECT,
    "unsure": Answer.UNSURE,
}


class AcceptedTag(TypedDict):
    """A tag whose pixels count for a box."""

    tag: int
    name: str
    rgb: list[int]


class CurrentReview(TypedDict):
    """What a person last said of a box."""

    verdict: str
    reviewer: str
    revision: int
    comment: str


class ServerFields(TypedDict):
    """What the service adds to a decision of the library."""

    box_id: int
    frame_id: int
    run: int
    config: str
    revision: int
    review: CurrentReview | None
    effective_verdict: str


class StoredDecision(Decision, ServerFields):
    """A decision of a stored box."""

    accepted_tags: list[AcceptedTag]


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list, and in which order."""

    sort: str
    cursor: str
    limit: int


def list_boxes(
    session: Session, dataset: Dataset, wanted: BoxFilter, page: PageRequest
) -> tuple[list[StoredDecision], str | None]:
    """Decisions of one page, and the cursor of the next."""
    present = TallyRepository(session).present(dataset.id)
    pages = BoxPages(session, wanted, present)
    ids, cursor = pages.page(page.sort, page.cursor, page.limit)
    return DecisionReader(session, dataset).of_boxes(ids), cursor


def describe_box(session: Session, box_id: int) -> StoredDecision:
    """One decision; NotFound for a box that is not current."""
    row = DecisionRepository(session).rows([box_id]).get(box_id)
    if row is None:
        raise NotFound("box", box_id)
    frame = FrameRepository(session).with_id(row.frame_id)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    (decision,) = DecisionReader(session, dataset).of_boxes([box_id])
    return decision


def neighbours(session: Session, decision: StoredDecision) -> list[int]:
    """The boxes of its frame that overlap a box."""
    frame = FrameRepository(session).with_id(decision["frame_id"], annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    return _overlapping(decision, DecisionReader(session, dataset).of_frame(frame))


def _overlapping(
    decision: StoredDecision, others: Sequence[StoredDecision]
) -> list[int]:
    mine = decision["xyxy"]
    if mine is None:
        return []
    return [
        other["box_id"]
        for other in others
        if other["box_id"] != decision["box_id"]
        and other["xyxy"] is not None
        and _overlap(mine, other["xyxy"])
    ]


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


class DecisionReader:
    """Reads current decisions of one dataset; made for one request."""

    def __init__(self, session: Session, dataset: Dataset) -> None:
        self._session = session
        self._dataset = dataset
        self._version = active_version(session, dataset)
        self.config: FilterConfig = config_of(self._version)
        self.classes = DatasetRepository(session).classes(dataset.id)

    def of_boxes(self, box_ids: Sequence[int]) -> list[StoredDecision]:
        """Decisions in the order of the ids; boxes that are gone are left out."""
        rows = DecisionRepository(self._session).rows(box_ids)
        frames = FrameRepository(self._session).heads(
            row.frame_id for row in rows.values()
        )
        wanted: dict[int, list[int]] = {}
        for box_id, row in rows.items():
            frame = frames[row.frame_id]
            wanted.setdefault(frame.id, []).append(box_id - frame.first_box_id)
        found = {
            decision["box_id"]: decision
            for decision in self._describe(frames, wanted, rows)
        }
        return [found[box_id] for box_id in box_ids if box_id in found]

    def of_frame(self, frame: Frame) -> list[StoredDecision]:
        """Decisions of all boxes of a current frame, in the order they came in."""
        return self.of_frames([frame])[frame.id]

    def of_frames(
        self, frames: Sequence[Frame], *, explained: bool = True
    ) -> dict[int, list[StoredDecision]]:
        """Decisions of all boxes of frames; none for a frame that was replaced.

        `explained`: see `FrameFacts`.
        """
        by_id = {frame.id: frame for frame in frames}
        rows = DecisionRepository(self._session).of_frames(by_id)
        current = {row.frame_id for row in rows.values()}
        wanted = {key: range(by_id[key].box_count) for key in by_id if key in current}
        found: dict[int, list[StoredDecision]] = {key: [] for key in by_id}
        for decision in self._describe(by_id, wanted, rows, explained=explained):
            found[decision["frame_id"]].append(decision)
        return found

    def columns_of_frames(self, frames: Sequence[Frame]) -> dict[int, DecidedBoxes]:
        """What labels say of all boxes of current frames; none of a frame without."""
        by_id = {frame.id: frame for frame in frames if frame.box_count}
        chosen = self._chosen(
            by_id, {key: range(by_id[key].box_count) for key in by_id}
        )
        if not chosen:
            return {}
        sources = DecisionRepository(self._session).answered_sources(by_id)
        numbers, geometry = self._columns(chosen, tag_counts=False, edges=False)
        counts = [len(each.positions) for each in chosen]
        boxes = decided_boxes(
            [source_id for key in by_id for source_id, _ in sources[key]],
            numbers,
            decide(numbers, self.config),
            geometry,
            lossy=np.repeat([each.lossy for each in chosen], counts),
        )
        said = [_ANSWERS[each] for key in by_id for _, each in sources[key]]
        boxes = replace(boxes, answer=np.array(said, np.uint8))
        ends = np.cumsum(counts).tolist()
        return {
            each.frame.id: boxes[end - count : end]
            for each, count, end in zip(chosen, counts, ends, strict=True)
        }

    def palettes(self, frame_ids: Iterable[int]) -> dict[int, str]:
        """Tag families of frames whose segmentations were measured."""
        reports = EvidenceRepository(self._session).reports(
            frame_ids, self._dataset.active_measurement_id or 0
        )
        return {key: report["palette"] for key, report in reports.items() if report}

    def _describe(
        self,
        frames: Mapping[int, Frame],
        wanted: Mapping[int, Sequence[int]],
        rows: Mapping[int, CurrentRow],
        *,
        explained: bool = True,
    ) -> list[StoredDecision]:
        """All boxes together: one decision over a page costs as much as one per box."""
        if not rows:
            return []
        chosen = self._chosen(frames, wanted)
        ids = [box_id for each in chosen for box_id in each.box_ids]
        numbers, geometry = self._columns(chosen, tag_counts=True, edges=explained)
        facts: list[FrameFacts] = []
        for each in chosen:
            one = replace(self._facts(each), explained=explained)
            facts += [one] * len(each.positions)
        sources = FrameRepository(self._session).source_ids(ids)
        decisions = decision_dicts(
            facts,
            [sources[box_id] for box_id in ids],
            numbers,
            decide(numbers, self.config),
            geometry,
        )
        reviews = LatestAnswers(self._session).of(
            box_id for box_id in ids if rows[box_id].revision
        )
        masks = numbers.accept_mask.tolist()
        return [
            {
                **decision,
                **self._server_fields(rows[box_id], reviews.get(box_id)),
                "accepted_tags": accepted_tags(of.family, mask),
            }
            for decision, box_id, mask, of in zip(
                decisions, ids, masks, facts, strict=True
            )
        ]

    def _chosen(
        self, frames: Mapping[int, Frame], wanted: Mapping[int, Sequence[int]]
    ) -> list[ChosenBoxes]:
        """Boxes by their frames and their positions in these, with their evidence."""
        measurement = self._dataset.active_measurement_id or 0
        evidence = EvidenceRepository(self._session).of_frames(wanted, measurement)
        return [
            ChosenBoxes(frames[key], evidence[key], sorted(wanted[key]))
            for key in wanted
        ]

    def _columns(
        self, chosen: Sequence[ChosenBoxes], *, tag_counts: bool, edges: bool
    ) -> tuple[Evidence, BoxGeometry]:
        """Numbers and rectangles of all of them, frame after frame."""
        record = np.concatenate([each.numbers() for each in chosen])
        counts = None
        if tag_counts:
            counts = np.concatenate([each.tag_counts() for each in chosen])
        names, ids = list(self.classes), list(self.classes.values())
        geometry = [box for each in chosen for box in each.geometry()]
        numbers = to_evidence(record, names, ids, counts)
        return replace(numbers, channels=_channels(chosen)), _box_geometry(
            geometry, edges=edges
        )

    def _facts(self, chosen: ChosenBoxes) -> FrameFacts:
        report = chosen.row.segmentation or {}
        return FrameFacts(
            key=chosen.frame.key,
            config=self.config,
            family=report.get("palette"),
            lossy=chosen.lossy,
            names=self._names(chosen),
        )

    def _names(self, chosen: ChosenBoxes) -> dict[int, tuple[str, str]]:
        """Id and class of the boxes that explain these, by their positions."""
        positions = chosen.explained_by()
        if not positions:
            return {}
        first = chosen.frame.first_box_id
        sources = FrameRepository(self._session).source_ids(
            [first + position for position in positions]
        )
        class_of = {number: name for name, number in self.classes.items()}
        class_ids = chosen.records()["class_id"].tolist()
        return {
            position: (sources[first + position], class_of[class_ids[position]])
            for position in positions
        }

    def _server_fields(
        self, row: CurrentRow, review: LatestReview | None
    ) -> ServerFields:
        return {
            "box_id": row.box_id,
            "frame_id": row.frame_id,
            "run": self._dataset.active_run_id or 0,
            "config": self._version.digest,
            "revision": row.revision,
            "review": _review(review),
            "effective_verdict": effective_verdict(row.reason, row.review),
        }


@dataclass(frozen=True)
class ChosenBoxes:
    """Some boxes of one frame, by their positions, and where their numbers are."""

    frame: Frame
    row: EvidenceRow
    positions: list[int]

    @property
    def box_ids(self) -> list[int]:
        """The server's ids of these boxes."""
        return [self.frame.first_box_id + position for position in self.positions]

    def records(self) -> NDArray[np.void]:
        """The stored records of all boxes of the frame."""
        return unpack_numbers([self.row.numbers], [self.row.box_count])

    @property
    def lossy(self) -> bool:
        """Whether their segmentation had lost colours."""
        return bool((self.row.segmentation or {}).get("lossy"))

    def numbers(self) -> NDArray[np.void]:
        """Their records."""
        return np.asarray(self.records()[self.positions])

    def tag_counts(self) -> NDArray[np.int32]:
        """Their tag histograms."""
        counts = unpack_tag_counts(self.row.tag_counts, self.row.box_count)
        return np.asarray(counts[self.positions], np.int32)

    def explained_by(self) -> list[int]:
        """Positions of the boxes that explain some of these."""
        numbers = unpack_channels([self.row.channels], [self.row.box_count])
        if numbers is None:
            return []
        found = np.unique(numbers.explained_by[self.positions]).tolist()
        return [position for position in found if position != NOT_MEASURED]

    def geometry(self) -> list[Geometry | None]:
        """What they look like in three dimensions."""
        boxes = unpack_geometry(self.row.geometry, self.row.box_count)
        return [boxes[position] for position in self.positions]


def _channels(chosen: Sequence[ChosenBoxes]) -> ChannelNumbers | None:
    counts = [each.row.box_count for each in chosen]
    numbers = unpack_channels([each.row.channels for each in chosen], counts)
    if numbers is None:
        return None
    starts = np.cumsum([0, *counts])
    rows = [
        start + np.array(each.positions, np.int64)
        for start, each in zip(starts[:-1], chosen, strict=True)
    ]
    return numbers[np.concatenate(rows)]


def _box_geometry(boxes: Sequence[Geometry | None], *, edges: bool) -> BoxGeometry:
    absent = (np.nan,) * 4
    return BoxGeometry.loaded(
        amodal_xyxy=np.array(
            [(box and box.amodal_xyxy) or absent for box in boxes], np.float64
        ).reshape(-1, 4),
        visible_xyxy=np.array(
            [(box and box.visible_xyxy) or absent for box in boxes], np.float64
        ).reshape(-1, 4),
        edges=[
            rounded_edges(box.edges) if box is not None and edges else None
            for box in boxes
        ],
    )


def rounded_edges(edges: NDArray[np.floating[Any]]) -> FloatArray:
    """Edges as they are answered of a frame that is stored: as single floats."""
    return np.asarray(edges.astype(np.float32).round(2), np.float64)


def _review(review: LatestReview | None) -> CurrentReview | None:
    if review is None or review.verdict == "clear":
        return None
    return current_review(review._asdict())


def current_review(row: Mapping[str, Any]) -> CurrentReview:
    """An answer in force, out of its row."""
    return {
        "verdict": row["verdict"],
        "reviewer": row["reviewer"],
        "revision": row["revision"],
        "comment": row["comment"],
    }


@lru_cache(maxsize=1024)
def accepted_tags(family: str | None, mask: int) -> list[AcceptedTag]:
    """The tags of an accept mask as they are answered."""
    if family is None:
        return []
    tags = FAMILIES[family].tags
    accepted = accepts(mask, np.array([tag.tag for tag in tags]))
    return [
        {"tag": tags[place].tag, "name": tags[place].name, "rgb": list(tags[place].rgb)}
        for place in np.flatnonzero(accepted)
    ]
