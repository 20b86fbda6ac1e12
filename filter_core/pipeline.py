"""One frame through the whole filter: annotation and segmentation in, decisions out.

`filter_frame` reads, measures and decides. `measure_frame` is the half of it that reads
pixels: it gives numbers, from which any thresholds can be decided later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from typing import Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from filter_core.annotation.frame import BoxAnnotation, FrameAnnotation, frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.annotation.units import check_units
from filter_core.arrays import NOT_MEASURED, Mask
from filter_core.class_names import class_of
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.explain import BoxName, FrameFacts
from filter_core.decisions.record import Decision, decision_dicts
from filter_core.decisions.rules import decide
from filter_core.errors import ImageSizeMismatch, SegmentationError
from filter_core.evidence.channels import Sensors, measure_evidence
from filter_core.evidence_numbers import Evidence
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.projection import BoxGeometry, forward_distances
from filter_core.images.drawing import COLORS
from filter_core.images.header import MAX_SIDE, exchanged_sides
from filter_core.images.pixels import ChannelOrder
from filter_core.segmentation.codes import Segmentation
from filter_core.segmentation.palettes import NEWEST, family_of_version
from filter_core.segmentation.reading import (
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from filter_core.verdicts import Decisions


@dataclass(frozen=True)
class FrameOptions:
    """Data and options of a frame besides its annotation and segmentation.

    Attributes
    ----------
    key : str
        The frame's name, in decisions and errors.
    image_wh : (width, height) or None, px
        Of the RGB image; else the segmentation's or the camera's size counts.
    dataset : SegmentationOptions
        How the dataset's segmentations are read. Not used with a
        `MeasureConfig`, which contains it already.
    ignore : (H, W) bool or None
        Pixels that never count.
    sensors : Mapping
        The bytes of other sensors' files, by kind: ``depth``, ``instances`` and
        ``lidar``. A file is read if the configuration has a channel that needs it.
    pixels : Mapping
        (H, W, 3) uint8 in place of the files ``depth`` and ``instances``: blue, green
        and red, as OpenCV has them.
    max_side : int, px
        The largest width and height of an image.
    """

    key: str = ""
    image_wh: tuple[int, int] | None = None
    dataset: SegmentationOptions = field(default_factory=SegmentationOptions)
    ignore: Mask | None = None
    sensors: Mapping[str, bytes] = field(default_factory=dict)
    pixels: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    max_side: int = MAX_SIDE


class SegmentationReport(TypedDict):
    """What was recognised in a segmentation, ready for JSON.

    `notes` are also about the frame's depth and instance image.
    """

    palette: str
    encoding: Literal["palette", "raw"]
    channel_order: ChannelOrder
    lossy: bool
    unknown_percent: float
    notes: list[str]


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A frame's evidence, from which any thresholds can be decided.

    Attributes
    ----------
    ids : tuple of str
        Of the N boxes, in the order of the annotation.
    wh : (width, height), px
    evidence : Evidence of N boxes
    geometry : BoxGeometry of N boxes
    segmentation : SegmentationReport or None
        None if there was no segmentation. Its notes include `notes`.
    notes : tuple of str
        What a person should know about how other sensors' files were read.
    """

    key: str
    annotation: FrameAnnotation
    ids: tuple[str, ...]
    wh: tuple[int, int]
    evidence: Evidence
    geometry: BoxGeometry
    segmentation: SegmentationReport | None
    notes: tuple[str, ...] = ()

    @property
    def palette(self) -> str | None:
        """The tag family of the segmentation; None if there was none."""
        return None if self.segmentation is None else self.segmentation["palette"]

    @property
    def lossy(self) -> bool:
        """Whether the segmentation had lost colours."""
        return self.segmentation is not None and self.segmentation["lossy"]

    def facts(self, config: FilterConfig) -> FrameFacts:
        """The values that all decisions of this frame share."""
        names: dict[int, BoxName] = {}
        if self.evidence.channels is not None:  # which explain boxes by other boxes
            classes = [
                self.evidence.class_names[index]
                for index in self.evidence.class_index.tolist()
            ]
            names = dict(enumerate(map(BoxName, self.ids, classes)))
        return FrameFacts(self.key, config, self.palette, self.lossy, names)


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The result of the filter for one frame of N boxes, and what decided them."""

    measured: MeasuredFrame
    verdicts: Decisions
    config: FilterConfig

    def _repr_html_(self) -> str:
        """The boxes as a drawing, for notebooks; pointing at one shows its sentence."""
        width, height = self.measured.wh
        shapes = []
        for decision in self.decisions:
            if decision["xyxy"] is not None:
                x0, y0, x1, y1 = decision["xyxy"]
                blue, green, red = COLORS[decision["verdict"]]
                dash = (
                    "" if decision["verdict"] == "kept" else ' stroke-dasharray="9 8"'
                )
                words = escape(
                    f"{decision['class']} {decision['id']}, {decision['explanation']}"
                )
                shapes.append(
                    f'<rect x="{x0:g}" y="{y0:g}" width="{x1 - x0:g}" '
                    f'height="{y1 - y0:g}" fill="transparent" '
                    'stroke-width="2" vector-effect="non-scaling-stroke" '
                    f'stroke="rgb({red},{green},{blue})"{dash}><title>{words}</title>'
                    "</rect>"
                )
        return (
            f'<svg viewBox="0 0 {width} {height}" width="640" role="img" '
            f'style="background:#606060">{"".join(shapes)}</svg>'
        )

    @cached_property
    def decisions(self) -> list[Decision]:
        """One dict per box, in the order of the annotation, with the keys of the API.

        They are computed on first access, because sentences cost more time than
        `verdicts`, which has the same decisions as arrays.
        """
        measured = self.measured
        return decision_dicts(
            measured.facts(self.config),
            measured.ids,
            measured.evidence,
            self.verdicts,
            measured.geometry,
        )


def filter_frame(
    annotation: Mapping[str, object] | bytes | str | FrameAnnotation,
    segmentation: bytes | NDArray[np.uint8] | Segmentation | None,
    config: FilterConfig | None = None,
    options: FrameOptions | None = None,
) -> FrameResult:
    """Decide every box of one frame.

    Parameters
    ----------
    annotation : mapping, JSON or FrameAnnotation
        As `filter_core.annotation.parsing.parse_annotation` takes it.
    segmentation : bytes of a PNG, (H, W) uint8 tags, Segmentation, or None
        Tags are of the family that dataset, config or ``carla_version`` names. None:
        boxes that need pixels are ``unmeasured``.

    Raises
    ------
    FilterError
        The input has an error; no box is decided.

    Examples
    --------
    >>> tags = np.full((100, 200), 14, dtype=np.uint8)  # all Car
    >>> frame = {"carla_version": "0.9.15",
    ...          "boxes": [{"class": "car", "xyxy": [10, 10, 60, 40]}]}
    >>> filter_frame(frame, tags).decisions[0]["explanation"]
    'kept: 100 % of its pixels are Car, 10 % are needed'
    """
    config = config or FilterConfig()
    options = options or FrameOptions()
    measuring = config.measuring(options.dataset)
    measured = read_and_measure(annotation, segmentation, measuring, options)
    return FrameResult(measured, decide(measured.evidence, config), config)


def read_and_measure(
    annotation: Mapping[str, object] | bytes | str | FrameAnnotation,
    segmentation: bytes | NDArray[np.uint8] | Segmentation | None,
    config: MeasureConfig,
    options: FrameOptions,
) -> MeasuredFrame:
    """The evidence of one frame: read as by `filter_frame`, then `measure_frame`.

    Rectangles whose numbers are in another unit are an error (`check_units`).
    """
    if not isinstance(annotation, FrameAnnotation):
        annotation = parse_annotation(annotation, frame=options.key)
    tags = _as_segmentation(segmentation, annotation, config, options)
    wh = _agreed_size(annotation, tags, options.image_wh)
    check_units(annotation, wh, config.profile, options.key)
    return measure_frame(annotation, tags, config, options)


def measure_frame(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    config: MeasureConfig,
    options: FrameOptions,
) -> MeasuredFrame:
    """The evidence of one frame: its pixels are counted, and nothing is decided.

    Parameters
    ----------
    segmentation : Segmentation or None
        None: only what needs no segmentation is measured.
    config : MeasureConfig
        The part of a configuration that says what is measured
        (`FilterConfig.measuring`).
    options : FrameOptions
        `dataset` is not read: `config` has those options.

    Raises
    ------
    FilterError
        As `filter_frame`.
    """
    wh = _agreed_size(annotation, segmentation, options.image_wh)
    geometry = frame_boxes_2d(annotation, wh, config.projection)
    sensors = Sensors(
        segmentation=segmentation,
        camera=annotation.camera,
        lidar=annotation.sensors.get("lidar"),
        ignore=options.ignore,
        contents=options.sensors,
        pixels=options.pixels,
        max_side=options.max_side,
        tags_of_numbers=_tags_of_numbers(annotation, segmentation, config),
    )
    family = _family(annotation, sensors, config)
    boxes = _frame_boxes(annotation.boxes, geometry, config, family, wh)
    if config.min_forward is not None and annotation.camera is not None:
        forward = forward_distances(geometry.vertices, annotation.camera)
        boxes = replace(boxes, not_ahead=forward <= config.min_forward)
    evidence, notes = measure_evidence(boxes, sensors, config)
    report: SegmentationReport | None = None
    if segmentation is not None:
        report = {
            "palette": segmentation.family,
            "encoding": segmentation.encoding,
            "channel_order": segmentation.channel_order,
            "lossy": segmentation.lossy,
            "unknown_percent": segmentation.unknown_percent,
            "notes": [*segmentation.notes, *notes],
        }
    return MeasuredFrame(
        key=options.key,
        annotation=annotation,
        ids=boxes.ids,
        wh=wh,
        evidence=evidence,
        geometry=geometry,
        segmentation=report,
        notes=notes,
    )


def _agreed_size(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    image_wh: tuple[int, int] | None,
) -> tuple[int, int]:
    """Width and height, px, of the image, the segmentation and the camera alike."""
    tags_wh = (segmentation.width, segmentation.height) if segmentation else None
    sizes = {
        "the image": image_wh,
        "the segmentation": tags_wh,
        "the camera": annotation.camera_wh,
    }
    given_sizes = [(name, wh) for name, wh in sizes.items() if wh is not None]
    if not given_sizes:
        raise ImageSizeMismatch(
            "expected the size of the image from an image, a segmentation or the "
            "camera, found none of them",
            code="image_size_unknown",
        )
    first, size = given_sizes[0]
    for name, wh in given_sizes[1:]:
        if wh != size:
            raise ImageSizeMismatch(
                f"{name}: expected {size[0]} x {size[1]} px, as {first}, "
                f"found {wh[0]} x {wh[1]} px{exchanged_sides(wh, size)}",
                pointer=name.replace("the ", "/"),
            )
    return size


def _family(
    annotation: FrameAnnotation, sensors: Sensors, config: MeasureConfig
) -> str | None:
    """The tag family; instances and LiDAR have tags without a segmentation as well."""
    if sensors.segmentation is not None:
        return sensors.segmentation.family
    if not sensors.measurable_channels(config):
        return None
    reading = _reading(annotation, config)
    family = _named_family(reading)
    return None if family is None else reading.changed.target(family)


def _tags_of_numbers(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    config: MeasureConfig,
) -> NDArray[np.uint8] | None:
    """The tag of each number in instance images and LiDAR files of a changed CARLA."""
    reading = _reading(annotation, config)
    if not reading.changed.numbers:
        return None
    if segmentation is not None and segmentation.encoding == "raw":
        return segmentation.codes.tag_of_code
    family = _named_family(reading) or (segmentation and segmentation.family)
    return reading.changed.tags_of_numbers(family or NEWEST)


_UNKNOWN_RANGE = (np.nan, np.nan)


def _frame_boxes(
    boxes: Sequence[BoxAnnotation],
    geometry: BoxGeometry,
    config: MeasureConfig,
    family: str | None,
    wh: tuple[int, int],
) -> FrameBoxes:
    """The boxes of an annotation as arrays; `family` says which tags there are."""
    classes = [box_class(box) for box in boxes]
    if config.renamed:
        classes = [config.renamed.get(name, name) for name in classes]
    names = tuple(dict.fromkeys(classes))
    index = {name: number for number, name in enumerate(names)}
    class_index = np.array([index[name] for name in classes], dtype=np.int32)
    instance_ids = [
        NOT_MEASURED if box.instance_id is None else box.instance_id for box in boxes
    ]
    return FrameBoxes(
        xyxy=geometry.xyxy,
        class_names=names,
        class_index=class_index,
        accept_mask=config.accept_masks(names, family)[class_index],
        distance=geometry.distance,
        image_wh=wh,
        ids=tuple(box.id for box in boxes),
        vertices=geometry.vertices,
        instance_id=np.array(instance_ids, dtype=np.int64),
        distance_range=np.array(
            [box.distance_range or _UNKNOWN_RANGE for box in boxes], np.float64
        ).reshape(-1, 2),
        measured_as=tuple(map(config.measured_class, names)),
    )


def box_class(box: BoxAnnotation) -> str:
    """The class of a box, as `class_name_of` gives it."""
    return class_name_of(box.class_name, box.type_id, box.base_type)


def class_name_of(
    class_name: str | None, type_id: str | None, base_type: str | None
) -> str:
    """The class of a box: as given, else its blueprint's, else the blueprint itself.

    An unknown blueprint is kept as the name of an unmapped class. The parameters are
    those of `BoxAnnotation`.
    """
    if class_name is not None:
        return class_name
    return class_of(type_id, base_type) or type_id or ""


def _as_segmentation(
    segmentation: bytes | NDArray[np.uint8] | Segmentation | None,
    annotation: FrameAnnotation,
    config: MeasureConfig,
    options: FrameOptions,
) -> Segmentation | None:
    if segmentation is None or isinstance(segmentation, Segmentation):
        return segmentation
    reading = _reading(annotation, config)
    if isinstance(segmentation, bytes):
        expected = options.image_wh or annotation.camera_wh
        return read_segmentation(
            segmentation, reading, expected_wh=expected, max_side=options.max_side
        )
    family = _named_family(reading)
    if family is None:
        raise SegmentationError(
            "an array of tags cannot name its family: expected a palette in the config "
            "or a carla_version in the annotation, found neither",
            code="family_not_named",
        )
    return segmentation_from_tags(segmentation, family, reading.changed)


def _reading(annotation: FrameAnnotation, config: MeasureConfig) -> SegmentationOptions:
    """How to read a frame's segmentation; its ``carla_version`` has least priority."""
    version = config.reading.carla_version or annotation.carla_version
    return replace(config.reading, carla_version=version)


def _named_family(reading: SegmentationOptions) -> str | None:
    """The tag family that is named, by its own name or by CARLA's version."""
    if reading.palette != "auto":
        return reading.palette
    if reading.carla_version is None:
        return None
    return family_of_version(reading.carla_version)
