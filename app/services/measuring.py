"""Measuring the frames of one dataset under one configuration."""

from __future__ import annotations

import hashlib
import json
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, cast

import numpy as np

from app.db.evidence_record import (
    Geometry,
    pack_geometry,
    pack_numbers,
    pack_tag_counts,
)
from app.db.tables import Dataset, Measurement
from app.services.refusals import naming
from filter_core.annotation_types import FrameAnnotation
from filter_core.config import FilterConfig
from filter_core.decision_record import FrameGeometry
from filter_core.frame_filter import FrameOptions, MeasuredFrame, measure_frame
from filter_core.ignore_mask import read_ignore_mask
from filter_core.image_header import MAX_SIDE
from filter_core.segmentation import SegmentationOptions, read_segmentation
from filter_core.types import Mask

_READING: Final = ("palette", "encoding", "channel_order", "lossy")


@dataclass(frozen=True)
class DatasetReading:
    """What a dataset says about its segmentations."""

    name: str
    palette: str = "auto"
    encoding: str = "auto"
    channel_order: str = "auto"
    lossy_segmentation: str = "refuse"
    ignore_mask: Any | None = None

    @classmethod
    def of(cls, dataset: Dataset) -> DatasetReading:
        """As the dataset says now."""
        return cls(**{spec.name: getattr(dataset, spec.name) for spec in fields(cls)})

    def as_columns(self) -> dict[str, Any]:
        """Everything but the name, as columns of the dataset's row."""
        columns = asdict(self)
        del columns["name"]
        return columns


@dataclass(frozen=True)
class MeasurePlan:
    """Everything that measured numbers depend on, apart from the frame itself."""

    config: FilterConfig
    reading: SegmentationOptions
    ignored: Any | None

    @property
    def pixel_digest(self) -> str:
        """Plans of equal pixel digests differ at most in accept sets."""
        return _digest(self.as_dict() | {"accept": None})

    @property
    def digest(self) -> str:
        """Equal plans measure equal numbers."""
        return _digest(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """The plan in canonical form, ready for JSON."""
        overrides = {
            name: one.as_dict()["accept"]
            for name, one in self.config.classes.items()
            if "accept" in one.as_dict()
        }
        reading = {name: getattr(self.reading, name) for name in _READING}
        return {
            "measure": list(self.config.measure_key()),
            "accept": overrides,
            "reading": reading,
            "ignored": self.ignored,
        }


def _digest(plan: dict[str, Any]) -> str:
    text = json.dumps(plan, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class FrameFiles:
    """The bytes of a frame that are measured."""

    segmentation: bytes | None
    image_wh: tuple[int, int]
    ignore_mask: bytes | None = None
    max_side_px: int = MAX_SIDE


def plan_for(dataset: DatasetReading, config: FilterConfig) -> MeasurePlan:
    """What the dataset and the configuration say together; they must agree."""
    layers = {
        f"dataset {dataset.name!r}": _options(dataset),
        "the configuration": _options(config),
    }
    return MeasurePlan(config, SegmentationOptions.agreed(layers), dataset.ignore_mask)


def plan_of(measurement: Measurement, config: FilterConfig) -> MeasurePlan:
    """The plan that a measurement was made by."""
    options = measurement.options
    reading = SegmentationOptions(**options["reading"], sources=options["sources"])
    return MeasurePlan(config, reading, options["ignored"])


def _options(source: DatasetReading | FilterConfig) -> SegmentationOptions:
    return SegmentationOptions(
        palette=source.palette,
        encoding=cast("Any", source.encoding),
        channel_order=cast("Any", source.channel_order),
        lossy=cast("Any", source.lossy_segmentation),
    )


def measure_files(
    plan: MeasurePlan, annotation: FrameAnnotation, files: FrameFiles
) -> MeasuredFrame:
    """Decode, project and measure one frame.

    Raises
    ------
    FilterError
        Whatever is wrong with the frame, naming it.
    """
    segmentation = None
    if files.segmentation is not None:
        segmentation = read_segmentation(
            files.segmentation,
            replace(plan.reading, carla_version=annotation.carla_version),
            expected_wh=files.image_wh,
            max_side=files.max_side_px,
        )
    options = FrameOptions(image_wh=files.image_wh, ignore=_ignore(plan, files))
    return measure_frame(annotation, segmentation, plan.config, options)


def packed(measured: MeasuredFrame, class_ids: Sequence[int]) -> dict[str, Any]:
    """The columns of an evidence row."""
    return {
        "numbers": pack_numbers(measured.evidence, class_ids),
        "tag_counts": pack_tag_counts(measured.evidence.tag_counts),
        "geometry": pack_geometry(_geometry(measured.geometry)),
        "segmentation": measured.segmentation,
        "lossy": bool((measured.segmentation or {}).get("lossy")),
    }


def _ignore(plan: MeasurePlan, files: FrameFiles) -> Mask | None:
    sources: list[Any] = [] if files.ignore_mask is None else [files.ignore_mask]
    if plan.ignored is not None:
        picture = plan.ignored.get("png")
        sources.append(b64decode(picture) if picture else plan.ignored["polygons"])
    if not sources:
        return None
    with naming(pointer="/ignore_mask"):
        masks = [read_ignore_mask(source, files.image_wh) for source in sources]
    joined: Mask = np.logical_or.reduce(masks)
    return joined


def _geometry(found: FrameGeometry) -> list[Geometry | None]:
    return [
        None
        if edges is None
        else Geometry(
            _row(found.amodal_xyxy[row]),
            _row(found.visible_xyxy[row]),
            edges.astype(np.float32),
        )
        for row, edges in enumerate(found.edges)
    ]


def _row(values: Any) -> tuple[float, ...] | None:  # noqa: ANN401  # a row of an array
    return None if np.isnan(values[0]) else tuple(values.tolist())
