"""All channels of one frame, measured together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from filter_core.channel_types import NOT_MEASURED, ChannelNumbers
from filter_core.config.keys import CHANNELS
from filter_core.evidence.accepted import AcceptedPixels, accepted_pixels
from filter_core.evidence.assign import InstanceBoxes, measure_instances
from filter_core.evidence.depth import (
    DepthImage,
    center_gaps,
    depth_interval,
    measure_depth,
)
from filter_core.evidence.instances import InstanceImage
from filter_core.evidence.lidar import LidarPoints, points_inside
from filter_core.evidence.ordered import owned_pixels
from filter_core.evidence.silhouettes import silhouettes
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.segmentation.pixel_codes import Segmentation
from filter_core.types import BoxesXYXY, FloatArray, IntArray, Mask


@dataclass(frozen=True, eq=False)
class FrameSensors:
    """What of a frame is there to be measured.

    Attributes
    ----------
    segmentation : Segmentation or None
        Ordered and depth need it.
    camera : Camera or None
        Depth needs it; without it, 3D boxes are looked at as rectangles.
    depth : DepthImage or None
    instances : InstanceImage or None
    points : LidarPoints or None
    lidar : Transform or None
        Where the LiDAR stands in the world; LiDAR needs it.
    ignore : (H, W) bool or None
        Pixels that never count.
    depth_tolerance : float, metres
    """

    segmentation: Segmentation | None = None
    camera: Camera | None = None
    depth: DepthImage | None = None
    instances: InstanceImage | None = None
    points: LidarPoints | None = None
    lidar: Transform | None = None
    ignore: Mask | None = None
    depth_tolerance: float = 0.15


@dataclass(frozen=True, eq=False)
class ChannelBoxes:
    """The N boxes of a frame as the channels need them.

    Attributes
    ----------
    ids : sequence of str
    xyxy : (N, 4) float64, px
        Corrected; NaN rows for boxes that are not in the image.
    vertices : (N, 8, 3) float64, metres; NaN rows for boxes that are not 3D
    distance : (N,) float64, metres, NaN where unknown
    accept_mask : (N,) int64
    instance_id : (N,) int64, `NOT_MEASURED` where none was given
    image_wh : (width, height), px
    """

    ids: Sequence[str]
    xyxy: BoxesXYXY
    vertices: FloatArray
    distance: FloatArray
    accept_mask: IntArray
    instance_id: IntArray
    image_wh: tuple[int, int]


def measure_channels(
    boxes: ChannelBoxes, sensors: FrameSensors, channels: Collection[str] = CHANNELS
) -> ChannelNumbers:
    """What the channels of a frame say of its boxes.

    Parameters
    ----------
    boxes : ChannelBoxes of N boxes
    sensors : FrameSensors
        A channel whose input is not there stays unmeasured.
    channels : names out of `CHANNELS`
        The others stay unmeasured, and cost nothing.

    Returns
    -------
    ChannelNumbers of N boxes
    """
    numbers = ChannelNumbers.absent(len(boxes.ids))
    outlines = silhouettes(
        boxes.xyxy,
        boxes.vertices,
        sensors.camera,
        boxes.image_wh,
        centres="ordered" in channels,
    )
    if "instance" in channels and sensors.instances is not None:
        wanted = InstanceBoxes(
            boxes.xyxy, boxes.accept_mask, boxes.distance, boxes.instance_id
        )
        measure_instances(numbers, sensors.instances, wanted, outlines)
    if sensors.segmentation is not None and not {"ordered", "depth"}.isdisjoint(
        channels
    ):
        accepted = accepted_pixels(
            outlines, sensors.segmentation.codes, boxes.accept_mask, sensors.ignore
        )
        if "ordered" in channels:
            _measure_order(numbers, boxes, accepted)
        if "depth" in channels:
            _measure_depth(numbers, boxes, sensors, accepted)
    if "depth_center" in channels:
        _measure_centers(numbers, boxes, sensors)
    if "lidar" in channels and sensors.points is not None and sensors.lidar is not None:
        numbers.lidar_points[:] = points_inside(
            sensors.points, sensors.lidar, boxes.vertices, boxes.accept_mask
        )
    return numbers


def _measure_order(
    numbers: ChannelNumbers, boxes: ChannelBoxes, accepted: list[AcceptedPixels]
) -> None:
    owned, explained_by = owned_pixels(
        accepted, boxes.distance, boxes.ids, boxes.image_wh
    )
    numbers.owned_pixels[:] = owned
    numbers.explained_by[:] = explained_by


def _measure_depth(
    numbers: ChannelNumbers,
    boxes: ChannelBoxes,
    sensors: FrameSensors,
    accepted: list[AcceptedPixels],
) -> None:
    if sensors.depth is None or sensors.camera is None:
        return
    interval = depth_interval(boxes.vertices, sensors.camera, sensors.depth_tolerance)
    measure_depth(numbers, accepted, sensors.depth, interval)


def _measure_centers(
    numbers: ChannelNumbers, boxes: ChannelBoxes, sensors: FrameSensors
) -> None:
    if sensors.depth is not None and sensors.camera is not None:
        gaps = center_gaps(boxes.vertices, sensors.camera, sensors.depth)
        numbers.center_gap[:] = gaps


def no_instance_ids(count: int) -> IntArray:
    """(count,) int64: no box names its instance."""
    return np.full(count, NOT_MEASURED, np.int64)
