"""Frames of a folder on their way into another format, with no server in between."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

from filter_core.annotation.frame_geometry import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.export import ExportFrame, export_boxes
from filter_core.formats.reading import FrameSource
from filter_core.images.header import read_image_header
from filter_core.local import decide_source, in_order
from filter_core.pipeline import box_class
from filter_core.segmentation.reading import SegmentationOptions

_KNOWN: Final = (
    "car",
    "truck",
    "van",
    "bus",
    "motorcycle",
    "bicycle",
    "walker",
    "traffic_light",
    "vehicle",
)


@dataclass(frozen=True)
class LeftOut:
    """A frame that cannot be exported, and why."""

    key: str
    problem: FilterError


def export_sources(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    *,
    measure: bool = False,
    workers: int | None = None,
) -> Generator[ExportFrame | LeftOut, None, None]:
    """Frames of a folder as the writers of formats take them.

    Parameters
    ----------
    frames : iterable of FrameSource
        Read only a few frames ahead.
    config : FilterConfig
    measure : bool
        Read the segmentations, so that the filter decides; else all boxes that are in
        the image are ``unmeasured``.
    workers : int, optional

    Yields
    ------
    ExportFrame or LeftOut
        In the order of the frames; one that cannot be read does not stop the others.
    """
    return in_order(lambda one: _export_frame(one, config, measure), frames, workers)


def class_order(frames: Iterable[FrameSource]) -> tuple[str, ...]:
    """The classes of frames whose layout has no list of them, in an order that lasts.

    The filter's own classes come in its own order, then all others by name: neither
    the order of the frames nor how often a class occurs makes a difference.
    """
    found: set[str] = set()
    for frame in frames:
        try:
            annotation = parse_annotation(frame.annotation or {}, frame=frame.key)
        except FilterError:
            # It is named when its turn comes; here only its classes are missed.
            continue
        found.update(map(box_class, annotation.boxes))
    known = [name for name in _KNOWN if name in found]
    return (*known, *sorted(found - set(known)))


def _export_frame(
    source: FrameSource, config: FilterConfig, measure: bool
) -> ExportFrame | LeftOut:
    try:
        return _decided(source, config, measure)
    except FilterError as problem:
        return LeftOut(source.key, problem)


def _decided(source: FrameSource, config: FilterConfig, measure: bool) -> ExportFrame:
    if not measure:
        # A mask would be read for nothing, and depth or LiDAR as well.
        source = replace(source, segmentation=None, others={})
    result = decide_source(source, config, SegmentationOptions())
    measured = result.measured
    annotation = measured.annotation
    decisions = result.decisions if measure else map(_undecided, result.decisions)
    geometry = frame_boxes_2d(annotation, measured.wh, config.projection)
    frame = ExportFrame(
        key=source.key,
        wh=measured.wh,
        boxes=export_boxes(annotation, decisions, geometry),
        map=annotation.map,
        palette=(measured.segmentation or {}).get("palette"),
        annotation=annotation.raw,
        camera=annotation.camera,
    )
    return _with_image(frame, source)


def _undecided(decision: dict[str, Any]) -> dict[str, Any]:
    """A box in the image that nothing was measured of, whatever its class."""
    if decision["xyxy"] is None:
        return decision
    return {**decision, "verdict": "unmeasured", "reason": "no_segmentation"}


def _with_image(frame: ExportFrame, source: FrameSource) -> ExportFrame:
    path = source.image
    if path is None:
        return frame
    try:
        media_type = read_image_header(path.read_bytes()).media_type
    except OSError as exc:
        raise LayoutError(f"{path.name}: cannot be read: {exc.strerror}") from exc
    return replace(frame, read_image=path.read_bytes, media_type=media_type)
