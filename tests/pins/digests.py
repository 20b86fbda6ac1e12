"""Pins of digests in the database: of configurations and of what is measured by."""

from collections.abc import Mapping
from typing import Any, Final

from filter_core import FilterConfig

_CARS_AND_VANS: Final = {
    "car": {"accept": ["Car", "Truck"]},
    "walker": {"accept": [12, "Rider"], "threshold_small_box": 2.5},
}
CONFIGS: Final[dict[str, dict[str, Any]]] = {
    "default": {},
    "thresholds": {
        "threshold_small_box": 8,
        "size_big_box": 55.5,
        "threshold_big_box": 40.0,
        "min_visible_pixels": 12,
        "min_distance": 2,
        "max_distance": 80.5,
    },
    "classes": {
        "classes": {
            "vehicle.bicycle": {"min_visible_pixels": 3},
            "traffic light": {"threshold_small_box": 2, "max_distance": None},
            **_CARS_AND_VANS,
        }
    },
    "channels": {
        "evidence": "auto",
        "depth_tolerance": 0.25,
        "ordered_min_pixels": 4,
        "lidar_min_points": 7,
    },
    "reading": {
        "palette": "carla-0.9.10",
        "encoding": "raw",
        "channel_order": "bgr",
        "lossy_segmentation": "nearest",
    },
    "carlasimu": {"profile": "carlasimu", "projection": "naive"},
    "letters": {"classes": {"Straßenbahn": {"accept": [19]}}},
}
_IGNORED: Final = [{"polygon": [[0, 0], [96, 0], [96, 8], [0, 8]]}]
PLANS: Final[dict[str, dict[str, Any]]] = {
    "default": {},
    "accept sets": {"config": {"classes": _CARS_AND_VANS}},
    "carlasimu with accept sets": {
        "config": {"profile": "carlasimu", "classes": _CARS_AND_VANS}
    },
    "another palette and projection, ignored pixels": {
        "config": {"palette": "carla-0.9.0", "projection": "naive"},
        "ignored": _IGNORED,
    },
    "depth, instances, lidar and order": {
        "config": {"evidence": "ordered", "depth_tolerance": 0.5},
        "channels": ["lidar", "instance", "depth", "ordered"],
    },
    "as the configuration decides": {"config": {"evidence": "auto"}},
    "words of dataset and configuration agreed": {
        "config": {"palette": "paper-table1", "lossy_segmentation": "nearest"},
        "dataset": {
            "palette": "paper-table1",
            "encoding": "palette",
            "channel_order": "bgr",
        },
    },
}


def found() -> dict[str, Any]:
    return {
        "configurations": {
            name: {"digest": config.digest, "as_dict": config.as_dict()}
            for name, mapping in CONFIGS.items()
            for config in [FilterConfig.from_mapping(mapping)]
        },
        "plans": {name: _plan(**plan) for name, plan in PLANS.items()},
    }


def _plan(
    config: Mapping[str, Any] | None = None,
    dataset: Mapping[str, Any] | None = None,
    ignored: Any = None,
    channels: list[str] | None = None,
) -> dict[str, Any]:
    """What the database stores of a plan; only this function uses the plan's classes.

    `config` has keys of a configuration, `dataset` settings of how the dataset's
    segmentations are read, and `ignored` its mask of polygons. `channels` names those
    that are measured in addition to the ones that the configuration decides by.
    """
    from app.measuring.plan import DatasetReading, plan_for

    reading = DatasetReading("street", ignore_mask=ignored, **(dataset or {}))
    plan = plan_for(reading, FilterConfig.from_mapping(config or {}))
    if channels:
        plan = plan.with_channels(channels)
    return {
        "digest": plan.digest,
        "pixel_digest": plan.pixel_digest,
        "as_dict": plan.as_dict(),
        "files": list(plan.files),
    }
