"""One frame through the whole filter: annotation and segmentation in, decisions out.

`filter_frame` reads, measures and decides. `measure_frame` is the half of it that reads
pixels: it gives numbers, from which any thresholds can be decided later.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filter_core.annotation.frame import (
    AnnotationLimits,
    BoxAnnotation,
    FrameAnnotation,
    frame_boxes_2d,
)
from filter_core.annotation.parsing import parse_annotation
from filter_core.classes import class_of
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.record import FrameFacts, decision_dicts
from filter_core.decisions.rules import decide
from filter_core.errors import ImageSizeMismatch, SegmentationError
from filter_core.evidence.channels import (
    FrameParts,
    SensorFiles,
    measure_frame_channels,
)
from filter_core.evidence.semantic import MeasureOptions, measure
from filter_core.geometry.projection import BoxGeometry
from filter_core.segmentation.codes import Segmentation
from filter_core.segmentation.palettes import family_of_version
from filter_core.segmentation.reading import (
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from filter_core.types import Decisions, Evidence, FrameBoxes, Mask


@dataclass(frozen=True)
class FrameOptions:
    """What is known of a frame besides its annotation and segmentation.

    Attributes
    ----------
    key : str
        The frame's name, in decisions and errors.
    image_wh : (width, height) or None, px
        Of the RGB image; else the segmentation's or the camera's size counts.
    dataset : SegmentationOptions
        How the dataset says that its segmentations are to be read. A `MeasureConfig`
        has agreed with its dataset already, and does not look at it.
    ignore : (H, W) bool or None
        Pixels that never count.
    limits : AnnotationLimits
    histogram : bool
        Count every tag in each box, which `hidden_by` and other accept sets need.
    sensors : SensorFiles
        Depth, instances and LiDAR, for the channels that read them.
    """

    key: str = ""
    image_wh: tuple[int, int] | None = None
    dataset: SegmentationOptions = field(default_factory=SegmentationOptions)
    ignore: Mask | None = None
    limits: AnnotationLimits = field(default_factory=AnnotationLimits)
    histogram: bool = True
    sensors: SensorFiles = field(default_factory=SensorFiles)


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A frame's evidence, from which any thresholds can be decided.

    Attributes
    ----------
    key : str
    annotation : FrameAnnotation
    ids : tuple of str
        Of the N boxes, in the order of the annotation.
    wh : (width, height), px
    evidence : Evidence of N boxes
    geometry : BoxGeometry of N boxes
    segmentation : dict or None
        What was recognised: ``palette``, ``encoding``, ``channel_order``, ``lossy``,
        ``unknown_percent`` and ``notes``; None if there was no segmentation.
    """

    key: str
    annotation: FrameAnnotation
    ids: tuple[str, ...]
    wh: tuple[int, int]
    evidence: Evidence
    geometry: BoxGeometry
    segmentation: dict[str, Any] | None

    def facts(self, config: FilterConfig) -> FrameFacts:
        """What the decisions of this frame have in common."""
        report = self.segmentation or {}
        return FrameFacts(
            key=self.key,
            config=config,
            family=report.get("palette"),
            lossy=bool(report.get("lossy")),
            names=self._names(),
        )

    def _names(self) -> dict[int, tuple[str, str]]:
        """Id and class by row: only channels explain a box by other boxes."""
        if self.evidence.channels is None:
            return {}
        classes, index = self.evidence.class_names, self.evidence.class_index.tolist()
        return {
            row: (box_id, classes[index[row]]) for row, box_id in enumerate(self.ids)
        }


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What the filter says of one frame.

    `decisions` has one dict per box, in the order of the annotation, with the keys of
    the API; `verdicts` are the same as arrays.
    """

    decisions: list[dict[str, Any]]
    measured: MeasuredFrame
    verdicts: Decisions


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
    config : FilterConfig, optional
    options : FrameOptions, optional

    Returns
    -------
    FrameResult

    Raises
    ------
    FilterError
        What is wrong with the input; then no box is decided.

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
    measured = read_and_measure(annotation, segmentation, config, options)
    verdicts = decide(measured.evidence, config)
    decisions = decision_dicts(
        measured.facts(config),
        measured.ids,
        measured.evidence,
        verdicts,
        measured.geometry,
    )
    return FrameResult(decisions, measured, verdicts)


def read_and_measure(
    annotation: Mapping[str, object] | bytes | str | FrameAnnotation,
    segmentation: bytes | NDArray[np.uint8] | Segmentation | None,
    config: MeasureConfig | FilterConfig,
    options: FrameOptions,
) -> MeasuredFrame:
    """The evidence of one frame in the forms that `filter_frame` takes."""
    config = _measuring(config, options.dataset)
    if not isinstance(annotation, FrameAnnotation):
        annotation = parse_annotation(
            annotation, limits=options.limits, frame=options.key
        )
    tags = _as_segmentation(segmentation, annotation, config, options)
    return measure_frame(annotation, tags, config, options)


def measure_frame(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    config: MeasureConfig | FilterConfig,
    options: FrameOptions,
) -> MeasuredFrame:
    """The evidence of one frame: pixels are read here, and nothing is decided.

    Raises
    ------
    FilterError
        As `filter_frame`.
    """
    config = _measuring(config, options.dataset)
    wh = _agreed_size(annotation, segmentation, options.image_wh)
    geometry = frame_boxes_2d(annotation, wh, config.projection)
    names = [box_class(box) for box in annotation.boxes]
    distinct = tuple(dict.fromkeys(names))
    family = _family(annotation, segmentation, config, options)
    masks = config.accept_masks(distinct, family).tolist()
    boxes = FrameBoxes.of(
        geometry.xyxy,
        names,
        dict(zip(distinct, masks, strict=True)),
        wh,
        geometry.distance,
    )
    profile: Any = config.profile  # one of two words, which the configuration checked
    evidence = measure(
        segmentation,
        boxes,
        MeasureOptions(profile=profile, histogram=options.histogram),
        ignore=options.ignore,
    )
    parts = FrameParts(annotation, segmentation, geometry, wh, options.ignore)
    channels = measure_frame_channels(parts, evidence, config, options.sensors)
    if channels is not None:
        evidence = replace(evidence, channels=channels)
    return MeasuredFrame(
        key=options.key,
        annotation=annotation,
        ids=tuple(box.id for box in annotation.boxes),
        wh=wh,
        evidence=evidence,
        geometry=geometry,
        segmentation=None if segmentation is None else _report(segmentation),
    )


def _agreed_size(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    image_wh: tuple[int, int] | None,
) -> tuple[int, int]:
    """Width and height, px, of the image, the segmentation and the camera alike.

    Raises
    ------
    ImageSizeMismatch
        Two of them differ; ``image_size_unknown``: none of them is there.
    """
    tags_wh = (segmentation.width, segmentation.height) if segmentation else None
    sizes = {
        "the image": image_wh,
        "the segmentation": tags_wh,
        "the camera": annotation.camera_wh,
    }
    known = [(name, wh) for name, wh in sizes.items() if wh is not None]
    if not known:
        raise ImageSizeMismatch(
            "expected the size of the image from an image, a segmentation or the "
            "camera, found none of them",
            code="image_size_unknown",
        )
    first, size = known[0]
    for name, wh in known[1:]:
        if wh != size:
            raise ImageSizeMismatch(
                f"{name}: expected {size[0]} x {size[1]} px, as {first}, "
                f"found {wh[0]} x {wh[1]} px",
                pointer=name.replace("the ", "/"),
            )
    return size


def box_class(box: BoxAnnotation) -> str:
    """The class of a box: as given, else its blueprint's, else the blueprint itself.

    A blueprint that nothing maps stays visible under its own name, unmapped.
    """
    if box.class_name is not None:
        return box.class_name
    return class_of(box.type_id, box.base_type) or box.type_id or ""


def _family(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    config: MeasureConfig,
    options: FrameOptions,
) -> str | None:
    """The tag family; instances and LiDAR have tags without a segmentation as well."""
    if segmentation is not None:
        return segmentation.family
    if not options.sensors.wanted(config):
        return None
    return _named_family(_reading(annotation, config))


def _as_segmentation(
    given: bytes | NDArray[np.uint8] | Segmentation | None,
    annotation: FrameAnnotation,
    config: MeasureConfig,
    options: FrameOptions,
) -> Segmentation | None:
    if given is None or isinstance(given, Segmentation):
        return given
    reading = _reading(annotation, config)
    if isinstance(given, bytes):
        expected = options.image_wh or annotation.camera_wh
        return read_segmentation(given, reading, expected_wh=expected)
    family = _named_family(reading)
    if family is None:
        raise SegmentationError(
            "an array of tags cannot name its family: expected a palette in the config "
            "or a carla_version in the annotation, found neither",
            code="family_not_named",
        )
    return segmentation_from_tags(given, family)


def _measuring(
    config: MeasureConfig | FilterConfig, dataset: SegmentationOptions
) -> MeasureConfig:
    """The part of a configuration that measures, agreed with the dataset.

    Raises
    ------
    SegmentationError
        The two contradict each other; names both.
    """
    if isinstance(config, MeasureConfig):
        return config
    layers = {
        "the dataset": dataset,
        "the config": SegmentationOptions.named_by(config),
    }
    return config.measuring(SegmentationOptions.agreed(layers))


def _reading(annotation: FrameAnnotation, config: MeasureConfig) -> SegmentationOptions:
    """How to read a frame's segmentation: its own version of CARLA counts last."""
    version = config.reading.carla_version or annotation.carla_version
    return replace(config.reading, carla_version=version)


def _named_family(reading: SegmentationOptions) -> str | None:
    """The tag family that somebody named, by its own name or by CARLA's version."""
    if reading.palette != "auto":
        return reading.palette
    if reading.carla_version is None:
        return None
    return family_of_version(reading.carla_version)


def _report(segmentation: Segmentation) -> dict[str, Any]:
    return {
        "palette": segmentation.family,
        "encoding": segmentation.encoding,
        "channel_order": segmentation.channel_order,
        "lossy": segmentation.lossy,
        "unknown_percent": segmentation.unknown_percent,
        "notes": list(segmentation.notes),
    }
