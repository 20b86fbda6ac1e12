"""From an annotation to the rectangles that the filter measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from filter_core.annotation.frame import BOX3D, VERTICES, BoxAnnotation, FrameAnnotation
from filter_core.errors import AnnotationError, ImageSizeMismatch
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.boxes import FORMS, to_xyxy
from filter_core.geometry.projection import Projections, project_boxes
from filter_core.types import BoxesXYXY, FloatArray, IntArray

_OUTSIDE: Final = (-2.0, -2.0, -1.0, -1.0)
"""A rectangle that every profile finds outside of every image."""


@dataclass(frozen=True, eq=False)
class GeometryResult:
    """The N boxes of a frame in its image.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        What the filter corrects and measures: the rectangle as given; of a 3D box what
        the projection makes of it, and a rectangle outside of the image where the
        camera sees nothing.
    amodal_xyxy, visible_xyxy : (N, 4) float64, px
        Of 3D boxes, before and after clipping to the image; NaN rows for 2D boxes and
        where there is nothing.
    edges : list of N (E, 4) float64 arrays, px, or None
        Clipped edges to draw; None for 2D boxes.
    distance : (N,) float64, metres
        As given, else from the camera to the 3D box's centre, else NaN.
    vertices : (N, 8, 3) float64, metres
        World corners of 3D boxes; NaN rows for 2D boxes.
    """

    xyxy: BoxesXYXY
    amodal_xyxy: BoxesXYXY
    visible_xyxy: BoxesXYXY
    edges: list[FloatArray | None]
    distance: FloatArray
    vertices: FloatArray

    def __len__(self) -> int:
        return len(self.xyxy)


def frame_boxes_2d(
    annotation: FrameAnnotation, wh: tuple[int, int], projection: str = "clipped"
) -> GeometryResult:
    """The rectangles of a frame's boxes in its image.

    Parameters
    ----------
    annotation : FrameAnnotation
    wh : (width, height) of the image, px
    projection : {"clipped", "naive"}
        How a 3D box becomes a rectangle; see `project_boxes`.

    Returns
    -------
    GeometryResult

    Raises
    ------
    ImageSizeMismatch
        The annotation's camera has another size than the image.
    AnnotationError
        ``missing_camera``: there are 3D boxes, but no camera.
    FilterError
        ``bad_projection``.
    """
    if annotation.camera_wh not in (None, wh):
        raise _size_mismatch(annotation.camera_wh, wh)
    boxes = annotation.boxes
    count = len(boxes)
    result = GeometryResult(
        xyxy=np.full((count, 4), np.nan),
        amodal_xyxy=np.full((count, 4), np.nan),
        visible_xyxy=np.full((count, 4), np.nan),
        edges=[None] * count,
        distance=np.full(count, np.nan),
        vertices=np.full((count, 8, 3), np.nan),
    )
    _fill_rectangles(result, boxes, wh)
    _fill_projections(result, annotation, projection)
    for row, box in enumerate(boxes):
        if box.distance is not None:
            result.distance[row] = box.distance
    return result


def _size_mismatch(
    camera_wh: tuple[int, int] | None, wh: tuple[int, int]
) -> ImageSizeMismatch:
    found = "no size" if camera_wh is None else f"{camera_wh[0]} x {camera_wh[1]} px"
    return ImageSizeMismatch(
        f"camera: expected {wh[0]} x {wh[1]} px, the image's size, found {found}",
        pointer="/camera",
    )


def _rows_of(boxes: Sequence[BoxAnnotation], form: str) -> IntArray:
    rows = [row for row, box in enumerate(boxes) if box.form == form]
    return np.array(rows, dtype=np.int64)


def _values(boxes: Sequence[BoxAnnotation], rows: IntArray) -> FloatArray:
    return np.array([boxes[row].values for row in rows], dtype=np.float64)


def _fill_rectangles(
    result: GeometryResult, boxes: Sequence[BoxAnnotation], wh: tuple[int, int]
) -> None:
    for form in {box.form for box in boxes}.intersection(FORMS):
        rows = _rows_of(boxes, form)
        result.xyxy[rows] = to_xyxy(form, _values(boxes, rows), wh)


def _fill_projections(
    result: GeometryResult, annotation: FrameAnnotation, projection: str
) -> None:
    boxes = annotation.boxes
    given, actors = _rows_of(boxes, VERTICES), _rows_of(boxes, BOX3D)
    rows = np.concatenate([given, actors])
    if len(rows) == 0:
        return
    if annotation.camera is None:
        raise _no_camera(boxes[rows[0]])
    result.vertices[given] = _values(boxes, given).reshape(-1, 8, 3)
    result.vertices[actors] = boxes3d_vertices(_values(boxes, actors))
    seen = project_boxes(result.vertices[rows], annotation.camera, projection)
    result.amodal_xyxy[rows] = seen.amodal_xyxy
    result.visible_xyxy[rows] = seen.visible_xyxy
    result.distance[rows] = seen.distance
    result.xyxy[rows] = _measured_rectangles(seen, projection)
    for row, edges in zip(rows, seen.edges, strict=True):
        result.edges[row] = edges


def _measured_rectangles(seen: Projections, projection: str) -> BoxesXYXY:
    # Algorithm 1 corrects the paper's rectangle itself, so it gets it unclamped.
    xyxy = seen.amodal_xyxy if projection == "naive" else seen.visible_xyxy
    nothing = np.isnan(xyxy).any(axis=1, keepdims=True)
    measured: BoxesXYXY = np.where(nothing, _OUTSIDE, xyxy)
    return measured


def _no_camera(box: BoxAnnotation) -> AnnotationError:
    return AnnotationError(
        f'box {box.index} (id "{box.id}"), {box.form}: expected a camera to project it '
        "with, found none",
        pointer="/camera",
        code="missing_camera",
    )
