"""Decisions as they are answered: current verdict, numbers, and what people said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.db.evidence_record import (
    Geometry,
    to_evidence,
    unpack_geometry,
    unpack_numbers,
    unpack_tag_counts,
)
from app.db.tables import Dataset, Frame
from app.repositories.datasets import DatasetRepository
from app.repositories.decisions import CurrentRow, DecisionRepository
from app.repositories.evidence import EvidenceRepository, EvidenceRow
from app.repositories.frames import FrameRepository
from app.repositories.reviews import LatestReview, ReviewRepository
from app.services.configs import active_version, config_of
from app.services.reviews import effective_verdict
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.decision_record import FrameFacts, FrameGeometry, decision_dicts
from filter_core.palettes import FAMILIES
from filter_core.types import Evidence


@dataclass(frozen=True)
class DecidedFrame:
    """Some boxes of one frame with the numbers that their decisions rest on."""

    frame: Frame
    row: EvidenceRow
    positions: NDArray[np.int64]
    evidence: Evidence
    geometry: FrameGeometry

    @property
    def box_ids(self) -> list[int]:
        """The server's ids of these boxes."""
        ids: list[int] = (self.positions + self.frame.first_box_id).tolist()
        return ids


class DecisionReader:
    """Reads current decisions of one dataset; made for one request."""

    def __init__(self, session: Session, dataset: Dataset) -> None:
        self._session = session
        self._dataset = dataset
        self._version = active_version(session, dataset)
        self.config: FilterConfig = config_of(self._version)
        self.classes = DatasetRepository(session).classes(dataset.id)

    def of_boxes(self, box_ids: Sequence[int]) -> list[dict[str, Any]]:
        """Decisions in the order of the ids; boxes that are gone are left out."""
        rows = DecisionRepository(self._session).rows(box_ids)
        frames = FrameRepository(self._session).with_ids(
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

    def of_frame(self, frame: Frame) -> list[dict[str, Any]]:
        """Decisions of all boxes of a current frame, in the order they came in."""
        return self.of_frames([frame])[frame.id]

    def of_frames(self, frames: Sequence[Frame]) -> dict[int, list[dict[str, Any]]]:
        """Decisions of all boxes of frames; none for a frame that was replaced."""
        by_id = {frame.id: frame for frame in frames}
        rows = DecisionRepository(self._session).of_frames(by_id)
        current = {row.frame_id for row in rows.values()}
        wanted = {key: range(by_id[key].box_count) for key in by_id if key in current}
        found: dict[int, list[dict[str, Any]]] = {key: [] for key in by_id}
        for decision in self._describe(by_id, wanted, rows):
            found[decision["frame_id"]].append(decision)
        return found

    def palettes(self, frame_ids: Iterable[int]) -> dict[int, str]:
        """Tag families of frames whose segmentations were measured."""
        reports = EvidenceRepository(self._session).reports(
            frame_ids, self._dataset.active_measurement_id or 0
        )
        return {key: report["palette"] for key, report in reports.items() if report}

    def frames(
        self, frames: Mapping[int, Frame], wanted: Mapping[int, Sequence[int]]
    ) -> list[DecidedFrame]:
        """The numbers of chosen boxes, by their positions in each frame."""
        measurement = self._dataset.active_measurement_id or 0
        evidence = EvidenceRepository(self._session).of_frames(wanted, measurement)
        names, ids = list(self.classes), list(self.classes.values())
        return [
            _unpacked(frames[frame_id], evidence[frame_id], positions, names, ids)
            for frame_id, positions in wanted.items()
        ]

    def _describe(
        self,
        frames: Mapping[int, Frame],
        wanted: Mapping[int, Sequence[int]],
        rows: Mapping[int, CurrentRow],
    ) -> list[dict[str, Any]]:
        reviews = ReviewRepository(self._session).latest(
            box_id for box_id, row in rows.items() if row.revision
        )
        described: list[dict[str, Any]] = []
        for decided in self.frames(frames, wanted):
            for decision, box_id in zip(
                self.describe(decided), decided.box_ids, strict=True
            ):
                decision |= self._known_here(
                    box_id, decided, rows[box_id], reviews.get(box_id)
                )
                described.append(decision)
        return described

    def describe(self, decided: DecidedFrame) -> list[dict[str, Any]]:
        """Decisions of some boxes of a frame, as the filter alone would write them."""
        report = decided.row.segmentation or {}
        facts = FrameFacts(
            key=decided.frame.key,
            config=self.config,
            family=report.get("palette"),
            lossy=bool(report.get("lossy")),
        )
        sources = source_ids(decided.frame.annotation)
        return decision_dicts(
            facts,
            [sources[position] for position in decided.positions],
            decided.evidence,
            decide(decided.evidence, self.config),
            decided.geometry,
        )

    def _known_here(
        self,
        box_id: int,
        decided: DecidedFrame,
        row: CurrentRow,
        review: LatestReview | None,
    ) -> dict[str, Any]:
        report = decided.row.segmentation or {}
        index = box_id - decided.frame.first_box_id
        at = int(np.searchsorted(decided.positions, index))
        mask = int(decided.evidence.accept_mask[at])
        return {
            "box_id": box_id,
            "frame_id": decided.frame.id,
            "run": self._dataset.active_run_id,
            "config": self._version.digest,
            "revision": row.revision,
            "review": _review(review),
            "effective_verdict": effective_verdict(row.reason, row.review),
            "accepted_tags": _accepted_tags(report.get("palette"), mask),
        }


def source_ids(annotation: Mapping[str, Any]) -> list[str]:
    """The sender's own ids of a frame's boxes; a missing one is the index."""
    return [
        str(index if box.get("id") is None else box["id"])
        for index, box in enumerate(annotation.get("boxes", ()))
    ]


def _unpacked(
    frame: Frame,
    row: EvidenceRow,
    positions: Iterable[int],
    names: Sequence[str],
    ids: Sequence[int],
) -> DecidedFrame:
    chosen = np.array(sorted(positions), np.int64)
    evidence = to_evidence(
        unpack_numbers([row.numbers]),
        names,
        ids,
        unpack_tag_counts(row.tag_counts, row.box_count),
    )
    geometry = unpack_geometry(row.geometry, row.box_count)
    return DecidedFrame(
        frame=frame,
        row=row,
        positions=chosen,
        evidence=evidence.take(chosen),
        geometry=_solid([geometry[position] for position in chosen]),
    )


def _solid(boxes: Sequence[Geometry | None]) -> FrameGeometry:
    absent = (np.nan,) * 4
    return FrameGeometry(
        amodal_xyxy=np.array(
            [(box and box.amodal_xyxy) or absent for box in boxes], np.float64
        ).reshape(-1, 4),
        visible_xyxy=np.array(
            [(box and box.visible_xyxy) or absent for box in boxes], np.float64
        ).reshape(-1, 4),
        edges=[
            None if box is None else np.asarray(box.edges.round(2), np.float64)
            for box in boxes
        ],
    )


def _review(review: LatestReview | None) -> dict[str, Any] | None:
    if review is None or review.verdict == "clear":
        return None
    return {
        "verdict": review.verdict,
        "reviewer": review.reviewer,
        "revision": review.revision,
        "comment": review.comment,
    }


@lru_cache(maxsize=1024)
def _accepted_tags(family: str | None, mask: int) -> list[dict[str, Any]]:
    if family is None:
        return []
    return [
        {"tag": tag.tag, "name": tag.name, "rgb": list(tag.rgb)}
        for tag in FAMILIES[family].tags
        if mask >> tag.tag & 1
    ]
