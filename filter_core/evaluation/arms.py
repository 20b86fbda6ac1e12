"""Arms of an experiment: the labels that each way of cleaning a recording leaves.

All arms have the same frames, and all but ``raw`` the same rectangles: only which boxes
are there differs. `LabelNoise` counts what is wrong with the labels of each arm.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, TypeAlias, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray
from filter_core.config.filter import FilterConfig
from filter_core.decisions.channel_rules import IS_FINAL
from filter_core.decisions.rules import decide
from filter_core.errors import ConfigError
from filter_core.evaluation.comparison import PartCounts, PartsObject
from filter_core.evidence_kinds import AUTO, SEMANTIC, EvidenceChoice
from filter_core.evidence_numbers import Evidence
from filter_core.geometry.boxes import pairwise_iou
from filter_core.verdicts import REJECTED, VERDICT_OF_REASON

ArmKind: TypeAlias = Literal[
    "raw",
    "clipped",
    "paper",
    "carlasimu",
    "ordered",
    "depth",
    "instance",
    "auto",
    "perfect",
    "random",
]
"""The kinds of arms.

``raw``: every box as the simulator projects it, that is, the smallest rectangle around
its eight projected corners, cut at the image. ``clipped``: the same boxes with exact
rectangles, as in all other arms. ``paper``, ``carlasimu``: what the filter keeps under
these profiles. ``ordered``, ``depth``, ``instance``, ``auto``: what it keeps by this
evidence. ``perfect``: the objects of the truth. ``random``: a control, which takes as
many boxes at random from each frame of ``clipped`` as ``auto`` rejects.
"""

ARMS: Final[tuple[ArmKind, ...]] = get_args(ArmKind)

_ARM: Final = re.compile(r"(?P<kind>[a-z]+)(@(?P<pixels>[0-9]{1,6}))?")

_EVIDENCE: Final[Mapping[ArmKind, EvidenceChoice]] = {
    "paper": SEMANTIC,
    "carlasimu": SEMANTIC,
    "ordered": "ordered",
    "depth": "depth",
    "instance": "instance",
    "auto": AUTO,
    "random": AUTO,
}
"""By what the filter decides the boxes of an arm; the control counts its rejections."""

_FILTERED: Final = tuple(kind for kind in _EVIDENCE if kind != "random")

OBJECT, GHOST, DOUBTFUL = np.int8(1), np.int8(0), np.int8(-1)
"""The truth of a box: it shows an object, or nothing, or it is not to be judged."""

PIXELS: Final = (0, 1, 3, 10, 30, 100)
"""Visible pixels from which the next group begins."""

_OVERLAP: Final = 0.5
"""A label that overlaps the object's rectangle less than this is misplaced."""


class Arm(NamedTuple):
    """An arm of an experiment.

    `pixels` is the key `min_visible_pixels` of its configuration; None: its default.
    """

    kind: ArmKind
    pixels: int | None = None

    @classmethod
    def named(cls, name: str) -> Arm:
        """The arm of a name: a kind, or ``ordered@3`` with `min_visible_pixels`.

        Raises `ConfigError`: there is no such arm.
        """
        match = _ARM.fullmatch(name)
        for kind in ARMS:
            if match is None or kind != match["kind"]:
                continue
            if match["pixels"] is None:
                return cls(kind)
            if kind in _FILTERED:
                return cls(kind, int(match["pixels"]))
        raise ConfigError(
            f"arms: expected {', '.join(ARMS)}, or one of {', '.join(_FILTERED)} with "
            f"min_visible_pixels as in ordered@3, found {name[:40]!r}"
        )

    @property
    def name(self) -> str:
        """As `named` reads it."""
        return self.kind if self.pixels is None else f"{self.kind}@{self.pixels}"

    def config(self, base: FilterConfig) -> FilterConfig | None:
        """What decides its boxes, None if no configuration does.

        Classes, palettes and all keys that an arm does not set are those of `base`.
        """
        if self.kind not in _EVIDENCE:
            return None
        evidence = _EVIDENCE[self.kind]
        pixels = base.min_visible_pixels if evidence == AUTO else 1
        return replace(
            base,
            evidence=evidence,
            profile="carlasimu" if self.kind == "carlasimu" else "paper",
            min_visible_pixels=pixels if self.pixels is None else self.pixels,
        )


@dataclass(frozen=True, eq=False)
class ProjectedBoxes:
    """The N boxes of a frame as one projection measures them.

    `xyxy` (N, 4), px, is inside the image; NaN rows for boxes that the projection does
    not see there.
    """

    evidence: Evidence
    xyxy: BoxesXYXY


@dataclass(frozen=True, eq=False)
class LabelledBoxes:
    """The N boxes of a frame, with their truth and the arms that label them.

    Attributes
    ----------
    class_index : (N,) int32
    distance : (N,) float64, metres, NaN where unknown
    truth : (N,) int8
        `OBJECT`, `GHOST` or `DOUBTFUL`.
    pixels : (N,) int64
        How many of its pixels are visible; `NOT_MEASURED` where unknown.
    xyxy, raw_xyxy, tight_xyxy : (N, 4) float64, px
        The exact rectangle, that of the simulator, and the one around the visible
        pixels; NaN rows where there is none.
    labelled : mapping of str to (N,) bool
        Which boxes each arm labels.
    without_evidence : mapping of str to (N,) bool
        Which boxes the arm's own evidence has no number for, so that the segmentation
        decided them, or nothing did; only of arms that a configuration decides.
    """

    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    distance: FloatArray
    truth: NDArray[np.int8]
    pixels: IntArray
    xyxy: BoxesXYXY
    raw_xyxy: BoxesXYXY
    tight_xyxy: BoxesXYXY
    labelled: Mapping[str, BoolArray]
    without_evidence: Mapping[str, BoolArray]

    def rectangles(self, arm: str) -> BoxesXYXY:
        """(N, 4): the rectangles of an arm.

        The simulator's stand in for boxes of which nothing is in the image: an arm that
        keeps such a ghost has no other.
        """
        if arm == "raw":
            return self.raw_xyxy
        has_rectangle = ~np.isnan(self.xyxy[:, :1])
        return np.where(has_rectangle, self.xyxy, self.raw_xyxy)


@dataclass(frozen=True, eq=False)
class BoxTruth:
    """What is known about the N boxes of a frame; see `LabelledBoxes`."""

    truth: NDArray[np.int8]
    pixels: IntArray


def truth_of_pixels(pixels: IntArray, least: int) -> BoxTruth:
    """The truth by (N,) visible pixels: from `least` on it is an object.

    With fewer, or where they are unknown, the box is doubtful; without any, a ghost.
    """
    truth = np.full(len(pixels), DOUBTFUL)
    truth[pixels >= least] = OBJECT
    truth[pixels == 0] = GHOST
    return BoxTruth(truth, pixels)


def label_boxes(
    key: str,
    exact: ProjectedBoxes,
    naive: ProjectedBoxes,
    box_truth: BoxTruth,
    configs: Mapping[str, FilterConfig | None],
) -> LabelledBoxes:
    """Which boxes of one frame each arm labels.

    Parameters
    ----------
    key : str
        The frame's; the control draws by it, the same boxes each time.
    exact, naive : ProjectedBoxes
        Measured under profile ``paper`` with all evidence that the arms need, and under
        ``carlasimu``.
    configs : mapping of str to FilterConfig or None
        The arms by name, with what decides their boxes (`Arm.config`).
    """
    evidence = exact.evidence
    has_raw = _has_area(naive.xyxy)
    has_exact = _has_area(exact.xyxy)
    # What the camera does not see is a ghost, whatever the instance image says.
    unseen = ~has_exact & ~np.isnan(evidence.distance)
    truth = np.where(unseen, GHOST, box_truth.truth)
    whole = {"raw": has_raw, "clipped": has_exact, "perfect": truth == OBJECT}
    labelled: dict[str, BoolArray] = {}
    without: dict[str, BoolArray] = {}
    for name, config in configs.items():
        if config is None:
            labelled[name] = whole[name]
            continue
        by = naive.evidence if config.profile == "carlasimu" else evidence
        decisions = decide(by, config)
        verdict = VERDICT_OF_REASON[decisions.reason]
        is_open = ~IS_FINAL[decisions.reason]
        by_own = decisions.channel > 0 if config.channels else by.measured
        without[name] = is_open & ~by_own
        kept = (verdict != REJECTED) & (has_exact | has_raw)
        labelled[name] = _at_random(key, has_exact, kept) if name == "random" else kept
    tight = np.full_like(exact.xyxy, np.nan)
    if evidence.channels is not None:
        tight = evidence.channels.tight_xyxy
    return LabelledBoxes(
        class_names=evidence.class_names,
        class_index=evidence.class_index,
        distance=evidence.distance,
        truth=truth,
        pixels=box_truth.pixels,
        xyxy=exact.xyxy,
        raw_xyxy=naive.xyxy,
        tight_xyxy=tight,
        labelled=labelled,
        without_evidence=without,
    )


def _has_area(xyxy: BoxesXYXY) -> BoolArray:
    # Comparisons with NaN are False.
    return np.asarray(((xyxy[:, 2:] - xyxy[:, :2]) >= 0.01).all(axis=1))


def _at_random(key: str, there: BoolArray, kept: BoolArray) -> BoolArray:
    """Some of the boxes `there`, as many as are kept."""
    seed = hashlib.sha256(key.encode("utf-8", "surrogatepass")).digest()
    rng = np.random.default_rng(list(seed))
    chosen = rng.permutation(np.flatnonzero(there))[: int((there & kept).sum())]
    drawn = np.zeros(len(there), np.bool_)
    drawn[chosen] = True
    return drawn


class PixelsObject(TypedDict):
    """The boxes with so many visible pixels, and how many of them an arm labels."""

    pixels: str
    boxes: int
    labelled: int


class ArmObject(PartsObject):
    """The label noise of an arm as JSON.

    ``labels`` are all of its labels, ``doubtful`` those that are not judged, and
    ``misplaced`` those of objects that lie elsewhere than the object.
    ``without_evidence`` are boxes that its evidence has no number for. The counts of
    `Confusion` are about all other boxes: ``kept_hidden`` are its ghosts, and
    ``rejected_visible`` the objects that it loses.
    """

    labels: int
    doubtful: int
    misplaced: int
    without_evidence: int
    by_pixels: list[PixelsObject]


class NoiseObject(TypedDict):
    """`LabelNoise` as JSON; boxes are all that the frames have, seen or not."""

    frames: int
    boxes: int
    objects: int
    ghosts: int
    doubtful: int
    arms: dict[str, ArmObject]


@dataclass
class _ArmNoise(PartCounts):
    labels: int = 0
    doubtful: int = 0
    misplaced: int = 0
    without_evidence: int = 0
    by_pixels: IntArray = field(
        default_factory=lambda: np.zeros((2, len(PIXELS)), np.int64)
    )

    def add(self, boxes: LabelledBoxes, arm: str) -> None:
        kept = boxes.labelled[arm]
        judged = boxes.truth != DOUBTFUL
        is_object = boxes.truth == OBJECT
        self.count(boxes, kept, is_object, judged)
        self.labels += int(kept.sum())
        self.doubtful += int((kept & ~judged).sum())
        self.without_evidence += int(np.sum(boxes.without_evidence.get(arm, 0)))
        rows = np.flatnonzero(kept & is_object)
        own = np.diagonal(pairwise_iou(boxes.rectangles(arm)[rows], boxes.xyxy[rows]))
        self.misplaced += int((own < _OVERLAP).sum())
        for row, some in enumerate((boxes.pixels >= 0, kept & (boxes.pixels >= 0))):
            group = np.searchsorted(PIXELS, boxes.pixels[some], side="right") - 1
            self.by_pixels[row] += np.bincount(group, minlength=len(PIXELS))

    def as_dict(self) -> ArmObject:
        groups = zip(pixel_groups(), *self.by_pixels.tolist(), strict=True)
        return {
            **self.parts(),
            "labels": self.labels,
            "doubtful": self.doubtful,
            "misplaced": self.misplaced,
            "without_evidence": self.without_evidence,
            "by_pixels": [
                {"pixels": name, "boxes": boxes, "labelled": labelled}
                for name, boxes, labelled in groups
            ],
        }


def pixel_groups() -> list[str]:
    """The names of the groups that begin at `PIXELS`: ``0``, ``1-2`` and so on."""
    lasts = [following - 1 for following in PIXELS[1:]]
    names = [
        str(first) if first == last else f"{first}-{last}"
        for first, last in zip(PIXELS, lasts, strict=False)
    ]
    return [*names, f"{PIXELS[-1]}+"]


class LabelNoise:
    """Counts what is wrong with the labels of each arm, frame by frame."""

    def __init__(self, arms: Sequence[str]) -> None:
        self._arms = {name: _ArmNoise() for name in arms}
        self._frames = 0
        self._truth = np.zeros(3, np.int64)

    def add(self, boxes: LabelledBoxes) -> None:
        """Count the boxes of one frame."""
        self._frames += 1
        self._truth += np.bincount(boxes.truth + 1, minlength=3)
        for name, arm in self._arms.items():
            arm.add(boxes, name)

    def as_dict(self) -> NoiseObject:
        """All counts, ready for JSON."""
        doubtful, ghosts, objects = self._truth.tolist()
        return {
            "frames": self._frames,
            "boxes": doubtful + ghosts + objects,
            "objects": objects,
            "ghosts": ghosts,
            "doubtful": doubtful,
            "arms": {name: arm.as_dict() for name, arm in self._arms.items()},
        }
