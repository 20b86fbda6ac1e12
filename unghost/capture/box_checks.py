"""CARLA's boxes are sometimes wrong: what is recognised, repaired, marked, left out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from filter_core.geometry.pose import Triple

_LEAST_M: Final = 0.05
_MOST_M: Final = 15.0
_FARTHEST_M: Final = 3.0
_TWO_WHEELERS: Final[Mapping[str, Triple]] = {
    "bicycle": (0.82, 0.30, 0.85),
    "motorcycle": (1.10, 0.40, 0.75),
}
"""Half sizes for the blueprints whose own are zero up to CARLA 0.9.16."""
_PARKED_CAR: Final[Triple] = (2.3, 0.95, 0.75)
_PART_HALF_HEIGHT_M: Final = 0.5
_BUTTON_HALF_HEIGHT_M: Final = 0.2
_SLIM_HALF_M: Final = 0.1
_WIDENED_HALF_M: Final = 0.2
_CAPSULE_M: Final = 1e-3


@dataclass(frozen=True)
class LocalBox:
    """Centre, half sizes and turn of a box, and what was done to it.

    Attributes
    ----------
    location, extent : (x, y, z), metres
    rotation : (pitch, yaw, roll), degrees
    flags : tuple of str
    given : dict
        Centre and half sizes as CARLA gave them, where they were changed.
    """

    location: Triple
    extent: Triple
    rotation: Triple = (0.0, 0.0, 0.0)
    flags: tuple[str, ...] = ()
    given: tuple[Triple, Triple] | None = None

    def changed(self, flag: str, **parts: Triple) -> LocalBox:
        """Another location, extent or rotation, and a word for why."""
        given = self.given or (self.location, self.extent)
        flags = (*self.flags, flag)
        return replace(self, flags=flags, given=given, **parts)

    def marked(self, flag: str) -> LocalBox:
        """The same box with a word about it."""
        return replace(self, flags=(*self.flags, flag))


def is_sane(box: LocalBox) -> bool:
    """Whether the box can be one of a vehicle or a person."""
    numbers = (*box.location, *box.extent, *box.rotation)
    if not all(math.isfinite(number) for number in numbers):
        return False
    if any(not _LEAST_M <= half <= _MOST_M for half in box.extent):
        return False
    return math.hypot(box.location[0], box.location[1]) <= _FARTHEST_M


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
    """A parked car that is a prop; its own turn is wrong in CARLA 0.9.15."""
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
