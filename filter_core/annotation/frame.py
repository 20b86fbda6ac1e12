"""What an annotation says once it has been read: immutable values, no reading here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from filter_core.geometry.boxes import FORMS
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.json_text import JsonLimits

VERTICES: Final = "vertices"

BOX3D: Final = "box3d"

FORMS_3D: Final = (VERTICES, BOX3D)

_MIN_KEYS: Final = 200_000
"""Keys that an annotation may have, however few boxes: they cost more than values."""

GEOMETRIES: Final = (*FORMS, *FORMS_3D)
"""The keys under which a box can give its geometry, exactly one of them."""


@dataclass(frozen=True)
class AnnotationLimits:
    """How much one annotation may hold.

    Attributes
    ----------
    max_boxes : int
        Boxes per frame.
    max_text : int
        Characters of an id, a class, a type and of the frame's own texts.
    max_bytes : int
        Bytes of JSON.
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
    index : int
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
    instance_id : int or None
    extra : dict
        Keys that the product does not know, kept to be given back.
    raw : mapping
        The box as it came.
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
    extra: dict[str, object]
    raw: Mapping[str, object]

    @property
    def is_3d(self) -> bool:
        """Whether the box needs a camera."""
        return self.form in FORMS_3D


@dataclass(frozen=True)
class Sensor:
    """A sensor beside the camera: where it stands, and the object as it came."""

    transform: Transform | None
    raw: Mapping[str, object]


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
        The size the annotation promises, also without a complete camera.
    carla_version, captured_at, map : str or None
        `captured_at` is an RFC 3339 time, as given.
    weather : dict
    sensors : dict of Sensor
    extra : dict
        Keys of the frame that the product does not know.
    raw : mapping
        The annotation as it came.
    """

    boxes: tuple[BoxAnnotation, ...]
    camera: Camera | None = None
    camera_wh: tuple[int, int] | None = None
    carla_version: str | None = None
    captured_at: str | None = None
    map: str | None = None
    weather: dict[str, object] = field(default_factory=dict)
    sensors: dict[str, Sensor] = field(default_factory=dict)
    extra: dict[str, object] = field(default_factory=dict)
    raw: Mapping[str, object] = field(default_factory=dict)
