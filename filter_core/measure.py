"""Measure what a segmentation shows inside each box. No thresholds and no verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.palettes import RGB
from filter_core.types import BoxesXYXY, FloatArray, IntArray

Profile: TypeAlias = Literal["paper", "carlasimu"]

PUBLISHED_COLORS: Final[Mapping[str, RGB]] = MappingProxyType(
    {
        "car": (0, 0, 142),
        "truck": (0, 0, 142),
        "bus": (0, 60, 100),
        "van": (0, 0, 70),
        "bicycle": (119, 11, 32),
        "motorcycle": (0, 0, 230),
        "walker": (220, 20, 60),
        "traffic_light": (250, 170, 30),
        "street_light": (250, 170, 30),
    }
)
"""The one colour per class that the paper's published code counts."""


@dataclass(frozen=True)
class FrameBoxes:
    """The boxes of one frame, as given.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        Not yet corrected; may lie outside the image.
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t; 0: the class is not mapped.
    distance : (N,) float64, metres, NaN where unknown
    image_wh : (width, height) of the image, px
    """

    xyxy: BoxesXYXY
    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    accept_mask: IntArray
    distance: FloatArray
    image_wh: tuple[int, int]

    def __len__(self) -> int:
        return len(self.class_index)

    @classmethod
    def of(
        cls,
        xyxy: BoxesXYXY | Sequence[Sequence[float]],
        classes: Sequence[str],
        accept_masks: Mapping[str, int],
        image_wh: tuple[int, int],
        distance: Sequence[float] | FloatArray | None = None,
    ) -> FrameBoxes:
        """Boxes from a class name per box and one accept mask per class.

        A class that `accept_masks` does not have is not mapped.
        """
        names = tuple(dict.fromkeys(classes))
        index = {name: number for number, name in enumerate(names)}
        unknown = np.full(len(classes), np.nan)
        return cls(
            xyxy=np.asarray(xyxy, dtype=np.float64).reshape(-1, 4),
            class_names=names,
            class_index=np.array([index[name] for name in classes], dtype=np.int32),
            accept_mask=np.array(
                [accept_masks.get(name, 0) for name in classes], dtype=np.int64
            ),
            distance=unknown if distance is None else np.asarray(distance, np.float64),
            image_wh=image_wh,
        )


@dataclass(frozen=True)
class MeasureOptions:
    """What changes the numbers, apart from how the segmentation is read.

    Attributes
    ----------
    profile : ``paper`` or ``carlasimu``
    histogram : bool
        Count every tag in each box. Without it only the accepted tags are counted,
        which is several times faster, and `Evidence.tag_counts` is None.
    class_colors : Mapping
        Profile ``carlasimu``: the one colour that counts, by class name.
    """

    profile: Profile = "paper"
    histogram: bool = True
    class_colors: Mapping[str, RGB] = field(default_factory=lambda: PUBLISHED_COLORS)
