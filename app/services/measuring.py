"""Measuring the frames of one dataset under one configuration."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from app.db.evidence_record import (
    Geometry,
    pack_channels,
    pack_geometry,
    pack_numbers,
    pack_tag_counts,
)
from app.db.tables import Dataset, Measurement
from app.engine.pixels import PixelPool
from app.metrics import DECODE_SECONDS, MEASURE_SECONDS
from app.services.pixel_work import FrameFiles, is_simple, measure
from filter_core.annotation.frame import FrameAnnotation
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.geometry.projection import BoxGeometry
from filter_core.pipeline import MeasuredFrame
from filter_core.segmentation.reading import (
    Encoding,
    Lossy,
    OrderOfChannels,
    SegmentationOptions,
)


@dataclass(frozen=True)
class DatasetReading:
    """What a dataset says about its segmentations."""

    name: str
    palette: str = "auto"
    encoding: Encoding = "auto"
    channel_order: OrderOfChannels = "auto"
    lossy_segmentation: Lossy = "refuse"
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


def plan_for(dataset: DatasetReading, config: FilterConfig) -> MeasureConfig:
    """What the dataset and the configuration say together; they must agree."""
    return config.measuring(
        SegmentationOptions.named_by(dataset),
        dataset_name=f"dataset {dataset.name!r}",
        ignored=dataset.ignore_mask,
    )


def plan_of(measurement: Measurement, config: FilterConfig) -> MeasureConfig:
    """What a measurement was made by."""
    return config.measuring().as_measured(measurement.options)


def measure_files(
    pool: PixelPool,
    plan: MeasureConfig,
    annotation: FrameAnnotation,
    files: FrameFiles,
    given_up: threading.Event | None = None,
) -> MeasuredFrame:
    """Decode, project and measure one frame.

    In a child process that is waited for, unless what it costs is known to be little.

    Raises
    ------
    FilterError
        Whatever is wrong with the frame; `app.engine.pixels.PixelsRefused` if it needs
        more time or memory than a frame may.
    app.engine.pixels.GivenUp
        `given_up` was set before the child was done.
    """
    # Only what is read there travels: not what came along, to be given back by exports.
    needed = replace(annotation, raw={}, extra={}, weather={})
    work = measure, plan, needed, files
    if is_simple(plan, needed, files):
        measured, decode_s, measure_s = pool.run_here(*work)
    else:
        measured, decode_s, measure_s = pool.run(*work, given_up=given_up)
    if decode_s is not None:
        DECODE_SECONDS.observe(decode_s)
    MEASURE_SECONDS.observe(measure_s)
    return replace(measured, annotation=annotation)


def packed(measured: MeasuredFrame, class_ids: Sequence[int]) -> dict[str, Any]:
    """The columns of an evidence row."""
    return {
        "numbers": pack_numbers(measured.evidence, class_ids),
        "tag_counts": pack_tag_counts(measured.evidence.tag_counts),
        "geometry": pack_geometry(_geometry(measured.geometry)),
        "channels": pack_channels(measured.evidence.channels),
        "segmentation": measured.segmentation,
        "lossy": measured.lossy,
    }


def _geometry(found: BoxGeometry) -> list[Geometry | None]:
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
