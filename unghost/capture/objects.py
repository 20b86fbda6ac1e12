"""An object that may get a box: who it is, where, and how large."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from filter_core.geometry.pose import Transform, Triple
from unghost.capture.box_checks import LocalBox
from unghost.capture.poses import rounded
from unghost.capture.simulator import Box, Vector


@dataclass(frozen=True)
class Named:
    """What does not change about an object.

    Attributes
    ----------
    id : str
        Unique in the frame, the same in all frames.
    source : str
        ``actor``, ``environment``, ``light`` or ``level``: which call gave the box.
    class_name : str or None
        None: nothing maps the blueprint, `type_id` stands for it.
    """

    id: str
    source: str
    class_name: str | None
    type_id: str | None = None
    base_type: str | None = None
    semantic_tags: tuple[int, ...] = ()
    instance_id: int | None = None
    more: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SeenObject:
    """An object with its box at one tick; without a pose the box is in the world."""

    named: Named
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
    ) -> dict[str, Any]:
        """The box as the manifest has it."""
        named = self.named
        names = {
            "id": named.id,
            "class": named.class_name,
            "type_id": named.type_id,
            "base_type": named.base_type,
            "instance_id": named.instance_id,
        }
        band = next((edge for edge in bands if distance <= edge), None)
        notes: dict[str, Any] = {
            "source": named.source,
            "semantic_tags": list(named.semantic_tags) or None,
            "band": band,
            "flags": list(self.box.flags) or None,
            **named.more,
        }
        if self.box.given is not None:
            location, extent = self.box.given
            notes["box_given"] = {"location": xyz(location), "extent": xyz(extent)}
        return {
            **_present(names),
            "box3d": self._box3d(),
            "distance": round(distance, 3),
            "extra": _present(notes),
        }

    def _box3d(self) -> dict[str, Any]:
        pitch, yaw, roll = self.box.rotation
        pose = {} if self.pose is None else {"transform": self.pose.as_dict()}
        return {
            **pose,
            "location": xyz(self.box.location),
            "extent": xyz(self.box.extent),
            "rotation": {"pitch": pitch, "yaw": yaw, "roll": roll},
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


def _triple(vector: Vector) -> Triple:
    return rounded(vector.x), rounded(vector.y), rounded(vector.z)


def _present(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}
