"""Makes `Evidence` of a few boxes, with defaults for all values that are not given."""

from dataclasses import replace
from typing import Any

import numpy as np

from filter_core.evidence_numbers import Evidence, number_columns

ACCEPTS_CAR = 1 << 14
NO_RECTANGLE = [np.nan] * 4


def absent_evidence(class_names: tuple[str, ...], class_index: np.ndarray) -> Evidence:
    """Evidence of boxes of these classes, for which nothing was measured."""
    columns: dict[str, Any] = {
        name: np.full((len(class_index), *column.shape), column.missing, column.dtype)
        for name, column in number_columns(Evidence).items()
    }
    return Evidence(class_names=class_names, class_index=class_index, **columns)


def evidence_of(boxes, class_names=("car",)):
    """Evidence of boxes, each a dict of the values that differ from the defaults."""

    def column(name, default, dtype):
        return np.array([box.get(name, default) for box in boxes], dtype=dtype)

    has_xyxy = any("xyxy" in box for box in boxes)
    pixels = column("box_pixels", 1000, np.int64)
    percent = column("match_percent", 50.0, np.float64)
    matched = np.nan_to_num(percent * pixels / 100).astype(np.int64)
    counts = [box.get("matched_pixels") for box in boxes]
    return replace(
        absent_evidence(tuple(class_names), column("class_index", 0, np.int32)),
        state=column("state", 0, np.uint8),
        accept_mask=column("accept_mask", ACCEPTS_CAR, np.int64),
        measured=column("measured", True, np.bool_),
        box_pixels=pixels,
        matched_pixels=np.array(
            [m if g is None else g for m, g in zip(matched, counts, strict=True)],
            dtype=np.int64,
        ).reshape(-1),
        image_pixels=np.full(len(boxes), 1_000_000, dtype=np.int64),
        unknown_pixels=column("unknown_pixels", 0, np.int64),
        match_percent=percent,
        area_percent=column("area_percent", 1.0, np.float64),
        crowding=column("crowding", 0.0, np.float64),
        distance=column("distance", np.nan, np.float64),
        xyxy=column("xyxy", NO_RECTANGLE, np.float64) if has_xyxy else None,
    )
