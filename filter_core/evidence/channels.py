"""Measuring all evidence of one frame: from its segmentation and its other sensors.

`measure_evidence` takes the boxes, the sensors' data (`Sensors`) and what to measure
(`MeasureConfig`), and returns `Evidence`. It reads the files and passes them to the
other modules of this package, which measure one kind of evidence each. Numbers that
are not requested, or whose input is missing, stay "not measured".
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import UNKNOWN_TAG, FloatArray, IntArray, Mask
from filter_core.config.measure import MeasureConfig
from filter_core.errors import ImageError, error_context
from filter_core.evidence.depth import (
    center_gaps,
    depth_interval,
    fill_depth,
    read_depth,
    settled_depth,
)
from filter_core.evidence.instances import (
    fill_instances,
    read_instances,
    settled_instances,
)
from filter_core.evidence.lidar import points_inside, read_points
from filter_core.evidence.ordered import owned_pixels
from filter_core.evidence.semantic import MeasureOptions, measure
from filter_core.evidence.silhouettes import (
    AcceptedPixels,
    accepted_pixels,
    frame_silhouettes,
)
from filter_core.evidence_kinds import files_for
from filter_core.evidence_numbers import ChannelNumbers, Evidence
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.boxes import correct_xyxy
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.images.header import MAX_SIDE
from filter_core.segmentation.codes import Segmentation


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors' data of one frame; what is missing is None.

    Attributes
    ----------
    segmentation : Segmentation or None
        Of the channels, ``ordered`` and ``depth`` need it.
    camera : Camera or None
        ``depth`` and ``depth_center`` need it. Without it, the silhouettes of 3D boxes
        are their rectangles.
    lidar : Transform or None
        The pose of the LiDAR in the world; ``lidar`` needs it.
    ignore : (H, W) bool or None
        Pixels of the segmentation that never count.
    contents : Mapping
        The bytes of files by their kinds, ``depth``, ``instances`` and ``lidar``; a
        file is read only if a channel to be measured needs it.
    pixels : Mapping
        (H, W, 3) uint8 in place of such files, ``depth`` and ``instances``: blue, green
        and red.
    max_side : int, px
        Largest width and height of the pictures among these files.
    tags_of_numbers : (256,) uint8 or None
        The tag of each number in an instance image or a LiDAR file; None: itself.
    """

    segmentation: Segmentation | None = None
    camera: Camera | None = None
    lidar: Transform | None = None
    ignore: Mask | None = None
    contents: Mapping[str, bytes] = field(default_factory=dict)
    pixels: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    max_side: int = MAX_SIDE
    tags_of_numbers: NDArray[np.uint8] | None = None

    def measurable_channels(self, config: MeasureConfig) -> tuple[str, ...]:
        """The channels of a configuration that need no file, or whose file is there."""
        there = self.contents.keys() | self.pixels.keys()
        return tuple(name for name in config.channels if there >= {*files_for([name])})

    def picture(self, kind: str) -> bytes | NDArray[np.uint8]:
        """The depth or instance image: its pixels if they are there, else its file."""
        return self.pixels[kind] if kind in self.pixels else self.contents[kind]


def measure_evidence(
    boxes: FrameBoxes, sensors: Sensors, config: MeasureConfig
) -> tuple[Evidence, tuple[str, ...]]:
    """All numbers of a frame's N boxes that a configuration asks for, and notes.

    `channels` of the evidence are None if no channel can be measured. The notes say
    what a person should know about how the sensors' files were read.

    Raises
    ------
    FilterError
        What `filter_core.evidence.semantic.measure` raises; or a file cannot be used. A
        depth or instance image that is too coarse or not understood is refused only if
        nothing else is to be measured (`MeasureConfig.requires`); else its channels
        stay unmeasured, and a note says why.
    """
    options = MeasureOptions(config.profile, config.version)
    evidence = measure(sensors.segmentation, boxes, options, ignore=sensors.ignore)
    channels = sensors.measurable_channels(config)
    if np.isnan(boxes.distance).all():  # then nothing is nearer than something else
        channels = tuple(name for name in channels if name != "ordered")
    if not channels:
        return evidence, ()
    # Equal to `evidence.xyxy`, whose type allows None for evidence that was loaded.
    xyxy, _ = correct_xyxy(
        boxes.xyxy, boxes.image_wh, options.profile, rounded_edges=options.version > 1
    )
    corrected = replace(boxes, xyxy=xyxy)
    numbers, notes = _measure_channels(corrected, sensors, config, channels)
    return replace(evidence, channels=numbers), notes


def _measure_channels(
    boxes: FrameBoxes,
    sensors: Sensors,
    config: MeasureConfig,
    channels: Collection[str],
) -> tuple[ChannelNumbers, tuple[str, ...]]:
    """The numbers of the given channels, and notes.

    Those of other channels stay "not measured".
    """
    numbers, notes = ChannelNumbers.absent(len(boxes)), list[str]()
    wh, camera, segmentation = boxes.image_wh, sensors.camera, sensors.segmentation
    # A file is read by its kind, since two channels share the depth image.
    kinds = files_for(channels)
    instances = None
    if "instances" in kinds:
        noting = _noting("instances", "instances are", config, notes)
        with noting, error_context(pointer="/instances"):
            instances = read_instances(
                sensors.picture("instances"),
                sensors.segmentation,
                expected_wh=wh,
                max_side=sensors.max_side,
                tags_of_numbers=sensors.tags_of_numbers,
            )
    points = _read_points(sensors) if "lidar" in kinds else None

    silhouettes = frame_silhouettes(
        boxes.xyxy, boxes.vertices, camera, wh, centres="ordered" in channels
    )
    accepted: list[AcceptedPixels] = []
    if segmentation is not None and not {"ordered", "depth"}.isdisjoint(channels):
        accepted = accepted_pixels(
            silhouettes, segmentation.codes, boxes.accept_mask, sensors.ignore
        )
    if instances is not None:
        instances = settled_instances(
            instances, boxes, silhouettes, sensors.tags_of_numbers
        )
        notes.extend(instances.notes)
        fill_instances(numbers, instances, boxes, silhouettes)
    if "ordered" in channels and segmentation is not None:
        owned, explained_by = owned_pixels(accepted, boxes.distance, boxes.ids, wh)
        numbers.owned_pixels[:] = owned
        numbers.explained_by[:] = explained_by
    if "depth" in kinds:
        notes.extend(_measure_depth(numbers, boxes, sensors, config, accepted))
    if points is not None and sensors.lidar is not None:
        numbers.lidar_points[:] = points_inside(
            *points, sensors.lidar, boxes.vertices, boxes.accept_mask
        )
    return numbers, tuple(notes)


def _measure_depth(
    numbers: ChannelNumbers,
    boxes: FrameBoxes,
    sensors: Sensors,
    config: MeasureConfig,
    accepted: Sequence[AcceptedPixels],
) -> tuple[str, ...]:
    """Fill the columns that the depth image measures; the notes on how it was read."""
    camera = sensors.camera
    notes: list[str] = []
    with _noting("depth", "depth is", config, notes):
        with error_context(pointer="/depth"):
            depth = read_depth(
                sensors.picture("depth"),
                config.depth_encoding,
                expected_wh=boxes.image_wh,
                max_side=sensors.max_side,
            )
            if camera is None:
                return ()
            interval = depth_interval(boxes.vertices, camera, config.depth_tolerance)
            depth = settled_depth(depth, accepted, interval)
        if "depth" in config.channels:
            fill_depth(numbers, accepted, depth, interval)
        if "depth_center" in config.channels:
            numbers.center_gap[:] = center_gaps(boxes.vertices, camera, depth)
        notes.extend(depth.notes)
    return tuple(notes)


_NO_EVIDENCE: Final = (
    *("depth_too_coarse", "lossy_depth", "unknown_depth"),
    *("bad_instances", "lossy_instances"),
)
"""Errors of an image that is not damaged, but from which nothing follows."""


@contextmanager
def _noting(
    kind: str, subject: str, config: MeasureConfig, notes: list[str]
) -> Iterator[None]:
    """Turn the error of a file that is no evidence into a note, if others may be."""
    try:
        yield
    except ImageError as error:
        if error.kind not in _NO_EVIDENCE or config.requires(kind):
            raise
        notes.append(f"{subject} not used as evidence: {error.detail}")


def _read_points(sensors: Sensors) -> tuple[FloatArray, IntArray]:
    xyz, tags = read_points(sensors.contents["lidar"])
    table = sensors.tags_of_numbers
    if table is not None:
        is_listed = (tags >= 0) & (tags < len(table))
        listed = table[np.where(is_listed, tags, 0)].astype(np.int64)
        tags = np.where(is_listed, listed, UNKNOWN_TAG)
    return xyz, tags
