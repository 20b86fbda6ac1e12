"""`FrameBoxes`: the boxes of a frame as columns, before any pixel is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import NOT_MEASURED, BoolArray, BoxesXYXY, FloatArray, IntArray

ProjectionMode: TypeAlias = Literal["clipped", "naive"]
"""How 3D boxes become rectangles: cut exactly at the image, or as in the paper."""


@dataclass(frozen=True)
class FrameBoxes:
    """The N boxes of one frame, as given.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        Not yet corrected; may lie outside the image.
    class_names : tuple of str
        The classes that `class_index` refers to.
    class_index : (N,) int32
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t; 0: the class is not mapped.
    distance : (N,) float64, metres, NaN where unknown
    distance_range : (N, 2) float64, metres
        Between which distances a box is, the lower one excluded (except 0); NaN rows
        where unknown. Default: all NaN.
    image_wh : (width, height) of the image, px
    ids : tuple of N str
        Unique in the frame. Default: the boxes' positions.
    vertices : (N, 8, 3) float64, metres
        World corners of 3D boxes; NaN for boxes that are not 3D. Default: all NaN.
    instance_id : (N,) int64
        The object's id in an instance image, as given by the annotation;
        `NOT_MEASURED` where it is not given. Default: none given.
    not_ahead : (N,) bool
        The centre of the 3D box is nearer than the configuration's `min_forward`.
        Default: none is.
    measured_as : tuple of str
        The filter's class as which each of `class_names` is measured; a name that
        means no class stands for itself. Default: `class_names`.
    """

    xyxy: BoxesXYXY
    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    accept_mask: IntArray
    distance: FloatArray
    image_wh: tuple[int, int]
    ids: tuple[str, ...] = ()
    vertices: FloatArray = field(default_factory=lambda: np.empty((0, 8, 3)))
    instance_id: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    not_ahead: BoolArray = field(default_factory=lambda: np.empty(0, np.bool_))
    distance_range: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    measured_as: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the defaults; the broadcast arrays take no memory."""
        count = len(self)
        if not self.measured_as:
            object.__setattr__(self, "measured_as", self.class_names)
        if not self.ids:
            object.__setattr__(self, "ids", tuple(map(str, range(count))))
        if not len(self.vertices):
            no_corners = np.broadcast_to(np.nan, (count, 8, 3))
            object.__setattr__(self, "vertices", no_corners)
        if not len(self.instance_id):
            none_given = np.broadcast_to(np.int64(NOT_MEASURED), count)
            object.__setattr__(self, "instance_id", none_given)
        if not len(self.not_ahead):
            object.__setattr__(self, "not_ahead", np.broadcast_to(False, count))
        if not len(self.distance_range):
            unknown = np.broadcast_to(np.nan, (count, 2))
            object.__setattr__(self, "distance_range", unknown)

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
        """Boxes from rectangles and class names.

        Parameters
        ----------
        xyxy : (N, 4), px
        classes : sequence of N str
        accept_masks : mapping of str to int
            By class; a class that it does not have is not mapped.
        image_wh : (width, height) of the image, px
        distance : (N,), metres, optional
            Default: unknown.
        """
        names = tuple(dict.fromkeys(classes))
        index = {name: number for number, name in enumerate(names)}
        class_index = np.array([index[name] for name in classes], dtype=np.int32)
        masks = np.array([accept_masks.get(name, 0) for name in names], dtype=np.int64)
        unknown = np.full(len(classes), np.nan)
        return cls(
            xyxy=np.asarray(xyxy, dtype=np.float64).reshape(-1, 4),
            class_names=names,
            class_index=class_index,
            accept_mask=masks[class_index],
            distance=unknown if distance is None else np.asarray(distance, np.float64),
            image_wh=image_wh,
        )
