"""The pixels of each box that carry a tag its class accepts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from filter_core.evidence.silhouettes import Silhouette
from filter_core.segmentation.pixel_codes import PixelCodes
from filter_core.types import UNKNOWN_COLUMN, BoolArray, IntArray, Mask


@dataclass(frozen=True, eq=False)
class AcceptedPixels:
    """Of one box: its silhouette, and which pixels of its region are accepted in it.

    Attributes
    ----------
    silhouette : Silhouette
    mask : (h, w) bool
        Accepted, and inside the silhouette.
    around : (h, w) bool, or None
        Accepted, inside the silhouette or beside it; None: as `mask`.
    """

    silhouette: Silhouette
    mask: Mask
    around: Mask | None = None

    @cached_property
    def count(self) -> int:
        """How many there are, px."""
        return int(np.count_nonzero(self.mask))

    @cached_property
    def own(self) -> Mask:
        """Those that the box itself can be seen in.

        Their centres lie within its outline; of a box too thin for that, all.
        """
        if self.silhouette.centred is None:
            return self.mask
        centred = self.mask & self.silhouette.centred
        return centred if centred.any() else self.mask


def accepted_pixels(
    outlines: Sequence[Silhouette],
    codes: PixelCodes,
    accept_mask: IntArray,
    ignore: Mask | None = None,
) -> list[AcceptedPixels]:
    """For each silhouette, its pixels of an accepted tag.

    Parameters
    ----------
    outlines : as `filter_core.channels.silhouettes.silhouettes` gives them
    codes : PixelCodes of the segmentation
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t.
    ignore : (H, W) bool, optional
        True: the pixel never counts.
    """
    tables = {
        mask: accepted_codes(codes.tag_of_code, mask)
        for mask in np.unique(accept_mask).tolist()
    }
    found = []
    for outline in outlines:
        table = tables[int(accept_mask[outline.row])]
        box = outline.x0, outline.y0, outline.x1, outline.y1
        around = table[codes.crop(*box)]
        if ignore is not None:
            around = around & ~ignore[outline.region]
        found.append(AcceptedPixels(outline, outline.of(around), around))
    return found


def accepted_codes(tag_of_code: NDArray[np.uint8], accept_mask: int) -> BoolArray:
    """(K,) bool: which codes mean an accepted tag; nobody accepts Unknown."""
    tags = np.minimum(tag_of_code, UNKNOWN_COLUMN).astype(np.int64)
    known = accept_mask & ((1 << UNKNOWN_COLUMN) - 1)
    return (known >> tags & 1).astype(np.bool_)
