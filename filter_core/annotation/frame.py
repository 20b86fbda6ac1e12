"""The parsed annotation of one frame, and its boxes as rectangles.

`filter_core.annotation.parsing` makes these objects from JSON; they are immutable.
`frame_boxes_2d` converts boxes of any form to rectangles in the frame's image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from filter_core.arrays import BoxesXYXY, FloatArray, IntArray
from filter_core.errors import AnnotationError, ImageSizeMismatch
from filter_core.frame_boxes import ProjectionMode
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.boxes import FORMS, to_xyxy
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.geometry.projection import BoxGeometry, project_boxes
from filter_core.json_text import JsonLimits
from filter_core.values import JsonObject

VERTICES: Final = "vertices"

BOX3D: Final = "box3d"

FORMS_3D: Final = (VERTICES, BOX3D)

GEOMETRIES: Final = (*FORMS, *FORMS_3D)
"""The keys under which a box can give its geometry, exactly one of them."""

_MIN_KEYS: Final = 200_000
"""Number of JSON keys that every annotation may have, even with few boxes."""

_OUTSIDE: Final = (-2.0, -2.0, -1.0, -1.0)
"""A rectangle that is outside of every image, in each profile."""


@dataclass(frozen=True)
class AnnotationLimits:
    """How many boxes and bytes of JSON one annotation may hold.

    Also how many characters an id, a class, a type and each text of the frame may have.
    """

    max_boxes: int = 10_000
    max_text: int = 256
    max_bytes: int = 16 << 20

    @property
    def json(self) -> JsonLimits:
        """What its JSON may hold: fifty values and twenty keys for each box.

        A box of eight vertices, an id, a class and two types is 38 values and 5 keys.
        """
        values = max(JsonLimits.max_values, 50 * self.max_boxes)
        keys = max(_MIN_KEYS, 20 * self.max_boxes)
        return JsonLimits(self.max_bytes, max_values=values, max_keys=keys)


@dataclass(frozen=True)
class BoxAnnotation:
    """One box as given.

    Attributes
    ----------
    id : str
        Unique in its frame; the index where none was given.
    class_name, type_id, base_type : str or None
        At least one of `class_name` and `type_id` is there.
    form : str
        One of `GEOMETRIES`.
    values : tuple of float
        4 numbers of a rectangle; 24 of ``vertices`` (x, y, z of each); 15 of ``box3d``:
        the actor's location and rotation (pitch, yaw, roll), then the box's location,
        extent and rotation.
    distance : float or None, metres
        As given.
    raw : mapping
        The box as given, with unknown keys.
    distance_range : (low, high) or None, metres
        What is known of the distance where it is not given: above `low` (or from 0) and
        up to `high`.
    """

    id: str
    index: int
    class_name: str | None
    type_id: str | None
    base_type: str | None
    form: str
    values: tuple[float, ...]
    distance: float | None
    instance_id: int | None
    raw: Mapping[str, object]
    distance_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class FrameAnnotation:
    """One frame's annotation.

    Attributes
    ----------
    boxes : tuple of BoxAnnotation
        In the order given.
    camera : Camera or None
        None where the annotation does not give all of it.
    camera_wh : (width, height) or None, px
        The image's size by the annotation; known also where the camera is incomplete.
    carla_version, captured_at, map : str or None
        `captured_at` is an RFC 3339 time, as given.
    camera_name : str or None
        What the annotation calls its camera.
    sensors : dict of str to Transform or None
        Where each sensor besides the camera stands in the world, if that is given.
    sequence, split : str or None
        The drive that the frame is of, and the part of its data set, such as ``val``.
    raw : mapping
        The annotation as given, with the weather and unknown keys.
    """

    boxes: tuple[BoxAnnotation, ...]
    camera: Camera | None = None
    camera_wh: tuple[int, int] | None = None
    carla_version: str | None = None
    captured_at: str | None = None
    map: str | None = None
    camera_name: str | None = None
    sensors: dict[str, Transform | None] = field(default_factory=dict)
    sequence: str | None = None
    split: str | None = None
    raw: Mapping[str, object] = field(default_factory=dict)

    @property
    def weather_name(self) -> str | None:
        """The weather's preset, ``other`` without one; None if no weather is told."""
        weather = self.raw.get("weather")
        if not isinstance(weather, Mapping):
            return None
        preset = weather.get("preset")
        is_name = isinstance(preset, str) and 0 < len(preset) <= _LONGEST_PRESET
        return str(preset) if is_name else "other"


_LONGEST_PRESET: Final = 256


def frame_boxes_2d(
    annotation: FrameAnnotation,
    wh: tuple[int, int],
    projection: ProjectionMode = "clipped",
) -> BoxGeometry:
    """The rectangles of a frame's boxes in its image of `wh` (width, height), px.

    `projection` is how a 3D box becomes a rectangle; see `project_boxes`.

    Raises
    ------
    ImageSizeMismatch
        The annotation's camera has another size than the image.
    AnnotationError
        ``missing_camera``: there are 3D boxes, but no camera.
    FilterError
        ``bad_projection``.
    """
    if annotation.camera_wh is not None and annotation.camera_wh != wh:
        width, height = annotation.camera_wh
        raise ImageSizeMismatch(
            f"camera: expected {wh[0]} x {wh[1]} px, the image's size, found "
            f"{width} x {height} px",
            pointer="/camera",
        )
    count = len(annotation.boxes)
    geometry = BoxGeometry(
        xyxy=np.full((count, 4), np.nan),
        amodal_xyxy=np.full((count, 4), np.nan),
        visible_xyxy=np.full((count, 4), np.nan),
        edges=[None] * count,
        distance=np.full(count, np.nan),
        vertices=frame_vertices(annotation),
    )
    boxes = annotation.boxes
    for form in {box.form for box in boxes}.intersection(FORMS):
        rows = _rows_of(boxes, form)
        geometry.xyxy[rows] = to_xyxy(form, _values(boxes, rows), wh)
    rows = np.concatenate([_rows_of(boxes, form) for form in FORMS_3D])
    if len(rows):
        if annotation.camera is None:
            box = boxes[rows[0]]
            raise AnnotationError(
                f'box {box.index} (id "{box.id}"), {box.form}: expected a camera to '
                "project it with, found none",
                pointer="/camera",
                code="missing_camera",
            )
        seen = project_boxes(geometry.vertices[rows], annotation.camera, projection)
        geometry.amodal_xyxy[rows] = seen.amodal_xyxy
        geometry.visible_xyxy[rows] = seen.visible_xyxy
        geometry.distance[rows] = seen.distance
        # Algorithm 1 corrects the paper's rectangle itself, so it gets it unclamped.
        xyxy = seen.amodal_xyxy if projection == "naive" else seen.visible_xyxy
        nothing = np.isnan(xyxy).any(axis=1, keepdims=True)
        geometry.xyxy[rows] = np.where(nothing, _OUTSIDE, xyxy)
        for row, edges in zip(rows, seen.edges, strict=True):
            geometry.edges[row] = edges
    for row, box in enumerate(annotation.boxes):
        if box.distance is not None:
            geometry.distance[row] = box.distance
    return geometry


def frame_vertices(annotation: FrameAnnotation) -> FloatArray:
    """(N, 8, 3) float64, metres: world corners of a frame's N boxes.

    NaN rows for 2D boxes.
    """
    boxes = annotation.boxes
    vertices = np.full((len(boxes), 8, 3), np.nan)
    vertex_rows, actors = _rows_of(boxes, VERTICES), _rows_of(boxes, BOX3D)
    if len(vertex_rows):
        vertices[vertex_rows] = _values(boxes, vertex_rows).reshape(-1, 8, 3)
    if len(actors):
        vertices[actors] = boxes3d_vertices(_values(boxes, actors))
    return vertices


def given_rectangles(boxes: Sequence[JsonObject], wh: tuple[int, int]) -> BoxesXYXY:
    """(N, 4) float64, px: the rectangles of boxes as given, which may leave the image.

    Of a 3D box it is one outside of the image. `boxes` were checked before; `wh` is
    (width, height) of the image, px.
    """
    rectangles = np.full((len(boxes), 4), _OUTSIDE)
    rows: dict[str, list[int]] = {}
    for row, box in enumerate(boxes):
        for form in box.keys() & FORMS:
            rows.setdefault(form, []).append(row)
    for form, of_form in rows.items():
        rectangles[of_form] = to_xyxy(form, [boxes[row][form] for row in of_form], wh)
    return rectangles


def _rows_of(boxes: Sequence[BoxAnnotation], form: str) -> IntArray:
    rows = [row for row, box in enumerate(boxes) if box.form == form]
    return np.array(rows, dtype=np.int64)


def _values(boxes: Sequence[BoxAnnotation], rows: IntArray) -> FloatArray:
    return np.array([boxes[row].values for row in rows], dtype=np.float64)
