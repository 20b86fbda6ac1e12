"""Datasets as they are answered, and what is counted over a frame and a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from pydantic import AwareDatetime, Field

from unghost.wire.model import Json, ResponseModel
from unghost.wire.words import ChannelOrder, Encoding, LossyPolicy, Palette


class _OfFrames(ResponseModel):
    frames: int


class _OfBoxes(ResponseModel):
    boxes: int


class VerdictCounts(ResponseModel):
    """How many boxes have each verdict."""

    kept: int
    rejected: int
    unmeasured: int


Counts: TypeAlias = VerdictCounts
"""What all counts have in common, under the name by which `unghost` offers it."""


# Bases are written from right to left: that is the order of the keys in an answer.
class FrameCounts(VerdictCounts, _OfBoxes):
    """Boxes of a frame: by the filter's verdict, and by what people said.

    `reviewed` boxes have a keep or a reject, `to_review` are those that wait for one.
    """

    reviewed: int
    to_review: int


class DatasetCounts(FrameCounts, _OfFrames):
    """Boxes of a dataset, its frames, and the frames that were refused (`problems`)."""

    problems: int


class Dataset(ResponseModel):
    """A named set of frames with one list of classes and one active run."""

    name: str
    description: str = ""
    classes: tuple[str, ...]
    classes_frozen: bool = False
    palette: Palette
    encoding: Encoding
    channel_order: ChannelOrder
    lossy_segmentation: LossyPolicy
    has_ignore_mask: bool = False
    created_at: AwareDatetime
    config: str = Field(description="Digest of the active configuration.")
    active_run: int
    thumbnail_frame_id: int | None = None
    counts: DatasetCounts


class RefusedFrame(ResponseModel):
    """A frame that was sent and refused, with the problem it was refused for."""

    id: int
    key: str
    error: Json
    created_at: AwareDatetime


class Stats(FrameCounts, _OfFrames):
    """Everything that can be counted without looking at a box.

    `unsure` boxes have a person's unsure; of `conflicts` a person said the opposite of
    the filter; `toss_ups` are near a threshold; of `lossy` boxes the segmentation's
    colours were not exact. `effective` counts verdicts as they are after people's
    answers, everything else those of the filter.
    """

    unsure: int
    conflicts: int
    toss_ups: int
    lossy: int
    effective: VerdictCounts
    by_reason: Mapping[str, int]
    by_class: Mapping[str, VerdictCounts]
    config: str
    run: int


class Histogram(ResponseModel):
    """Boxes per bin of match_percent, for each class that occurs.

    `edges` has one number more than the counts of a class; `thresholds` has the active
    configuration's for each class, in percent.
    """

    edges: tuple[float, ...]
    classes: Mapping[str, tuple[int, ...]]
    thresholds: Mapping[str, float]
