"""The schema of a frame's annotation, for the OpenAPI document and generated clients.

The library reads annotations itself (`filter_core.annotation`), since it names every
error of a file at once; a test compares the keys of both. Keys that are not here are
kept and come back with the frame, as in all exports of the manifest.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from unghost.wire.model import optional

Four: TypeAlias = Annotated[list[float], Field(min_length=4, max_length=4)]


class _Open(BaseModel):
    model_config = ConfigDict(extra="allow")


class Vector(_Open):
    """A point or a direction in CARLA's axes, in metres."""

    x: float = Field(description="Forward.", examples=[1.5])
    y: float = Field(description="To the right.", examples=[0.0])
    z: float = Field(description="Up.", examples=[2.4])


class Rotation(_Open):
    """A rotation as CARLA has it, in degrees; an absent angle is 0."""

    pitch: float = Field(description="Up.", examples=[0.0], default=0)
    yaw: float = Field(description="To the right.", examples=[90.0], default=0)
    roll: float = Field(description="To the right side.", examples=[0.0], default=0)


class Pose(Vector, Rotation):
    """Where something stands in the world: its location and its rotation."""


class AnnotatedCamera(_Open):
    """The camera; 3D boxes need all of it, and 2D boxes nothing of it."""

    name: str | None = optional(
        description="What it is called, to tell the cameras of a vehicle apart.",
        examples=["front"],
    )
    width: int = Field(description="Width of the image in pixels.", examples=[1280])
    height: int = Field(description="Height of the image in pixels.", examples=[720])
    fov: float | None = optional(
        description="Horizontal field of view in degrees.", examples=[90]
    )
    intrinsic: list[list[float]] | None = optional(
        description="3 x 3 matrix, instead of `fov`."
    )
    transform: Pose | None = optional(
        description="Where the camera stands in the world."
    )
    world_to_camera: list[list[float]] | None = optional(
        description="4 x 4 matrix, instead of `transform`."
    )


class Box3d(_Open):
    """A 3D box as CARLA has it: that of an actor, in the actor's axes."""

    transform: Pose | None = optional(
        description="Of the actor; without it the box is given in the world."
    )
    location: Vector | None = optional(
        description="Centre of the box in the actor's axes."
    )
    extent: Vector = Field(description="Half of its sizes.")
    rotation: Rotation | None = optional(
        description="Its rotation in the actor's axes."
    )


class AnnotatedBox(_Open):
    """A box as it is sent; with `class` or `type_id`, and exactly one geometry.

    The geometries are `xyxy`, `xyxyn`, `xywh`, `cxcywh`, `cxcywhn`, `vertices` and
    `box3d`.
    """

    id: str | int | None = optional(
        description="Unique in its frame; its index if there is none.", examples=["217"]
    )
    class_name: str | None = optional(
        alias="class", description="Its class.", examples=["car"]
    )
    type_id: str | None = optional(
        description="CARLA's blueprint, which tells the class.",
        examples=["vehicle.ford.ambulance"],
    )
    base_type: str | None = optional(
        description="CARLA's `base_type` of the blueprint.", examples=["van"]
    )
    xyxy: Four | None = optional(
        description="Left, top, right, bottom in pixels.",
        examples=[[83, 410, 466, 640]],
    )
    xyxyn: Four | None = optional(
        description="The same as shares of the image's size.",
        examples=[[0.1, 0.5, 0.3, 0.8]],
    )
    xywh: Four | None = optional(
        description="Left, top, width, height in pixels.", examples=[[10, 20, 30, 40]]
    )
    cxcywh: Four | None = optional(
        description="Centre and size in pixels.", examples=[[25, 40, 30, 40]]
    )
    cxcywhn: Four | None = optional(
        description="The same as shares of the image's size.",
        examples=[[0.5, 0.5, 0.1, 0.1]],
    )
    vertices: list[Vector | list[float]] | None = optional(
        description="Eight corners in the world; needs the camera."
    )
    box3d: Box3d | None = optional(description="The 3D box; needs the camera.")
    distance: float | None = optional(
        description="Metres from the camera.", examples=[12.5]
    )
    distance_range: tuple[float, float] | None = optional(
        description="Between how many metres from the camera it is, where the distance "
        "itself is not known.",
        examples=[[50, 80]],
    )
    instance_id: int | None = optional(
        description="Its id in the instance image.", examples=[217]
    )
    extra: dict[str, object] | None = optional(description="Anything else; it is kept.")


class Annotation(_Open):
    """What is known about a frame: its boxes and, if known, its camera and more."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"boxes": [{"id": "217", "class": "car", "xyxy": [83, 410, 466, 640]}]}
            ]
        }
    )

    boxes: list[AnnotatedBox] = Field(description="The boxes; the list may be empty.")
    camera: AnnotatedCamera | None = optional(
        description="The camera; 3D boxes need it."
    )
    carla_version: str | None = optional(
        description="The version of CARLA, which tells the palette.",
        examples=["0.9.15"],
    )
    captured_at: str | None = optional(
        description="When the frame was recorded (RFC 3339).",
        examples=["2026-01-31T12:00:00Z"],
    )
    map: str | None = optional(description="CARLA's map.", examples=["Town10HD"])
    weather: dict[str, object] | None = optional(
        description="CARLA's weather; it is kept."
    )
    sensors: dict[str, object] | None = optional(
        description="Where each sensor besides the camera stands."
    )
    sequence: str | None = optional(
        description="The drive that the frame is of.", examples=["drive-3"]
    )
    split: str | None = optional(
        description="The part of its data set that it came with.", examples=["val"]
    )
    extra: dict[str, object] | None = optional(description="Anything else; it is kept.")
