"""The channels of one frame: which are wanted, which files they need, what they say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from filter_core.annotation.frame import FrameAnnotation
from filter_core.annotation.frame_geometry import GeometryResult
from filter_core.channel_types import NOT_MEASURED, ChannelNumbers
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import AUTO, CHANNELS, FILE_OF
from filter_core.errors import ImageError
from filter_core.evidence.depth import DepthImage, read_depth
from filter_core.evidence.instances import InstanceImage, read_instances
from filter_core.evidence.lidar import LidarPoints, read_points
from filter_core.evidence.sensors import ChannelBoxes, FrameSensors, measure_channels
from filter_core.geometry.pose import Transform
from filter_core.images.header import MAX_SIDE
from filter_core.segmentation.pixel_codes import Segmentation
from filter_core.types import Evidence, IntArray, Mask


def files_for(channels: Iterable[str]) -> tuple[str, ...]:
    """The kinds of files that channels read, beside the segmentation."""
    kinds = (FILE_OF.get(name) for name in channels)
    return tuple(sorted({kind for kind in kinds if kind is not None}))


@dataclass(frozen=True, eq=False)
class SensorFiles:
    """What came with a frame beside its segmentation.

    Attributes
    ----------
    contents : Mapping
        Bytes by kind: ``depth``, ``instances``, ``lidar``; read if they are needed.
    channels : tuple of str, or None
        What is to be measured; None: what the configuration decides by.
    max_side : int, px
    depth_tolerance : float, metres, or None
        None: as the configuration says.
    """

    contents: Mapping[str, bytes] = field(default_factory=dict)
    channels: tuple[str, ...] | None = None
    max_side: int = MAX_SIDE
    depth_tolerance: float | None = None

    def wanted(self, config: FilterConfig) -> tuple[str, ...]:
        """The channels to measure, those whose file is missing left out."""
        asked = config.channels if self.channels is None else self.channels
        return tuple(
            name
            for name in CHANNELS
            if name in asked and FILE_OF.get(name, "") in ("", *self.contents)
        )

    def tolerance(self, config: FilterConfig) -> float:
        """How far from its box a depth may be, metres."""
        own = self.depth_tolerance
        return float(config.depth_tolerance if own is None else own)


@dataclass(frozen=True, eq=False)
class FrameParts:
    """What has been read and measured of a frame so far.

    `wh` is its width and height in px.
    """

    annotation: FrameAnnotation
    segmentation: Segmentation | None
    geometry: GeometryResult
    wh: tuple[int, int]
    ignore: Mask | None = None


def measure_frame_channels(
    parts: FrameParts, evidence: Evidence, config: FilterConfig, files: SensorFiles
) -> ChannelNumbers | None:
    """What the wanted channels say of a frame's boxes; None if none is wanted.

    Raises
    ------
    FilterError
        A file cannot be used. A depth image that is too coarse is only refused where
        the configuration decides by depth: ``auto`` and comparisons promise no more
        than a frame allows.
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
    strict = config.evidence != AUTO and "depth" in files_for(config.channels)
    reader = _Reader(files, parts.wh, lenient=not strict)
    kinds = {FILE_OF.get(name) for name in wanted}
    sensors = FrameSensors(
        segmentation=parts.segmentation,
        camera=annotation.camera,
        depth=reader.depth() if "depth" in kinds else None,
        instances=reader.instances() if "instances" in kinds else None,
        points=reader.points() if "lidar" in kinds else None,
        lidar=_lidar_transform(annotation),
        ignore=parts.ignore,
        depth_tolerance=files.tolerance(config),
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
