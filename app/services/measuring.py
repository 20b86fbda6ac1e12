"""Measuring the frames of one dataset under one configuration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Final

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
from app.services import pixel_work
from app.services.pixel_work import SENSORS, FrameFiles, MeasureRequest
from filter_core.annotation.frame import FrameAnnotation
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import CHANNELS, FILE_OF
from filter_core.geometry.projection import BoxGeometry
from filter_core.pipeline import MeasuredFrame
from filter_core.segmentation.reading import SegmentationOptions

_READING: Final = ("palette", "encoding", "channel_order", "lossy")
CHANNELS_KEY: Final = "channels"


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
class ChannelPlan:
    """What is measured beside the segmentation: names out of `CHANNELS`, in order."""

    names: tuple[str, ...] = ()
    depth_tolerance: float | None = None

    @classmethod
    def of(cls, config: FilterConfig) -> ChannelPlan:
        """What a configuration decides by."""
        return cls.measuring(config.channels, config)

    @classmethod
    def measuring(cls, asked: Collection[str], config: FilterConfig) -> ChannelPlan:
        """Some channels, in their order."""
        names = tuple(name for name in CHANNELS if name in asked)
        return cls(names, float(config.depth_tolerance) if "depth" in names else None)

    @classmethod
    def from_dict(cls, options: Mapping[str, Any]) -> ChannelPlan:
        """Inverse of `as_dict`; of measurements without channels, too."""
        stored = options.get(CHANNELS_KEY) or {}
        return cls(tuple(stored.get("names", ())), stored.get("depth_tolerance"))

    def as_dict(self) -> dict[str, Any]:
        """Empty without channels, as measurements were before there were any."""
        if not self.names:
            return {}
        stored = {"names": list(self.names), "depth_tolerance": self.depth_tolerance}
        return {CHANNELS_KEY: stored}

    def is_part_of(self, other: ChannelPlan) -> bool:
        """Whether the other one has the same numbers of all these channels."""
        return set(self.names) <= set(other.names) and (
            self.depth_tolerance in (None, other.depth_tolerance)
        )


@dataclass(frozen=True)
class MeasurePlan:
    """Everything that measured numbers depend on, apart from the frame itself."""

    config: FilterConfig
    reading: SegmentationOptions
    ignored: Any | None
    channels: ChannelPlan = field(default_factory=ChannelPlan)

    @property
    def pixel_digest(self) -> str:
        """Plans of equal pixel digests differ at most in accept sets."""
        plan = self.as_dict()
        # Channels keep no histogram: other accept sets are other pixels to them.
        return _digest(plan if self.channels.names else plan | {"accept": None})

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
        plan = {
            "measure": list(self.config.measure_key()),
            "accept": overrides,
            "reading": reading,
            "ignored": self.ignored,
        }
        return plan | self.channels.as_dict()

    def with_channels(self, names: Collection[str]) -> MeasurePlan:
        """A plan that measures these channels as well."""
        wanted = {*self.channels.names, *names}
        return replace(self, channels=ChannelPlan.measuring(wanted, self.config))

    @cached_property
    def request(self) -> MeasureRequest:
        """What is needed of it where pixels are measured."""
        return MeasureRequest(
            self.config,
            self.reading,
            self.ignored,
            self.channels.names,
            self.channels.depth_tolerance,
        )

    @property
    def files(self) -> tuple[str, ...]:
        """The kinds of files that its channels read."""
        kinds = {FILE_OF.get(name) for name in self.channels.names}
        return tuple(kind for kind in SENSORS if kind in kinds)

    def is_covered_by(self, options: Mapping[str, Any]) -> bool:
        """Whether a measurement has all these numbers, and perhaps more channels'."""
        have = ChannelPlan.from_dict(options)
        if not self.channels.is_part_of(have):
            return False
        return all(
            options[key] == value
            for key, value in self.as_dict().items()
            if key != CHANNELS_KEY
        )


def _digest(plan: dict[str, Any]) -> str:
    text = json.dumps(plan, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def plan_for(dataset: DatasetReading, config: FilterConfig) -> MeasurePlan:
    """What the dataset and the configuration say together; they must agree."""
    layers = {
        f"dataset {dataset.name!r}": SegmentationOptions.named_by(dataset),
        "the configuration": SegmentationOptions.named_by(config),
    }
    reading = SegmentationOptions.agreed(layers)
    return MeasurePlan(config, reading, dataset.ignore_mask, ChannelPlan.of(config))


def plan_of(measurement: Measurement, config: FilterConfig) -> MeasurePlan:
    """The plan that a measurement was made by."""
    options = measurement.options
    reading = SegmentationOptions(**options["reading"], sources=options["sources"])
    channels = ChannelPlan.from_dict(options)
    return MeasurePlan(config, reading, options["ignored"], channels)


def measure_files(
    pool: PixelPool, plan: MeasurePlan, annotation: FrameAnnotation, files: FrameFiles
) -> MeasuredFrame:
    """Decode, project and measure one frame.

    In a child process that is waited for, unless what it costs is known to be little.

    Raises
    ------
    FilterError
        Whatever is wrong with the frame; `app.engine.pixels.PixelsRefused` if it needs
        more time or memory than a frame may.
    """
    # Only what is read there travels: not what came along, to be given back by exports.
    needed = replace(annotation, raw={}, extra={}, weather={})
    is_simple = pixel_work.is_simple(plan.request, needed, files)
    measured, decode_s, measure_s = (pool.run_here if is_simple else pool.run)(
        pixel_work.measure, plan.request, needed, files
    )
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
        "lossy": bool((measured.segmentation or {}).get("lossy")),
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
