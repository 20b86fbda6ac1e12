"""CARLA's instance camera: which object each pixel belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.errors import ImageError
from filter_core.images.color_decoding import decode_color
from filter_core.images.header import MAX_SIDE, read_image_header, require_size
from filter_core.types import UNKNOWN_COLUMN, BoolArray, FloatArray, IntArray

ID_BITS: Final = 0xFFFF
"""Of an id: Unreal's up to CARLA 0.9.15, since then the actor's if there is one."""

_HIGHEST_TAG: Final = 29


@dataclass(frozen=True, eq=False)
class InstanceImage:
    """An instance image.

    Attributes
    ----------
    tags : (H, W) uint8
    ids : (H, W) uint16
        Green + 256 blue.
    swapped : bool
        It was saved with red and blue exchanged, and has been put right.
    """

    tags: NDArray[np.uint8]
    ids: NDArray[np.uint16]
    swapped: bool = False

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.tags.shape[1], self.tags.shape[0]


@dataclass(frozen=True, eq=False)
class InstancePixels:
    """The pixels of all instances that some box could accept, grouped by instance.

    Attributes
    ----------
    ids : (K,) int64, ascending
    start : (K + 1,) int64
        Instance k has pixels ``start[k] .. start[k + 1] - 1`` of the others.
    columns, rows : (P,) int64, px
    tags : (P,) uint8
    """

    ids: IntArray
    start: IntArray
    columns: IntArray
    rows: IntArray
    tags: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.ids)

    def rectangles(self) -> FloatArray:
        """(K, 4) float64, px: around each instance."""
        first = self.start[:-1]
        if not len(self):
            return np.empty((0, 4))
        reduced = [
            np.minimum.reduceat(self.columns, first),
            np.minimum.reduceat(self.rows, first),
            np.maximum.reduceat(self.columns, first) + 1,
            np.maximum.reduceat(self.rows, first) + 1,
        ]
        return np.stack(reduced, axis=1).astype(np.float64)

    def accepted(self, instance: int, accept_mask: int) -> tuple[int, FloatArray]:
        """How many pixels of an instance have an accepted tag, and around them xyxy."""
        part = slice(self.start[instance], self.start[instance + 1])
        wanted = (accept_mask >> self.tags[part].astype(np.int64) & 1).astype(np.bool_)
        if not wanted.any():
            return 0, np.full(4, np.nan)
        x, y = self.columns[part][wanted], self.rows[part][wanted]
        around = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1], np.float64)
        return int(wanted.sum()), around


def read_instances(
    content: bytes,
    *,
    expected_wh: tuple[int, int] | None = None,
    max_side: int = MAX_SIDE,
) -> InstanceImage:
    """Read an instance image of CARLA.

    Parameters
    ----------
    content : bytes of a PNG, RGB or RGBA
        Red is the tag, green and blue are 16 bits of an id [1]_.
    expected_wh : (width, height), px
    max_side : int, px

    Raises
    ------
    ImageError
        ``lossy_instances``: a JPEG; ``bad_instances``: not RGB(A) of 8 bits, or neither
        red nor blue holds tags; and what `read_image_header` raises.

    Notes
    -----
    Images that were saved with red and blue exchanged are common: no tag is above 29,
    while the high byte of an id, seen as a tag, soon is.

    References
    ----------
    .. [1] CARLA documentation, "Sensors reference", instance segmentation camera.
    """
    header = read_image_header(content, max_side=max_side)
    if expected_wh is not None:
        require_size(header, expected_wh, what="the instance image", than="the image")
    if header.media_type != "image/png":
        raise _fault("a PNG", "a JPEG, whose losses change ids", "lossy_instances")
    if header.color_model not in ("rgb", "rgba") or header.bit_depth != 8:
        found = f"{header.color_model} with {header.bit_depth} bits"
        raise _fault("RGB or RGBA with 8 bits", found)
    pixels = decode_color(content, header, "bgr")
    if pixels is None:
        raise ImageError("the instance image cannot be decoded: it is damaged")
    blue, green, red = cv2.split(pixels)
    swapped = False
    if int(red.max(initial=0)) > _HIGHEST_TAG:
        if int(blue.max(initial=0)) > _HIGHEST_TAG:
            found = f"values up to {red.max()} in red and {blue.max()} in blue"
            raise _fault(f"tags of 0 to {_HIGHEST_TAG} in red", found)
        red, blue, swapped = blue, red, True
    ids = cv2.merge([green, blue]).view("<u2")[..., 0]
    return InstanceImage(np.asarray(red, np.uint8), ids.astype(np.uint16), swapped)


def _fault(expected: str, found: str, code: str = "bad_instances") -> ImageError:
    return ImageError(
        f"the instance image: expected {expected}, found {found}",
        pointer="/instances",
        code=code,
    )


def group_pixels(image: InstanceImage, accept_mask: Sequence[int]) -> InstancePixels:
    """The pixels whose tag some box accepts, grouped by instance."""
    accepted = _accepted_by_any(accept_mask)[image.tags]
    rows, columns = np.nonzero(accepted)
    ids = image.ids[rows, columns]
    order = np.argsort(ids, kind="stable")
    sorted_ids = ids[order]
    begins = np.flatnonzero(np.diff(sorted_ids, prepend=-1) != 0)
    return InstancePixels(
        ids=sorted_ids[begins].astype(np.int64),
        start=np.append(begins, len(order)),
        columns=columns[order],
        rows=rows[order],
        tags=image.tags[rows, columns][order],
    )


def _accepted_by_any(accept_mask: Sequence[int]) -> BoolArray:
    together = 0
    for mask in accept_mask:
        together |= int(mask)
    table = np.zeros(256, np.bool_)
    table[:UNKNOWN_COLUMN] = [together >> tag & 1 for tag in range(UNKNOWN_COLUMN)]
    return table
