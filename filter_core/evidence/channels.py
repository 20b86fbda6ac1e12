"""What the channels beside the segmentation say of one frame, measured together.

Boxes, files of sensors and a `MeasureConfig` come in; `ChannelNumbers` come out, with
"not measured" where a channel is not asked for or its file is not there. No threshold
is known here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from filter_core.annotation.frame import FrameAnnotation
from filter_core.config.keys import CHANNELS, FILE_OF
from filter_core.config.measure import MeasureConfig
from filter_core.errors import ImageError
from filter_core.evidence.depth import (
    DepthImage,
    center_gaps,
    depth_interval,
    measure_depth,
    read_depth,
)
from filter_core.evidence.instances import (
    InstanceBoxes,
    InstanceImage,
    measure_instances,
    read_instances,
)
from filter_core.evidence.lidar import LidarPoints, points_inside, read_points
from filter_core.evidence.ordered import owned_pixels
from filter_core.evidence.silhouettes import (
    AcceptedPixels,
    accepted_pixels,
    silhouettes,
)
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.geometry.projection import BoxGeometry
from filter_core.images.header import MAX_SIDE
from filter_core.segmentation.codes import Segmentation
from filter_core.types import (
    NOT_MEASURED,
    BoxesXYXY,
    ChannelNumbers,
    Evidence,
    FloatArray,
    IntArray,
    Mask,
)


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


@dataclass(frozen=True, eq=False)
class SensorFiles:
    """What came with a frame beside its segmentation.

    Attributes
    ----------
    contents : Mapping
        Bytes by kind: ``depth``, ``instances``, ``lidar``; read if they are needed.
    max_side : int, px
    """

    contents: Mapping[str, bytes] = field(default_factory=dict)
    max_side: int = MAX_SIDE

    def wanted(self, config: MeasureConfig) -> tuple[str, ...]:
        """The channels to measure, those whose file is missing left out."""
        return tuple(
            name
            for name in config.channels
            if FILE_OF.get(name, "") in ("", *self.contents)
        )


@dataclass(frozen=True, eq=False)
class FrameParts:
    """What has been read and measured of a frame so far.

    `wh` is its width and height in px.
    """

    annotation: FrameAnnotation
    segmentation: Segmentation | None
    geometry: BoxGeometry
    wh: tuple[int, int]
    ignore: Mask | None = None


def measure_frame_channels(
    parts: FrameParts, evidence: Evidence, config: MeasureConfig, files: SensorFiles
) -> ChannelNumbers | None:
    """What the wanted channels say of a frame's boxes; None if none is wanted.

    Raises
    ------
    FilterError
        A file cannot be used. A depth image that is too coarse is refused only if the
        configuration says so (`MeasureConfig.depth_required`); else depth stays
        unmeasured.
    """
    wanted = files.wanted(config)
    if not wanted:
        return None
    annotation = parts.annotation
    boxes = ChannelBoxes(
        ids=[box.id for box in annotation.boxes],
        xyxy=_rectangles(evidence),
        vertices=parts.geometry.vertices,
        distance=evidence.distance,
        accept_mask=evidence.accept_mask,
        instance_id=_instance_ids(annotation),
        image_wh=parts.wh,
    )
    reader = _Reader(files, parts.wh, lenient=not config.depth_required)
    kinds = {FILE_OF.get(name) for name in wanted}
    sensors = FrameSensors(
        segmentation=parts.segmentation,
        camera=annotation.camera,
        depth=reader.depth() if "depth" in kinds else None,
        instances=reader.instances() if "instances" in kinds else None,
        points=reader.points() if "lidar" in kinds else None,
        lidar=_lidar_transform(annotation),
        ignore=parts.ignore,
        depth_tolerance=config.depth_tolerance,
    )
    return measure_channels(boxes, sensors, wanted)


@dataclass(frozen=True)
class _Reader:
    files: SensorFiles
    wh: tuple[int, int]
    lenient: bool

    def depth(self) -> DepthImage | None:
        try:
            with _pointing("/depth"):
                return read_depth(
                    self.files.contents["depth"],
                    expected_wh=self.wh,
                    max_side=self.files.max_side,
                )
        except ImageError as error:
            if self.lenient and error.kind in ("depth_too_coarse", "lossy_depth"):
                return None
            raise

    def instances(self) -> InstanceImage:
        with _pointing("/instances"):
            return read_instances(
                self.files.contents["instances"],
                expected_wh=self.wh,
                max_side=self.files.max_side,
            )

    def points(self) -> LidarPoints:
        return read_points(self.files.contents["lidar"])


@contextmanager
def _pointing(pointer: str) -> Iterator[None]:
    """A fault raised within is of this file."""
    try:
        yield
    except ImageError as error:
        raise type(error)(
            error.detail, pointer=error.pointer or pointer, code=error.kind
        ) from error


def _rectangles(
    evidence: Evidence,
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    if evidence.xyxy is None:
        raise ValueError("channels need the corrected rectangles")
    return evidence.xyxy


def _instance_ids(annotation: FrameAnnotation) -> IntArray:
    return np.array(
        [
            NOT_MEASURED if box.instance_id is None else box.instance_id
            for box in annotation.boxes
        ],
        np.int64,
    )


def _lidar_transform(annotation: FrameAnnotation) -> Transform | None:
    sensor = annotation.sensors.get("lidar")
    return None if sensor is None else sensor.transform
