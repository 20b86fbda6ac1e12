"""Objects that may get a box: their identity, their pose, and their size.

CARLA's boxes are sometimes wrong. For each kind of object, a function `checked_...`
repairs a box with a known defect, marks it, or returns None if it is meaningless. This
module works on numbers and does not call the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from filter_core.geometry.pose import Transform, Triple
from unghost.capture.simulator import Box, Vector, rounded

_LEAST_M, _MOST_M = 0.05, 15.0
"""Half sizes that a vehicle or a person can have."""
_FARTHEST_M: Final = 3.0
"""How far a box's centre can be from its actor's origin, seen from above."""
_TWO_WHEELERS: Final[Mapping[str, Triple]] = {
    "bicycle": (0.82, 0.30, 0.85),
    "motorcycle": (1.10, 0.40, 0.75),
}
"""Half sizes for the blueprints whose own are zero up to CARLA 0.9.16."""
_PARKED_CAR: Final[Triple] = (2.3, 0.95, 0.75)
"""Half sizes of a parked car whose own are impossible."""
_PART_HALF_HEIGHT_M: Final = 0.5
"""Objects below this height are parts of a parked vehicle."""
_BUTTON_HALF_HEIGHT_M: Final = 0.2
"""Objects below this height are buttons of pedestrians' lights."""
_SLIM_HALF_M, _WIDENED_HALF_M = 0.1, 0.2
"""A light's head that is thinner than the first number gets the second."""
_CAPSULE_M: Final = 1e-3
"""The rounding error within which a walker's box counts as a collision capsule."""


@dataclass(frozen=True)
class ObjectIdentity:
    """The constant data of an object; `type_id` and `base_type` as CARLA has them.

    `id` is unique in the frame, the same in all frames. `source` is the call that gave
    the box: ``actor``, ``environment``, ``light`` or ``level``. Without a class,
    `type_id` is used instead. `semantic_tags` are the simulator's, `instance_id` is
    that of the instance image, 16 bits, and `more` are further notes for the
    annotation.
    """

    id: str
    source: str
    class_name: str | None
    type_id: str | None = None
    base_type: str | None = None
    semantic_tags: tuple[int, ...] = ()
    instance_id: int | None = None
    more: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class LocalBox:
    """Centre and half sizes (x, y, z) in metres, and (pitch, yaw, roll) in degrees.

    `flags` say how it was corrected, and `given` are centre and half sizes as CARLA
    gave them, where they were changed.
    """

    location: Triple
    extent: Triple
    rotation: Triple = (0.0, 0.0, 0.0)
    flags: tuple[str, ...] = ()
    given: tuple[Triple, Triple] | None = None

    def changed(self, flag: str, **parts: Triple) -> LocalBox:
        """The box with another location, extent or rotation; `flag` says why."""
        original = self.given or (self.location, self.extent)
        flags = (*self.flags, flag)
        return replace(self, flags=flags, given=original, **parts)

    def marked(self, flag: str) -> LocalBox:
        """The same box with a flag."""
        return replace(self, flags=(*self.flags, flag))


@dataclass(frozen=True)
class SeenObject:
    """An object with its box at one tick; without a pose the box is in the world."""

    named: ObjectIdentity
    box: LocalBox
    pose: Transform | None = None

    @property
    def row(self) -> tuple[float, ...]:
        """15 numbers, as `filter_core.geometry.box3d.boxes3d_vertices` takes them."""
        pose = self.pose or Transform()
        box = self.box
        parts = (pose.location, pose.rotation, box.location, box.extent, box.rotation)
        return tuple(number for part in parts for number in part)

    def as_annotation(
        self, distance: float, bands: tuple[float, ...]
    ) -> dict[str, object]:
        """The box as the manifest has it, with its distance from the camera in metres.

        `bands` are upper ends of distance ranges, metres, rising; the first one that
        holds the box's centre is noted.
        """
        named = self.named
        names = {
            "id": named.id,
            "class": named.class_name,
            "type_id": named.type_id,
            "base_type": named.base_type,
            "instance_id": named.instance_id,
        }
        band = next((edge for edge in bands if distance <= edge), None)
        notes: dict[str, object] = {
            "source": named.source,
            "semantic_tags": list(named.semantic_tags) or None,
            "band": band,
            "flags": list(self.box.flags) or None,
            **named.more,
        }
        if self.box.given is not None:
            location, extent = self.box.given
            notes["box_given"] = {"location": xyz(location), "extent": xyz(extent)}
        pitch, yaw, roll = self.box.rotation
        pose = {} if self.pose is None else {"transform": self.pose.as_dict()}
        return {
            **_present(names),
            "box3d": {
                **pose,
                "location": xyz(self.box.location),
                "extent": xyz(self.box.extent),
                "rotation": {"pitch": pitch, "yaw": yaw, "roll": roll},
            },
            "distance": round(distance, 3),
            "extra": _present(notes),
        }


def local_box(box: Box) -> LocalBox:
    """A `carla.BoundingBox` as numbers."""
    turn = box.rotation
    return LocalBox(
        _triple(box.location),
        _triple(box.extent),
        (rounded(turn.pitch), rounded(turn.yaw), rounded(turn.roll)),
    )


def xyz(vector: Triple) -> dict[str, float]:
    """A vector as annotations have it."""
    return dict(zip("xyz", vector, strict=True))


def _present(values: Mapping[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}


def checked_vehicle(box: LocalBox, base_type: str, *, repair: bool) -> LocalBox | None:
    """A vehicle's box; a two-wheeler's impossible one is replaced, others are None."""
    if is_sane(box):
        return box
    usual = _TWO_WHEELERS.get(base_type)
    if usual is None or not repair:
        return None
    return box.changed(
        "default_size",
        extent=usual,
        location=(0.0, 0.0, usual[2]),
        rotation=(0.0, 0.0, 0.0),
    )


def checked_walker(box: LocalBox, widen_m: float) -> LocalBox | None:
    """A walker's box; a collision capsule is marked and widened, sideways alone."""
    if not is_sane(box):
        return None
    x, y, z = box.extent
    if abs(x - y) > _CAPSULE_M or math.hypot(*box.location) > _CAPSULE_M:
        return box
    marked = box.marked("capsule")
    if widen_m == 0:
        return marked
    return marked.changed("widened", extent=(x + widen_m, y + widen_m, z))


def checked_prop(box: LocalBox) -> LocalBox:
    """A parked car that is a prop; its own rotation is wrong in CARLA 0.9.15."""
    straight = box.changed("straightened", rotation=(0.0, 0.0, 0.0))
    if is_sane(straight) and straight.extent[2] >= _PART_HALF_HEIGHT_M:
        return straight
    place = (0.0, 0.0, _PARKED_CAR[2])
    return straight.changed("default_size", extent=_PARKED_CAR, location=place)


def checked_parked(box: LocalBox, class_name: str) -> LocalBox | None:
    """A parked vehicle of the map, in the world's frame; parts of one are None."""
    if any(half < 0 for half in box.extent):
        # The mesh was mirrored.
        x, y, z = (abs(half) for half in box.extent)
        pitch, yaw, roll = box.rotation
        turned = (pitch, (yaw + 360) % 360 - 180, roll)
        box = box.changed("mirrored", extent=(x, y, z), rotation=turned)
    if not is_sane(replace(box, location=(0.0, 0.0, 0.0))):
        return None
    if class_name in _TWO_WHEELERS or box.extent[2] >= _PART_HALF_HEIGHT_M:
        return box
    return None


def checked_light(box: LocalBox) -> LocalBox | None:
    """The box of a traffic light's head; pedestrians' buttons are None."""
    x, y, z = (abs(half) for half in box.extent)
    if not all(map(math.isfinite, (*box.location, x, y, z))):
        return None
    if z < _BUTTON_HALF_HEIGHT_M or max(x, y, z) > _MOST_M:
        return None
    if min(x, y) >= _SLIM_HALF_M:
        return box
    wide = tuple(_WIDENED_HALF_M if half < _SLIM_HALF_M else half for half in (x, y))
    return box.changed("thickened", extent=(wide[0], wide[1], z))


def is_sane(box: LocalBox) -> bool:
    """Whether the box can be one of a vehicle or a person."""
    numbers = (*box.location, *box.extent, *box.rotation)
    if not all(math.isfinite(number) for number in numbers):
        return False
    if any(not _LEAST_M <= half <= _MOST_M for half in box.extent):
        return False
    return math.hypot(box.location[0], box.location[1]) <= _FARTHEST_M


def _triple(vector: Vector) -> Triple:
    return rounded(vector.x), rounded(vector.y), rounded(vector.z)
