"""Frames as they are answered."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel

from app.schemas.boxes import DecisionOut


class FrameCounts(BaseModel):
    """Boxes of a frame."""

    boxes: int
    kept: int
    rejected: int
    unmeasured: int
    reviewed: int
    to_review: int


class FrameSummary(BaseModel):
    """A frame in a list."""

    id: int
    key: str
    revision: int
    width: int | None
    height: int | None
    map: str | None
    has_image: bool
    has_segmentation: bool
    lossy: bool
    created_at: datetime
    counts: FrameCounts


class SegmentationOut(BaseModel):
    """What was recognised in a segmentation."""

    palette: str
    encoding: str
    channel_order: str
    lossy: bool
    unknown_percent: float
    notes: list[str]


class FileOut(BaseModel):
    """A file of a frame."""

    url: str
    sha256: str
    media_type: str
    size_bytes: int


class FrameDetails(FrameSummary):
    """A frame without its boxes."""

    dataset: str
    camera: dict[str, Any] | None
    carla_version: str | None
    captured_at: str | None
    weather: dict[str, Any] | None
    superseded: bool
    segmentation: SegmentationOut | None
    files: dict[str, FileOut]


class FrameOut(FrameDetails):
    """A frame between its neighbours, with its boxes and their decisions."""

    previous_id: int | None
    next_id: int | None
    boxes: list[DecisionOut]


class StoredFrameOut(BaseModel):
    """A frame that is stored, what was recognised, and what was decided."""

    frame: FrameDetails
    segmentation: SegmentationOut | None
    decisions: list[DecisionOut]
