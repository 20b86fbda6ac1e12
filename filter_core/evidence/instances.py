"""CARLA's instance image as evidence: which object each pixel belongs to.

`read_instances` reads the image, and `settled_instances` asks the boxes for the order
of its channels where nothing else tells it. `fill_instances` assigns instances to
boxes, one to one and with the best total fit, and counts the pixels of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import NOT_MEASURED, UNKNOWN_TAG, FloatArray, IntArray
from filter_core.classes import accepts
from filter_core.errors import ImageError, file_context
from filter_core.evidence.silhouettes import Silhouette
from filter_core.evidence_numbers import ChannelNumbers
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.boxes import pairwise_iou
from filter_core.images.decoding import decode_color
from filter_core.images.header import (
    MAX_SIDE,
    header_of,
    require_size,
)
from filter_core.images.pixels import ChannelOrder, sampled
from filter_core.segmentation.codes import Segmentation
from filter_core.segmentation.palettes import LAST_TAG

ID_BITS: Final = 0xFFFF
"""The image holds 16 bits of each id.

Up to CARLA 0.9.15 the ids are Unreal's; since then the actor's, if there is an actor.
"""


@dataclass(frozen=True, eq=False)
class InstanceImage:
    """An instance image.

    Attributes
    ----------
    tags : (H, W) uint8
    ids : (H, W) uint16
        Green + 256 blue.
    order : ``rgb`` or ``bgr``
        Of the channels in the file.
    is_certain : bool
        Whether the channels' values tell their order; else the boxes have to.
    """

    tags: NDArray[np.uint8]
    ids: NDArray[np.uint16]
    order: ChannelOrder = "rgb"
    is_certain: bool = True

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about the reading."""
        swapped = "red and blue are swapped in the instance image; read as bgr"
        return (swapped,) if self.order == "bgr" else ()


def read_instances(
    content: bytes | NDArray[np.uint8],
    segmentation: Segmentation | None = None,
    *,
    expected_wh: tuple[int, int] | None = None,
    max_side: int = MAX_SIDE,
    tags_of_numbers: NDArray[np.uint8] | None = None,
) -> InstanceImage:
    """Read an instance image of CARLA.

    Parameters
    ----------
    content : bytes of a PNG, RGB or RGBA, or (H, W, 3) uint8: blue, green, red
        Red is the tag, green and blue are 16 bits of an id [1]_.
    segmentation : Segmentation of the same frame, optional
    expected_wh : (width, height), px
    max_side : int, px
    tags_of_numbers : (256,) uint8, optional
        The tag of each number of a changed CARLA, 255 if none; default: itself.

    Raises
    ------
    ImageError
        ``lossy_instances``: a JPEG; ``bad_instances``: not RGB(A) of 8 bits, or neither
        red nor blue holds tags, or not those of the segmentation; and what
        `read_image_header` raises.

    Notes
    -----
    Images that were saved with red and blue exchanged are common. Tags are where most
    pixels agree with the segmentation. Without one, they are in the channel that alone
    has values of 1 to 29, the largest tag; if both have, the boxes tell
    (`settled_instances`).

    References
    ----------
    .. [1] CARLA documentation, "Sensors reference", instance segmentation camera.
    """
    with file_context("instances"):
        header = header_of(content, max_side)
    if expected_wh is not None:
        require_size(header, expected_wh, what="the instance image", than="the image")
    if header.media_type != "image/png":
        raise _fault("a PNG", "a JPEG, whose losses change ids", "lossy_instances")
    if header.color_model not in ("rgb", "rgba") or header.bit_depth != 8:
        pixel_format = f"{header.color_model} with {header.bit_depth} bits"
        raise _fault("RGB or RGBA with 8 bits", pixel_format)
    with file_context("instances"):
        pixels = (
            content
            if isinstance(content, np.ndarray)
            else decode_color(content, header, "bgr")
        )
    if pixels is None:
        raise ImageError("the instance image cannot be decoded: it is damaged")
    table = _TAGS if tags_of_numbers is None else tags_of_numbers
    orders = _orders_of_tags(pixels, segmentation, table)
    order = orders[0]
    blue, green, red = cv2.split(pixels)
    if order == "bgr":
        red, blue = blue, red
    ids = cv2.merge([green, blue]).view("<u2")[..., 0]
    return InstanceImage(
        np.asarray(red, np.uint8), ids.astype(np.uint16), order, len(orders) == 1
    )


_LEAST_AGREEMENT: Final = 0.5
"""Tags of both cameras agree nearly everywhere, other images nearly nowhere."""

_FEWEST_TAGS: Final = 64
"""If fewer pixels of a sample have a tag other than 0, all pixels are compared."""


def _orders_of_tags(
    bgr: NDArray[np.uint8], segmentation: Segmentation | None, table: NDArray[np.uint8]
) -> list[ChannelOrder]:
    """The orders of channels that an instance image can have, the likelier first.

    `table` has the tag of each number.
    """
    channels: dict[ChannelOrder, int] = {"rgb": _RED, "bgr": _BLUE}
    tags, values = np.empty(0, np.uint8), bgr
    if segmentation is not None:
        tags, values = segmentation.sampled_tags, sampled(bgr)
        if np.count_nonzero(tags) < _FEWEST_TAGS:
            tags, values = segmentation.tags, bgr
    if not tags.any():
        highest = {
            order: int(cv2.minMaxLoc(cv2.extractChannel(bgr, channel))[1])
            for order, channel in channels.items()
        }
        last = int(np.flatnonzero(table <= LAST_TAG)[-1])
        orders = [order for order in channels if 0 < highest[order] <= last]
        if not orders:
            text = f"values up to {highest['rgb']} in red and {highest['bgr']} in blue"
            raise _fault(f"tags of 1 to {last} in red", text)
        return orders
    is_tagged = (tags > 0) & (tags < UNKNOWN_TAG)
    agreeing = {
        order: int(np.count_nonzero((table[values[..., channel]] == tags) & is_tagged))
        for order, channel in channels.items()
    }
    best: ChannelOrder = "bgr" if agreeing["bgr"] > agreeing["rgb"] else "rgb"
    # Some images have tags of a few objects only, and 0 elsewhere.
    tagged = int(np.count_nonzero(values[..., channels[best]]))
    if agreeing[best] < _LEAST_AGREEMENT * max(tagged, 1):
        percent = 100.0 / max(1, int(np.count_nonzero(is_tagged)))
        raise _fault(
            "the segmentation's tags in red (or in blue, if they are swapped)",
            f"them at {percent * agreeing['rgb']:.0f} % of the pixels in red and "
            f"{percent * agreeing['bgr']:.0f} % in blue",
        )
    return [best]


_BLUE, _GREEN, _RED = 0, 1, 2


def settled_instances(
    image: InstanceImage,
    boxes: FrameBoxes,
    silhouettes: list[Silhouette],
    tags_of_numbers: NDArray[np.uint8] | None = None,
) -> InstanceImage:
    """The image in the order of channels that its boxes show, if it is not certain.

    That is the order in which more of their pixels have a tag that they accept; ``rgb``
    if it is the same number. Parameters as for `fill_instances` and `read_instances`;
    the result has the tags of the numbers of a changed CARLA.
    """
    table = _TAGS if tags_of_numbers is None else tags_of_numbers
    if not image.is_certain:
        swapped = InstanceImage(
            tags=(image.ids >> 8).astype(np.uint8),
            ids=np.bitwise_or(
                image.ids & 0xFF, image.tags.astype(np.uint16) << 8, dtype=np.uint16
            ),
            order="bgr",
        )
        own = [
            sum(
                np.count_nonzero(silhouette.of(accepted[tags[silhouette.region]]))
                for silhouette in silhouettes
                for accepted in [accepts(int(boxes.accept_mask[silhouette.row]), table)]
            )
            for tags in (image.tags, swapped.tags)
        ]
        if own[1] > own[0]:
            image = swapped
    return image if table is _TAGS else replace(image, tags=table[image.tags])


def _fault(expected: str, found: str, code: str = "bad_instances") -> ImageError:
    return ImageError(
        f"the instance image: expected {expected}, found {found}",
        pointer="/instances",
        code=code,
    )


_TAGS: Final = np.arange(256, dtype=np.uint8)
"""The tag of each possible value of a pixel: the value itself."""


def fill_instances(
    numbers: ChannelNumbers,
    image: InstanceImage,
    boxes: FrameBoxes,
    silhouettes: list[Silhouette],
) -> None:
    """Fill the columns that the instance image measures.

    Parameters
    ----------
    numbers : ChannelNumbers
        Filled: `instance_pixels` and `tight_xyxy`; 0 pixels for boxes outside the image
        and boxes without an instance.
    boxes : FrameBoxes of N boxes, corrected
        With NaN rows in `xyxy` for boxes that are not in the image.
    silhouettes : those of the boxes that are in the image
    """
    pixels = group_pixels(image, np.unique(boxes.accept_mask).tolist())
    weight = pair_weights(image, pixels, boxes, silhouettes)
    # A box whose annotation gives its instance gets that one, or none if not visible.
    weight[boxes.instance_id != NOT_MEASURED] = 0.0
    # (N,) int64: index of each box's given instance; `NOT_MEASURED` if not seen
    ids = boxes.instance_id & ID_BITS
    at = np.searchsorted(pixels.ids, ids)
    at[at == len(pixels)] = 0
    there = (boxes.instance_id != NOT_MEASURED) & (len(pixels) > 0)
    if len(pixels):
        there &= pixels.ids[at] == ids
    columns: IntArray = np.where(there, at, NOT_MEASURED).astype(np.int64)
    chosen = assign_instances(weight, columns)
    numbers.instance_pixels[:] = 0
    for silhouette in silhouettes:
        row = silhouette.row
        if chosen[row] != NOT_MEASURED:
            mask = int(boxes.accept_mask[row])
            count, around = pixels.accepted(int(chosen[row]), mask)
            numbers.instance_pixels[row] = count
            numbers.tight_xyxy[row] = around


@dataclass(frozen=True, eq=False)
class InstancePixels:
    """The pixels whose tag some box accepts, grouped by instance.

    Attributes
    ----------
    ids : (K,) int64, ascending
    start : (K + 1,) int64
        Instance k has the pixels ``start[k] .. start[k + 1] - 1`` of the next arrays.
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
        """Count of an instance's pixels of accepted tags, and the xyxy around them."""
        part = slice(self.start[instance], self.start[instance + 1])
        is_accepted = accepts(accept_mask, self.tags[part])
        if not is_accepted.any():
            return 0, np.full(4, np.nan)
        x, y = self.columns[part][is_accepted], self.rows[part][is_accepted]
        around = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1], np.float64)
        return int(is_accepted.sum()), around


def group_pixels(image: InstanceImage, accept_mask: Sequence[int]) -> InstancePixels:
    """The pixels whose tag one of the `accept_mask` accepts, grouped by instance."""
    by_any = int(np.bitwise_or.reduce(np.asarray(accept_mask, np.int64)))
    accepted = accepts(by_any, _TAGS)[image.tags]
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


_MOSTLY_INSIDE: Final = 0.5
"""Least share of an instance's pixels inside a silhouette that it can belong to."""


def pair_weights(
    image: InstanceImage,
    pixels: InstancePixels,
    boxes: FrameBoxes,
    silhouettes: list[Silhouette],
) -> FloatArray:
    """(N, K) float64: how well each instance fits each box.

    0 where less than half of an instance is inside the box's silhouette, and where the
    box accepts none of its pixels.

    Parameters
    ----------
    boxes : FrameBoxes of N boxes, corrected
    silhouettes : those of the boxes that are in the image

    Notes
    -----
    ``share * sqrt(iou) / distance ** 2``: the share of the instance's pixels inside the
    silhouette, and the overlap of its tight rectangle with the box. The distance is
    there for hidden objects: the visible fragment of one fits the small box of
    something far behind it better than its own box. Boxes of unknown distance count as
    having the median distance.
    """
    weight = np.zeros((len(boxes.xyxy), len(pixels)))
    if not len(pixels):
        return weight
    dense = np.full(ID_BITS + 1, len(pixels), np.int64)
    dense[pixels.ids] = np.arange(len(pixels))
    rectangles, total = pixels.rectangles(), np.diff(pixels.start)
    # (N,): one over the square of the distance, in units of the median
    distance = boxes.distance
    distances = distance[~np.isnan(distance) & (distance > 0)]
    nearness = np.ones(len(distance))
    if len(distances):
        relative = distance / np.median(distances)
        relative[np.isnan(relative)] = 1.0
        nearness = 1.0 / np.maximum(relative, _NEAREST) ** 2
    for silhouette in silhouettes:
        row = silhouette.row
        accepted = silhouette.of(
            accepts(int(boxes.accept_mask[row]), _TAGS)[image.tags[silhouette.region]]
        )
        inside = dense[image.ids[silhouette.region][accepted]]
        counts = np.bincount(inside, minlength=len(pixels) + 1)[: len(pixels)]
        share = counts / total
        overlap = pairwise_iou(boxes.xyxy[row : row + 1], rectangles)
        fit = share * np.sqrt(overlap[0]) * nearness[row]
        weight[row] = np.where(share >= _MOSTLY_INSIDE, fit, 0.0)
    return weight


_NEAREST: Final = 1e-3
"""Smaller distances, in medians, count as this one: nearness stays finite."""


def assign_instances(weight: FloatArray, given_columns: IntArray) -> IntArray:
    """One instance per box and one box per instance, of the largest total weight.

    (N,) int64: the column of each box's instance; `NOT_MEASURED` where it has none.

    Parameters
    ----------
    weight : (N, K) float64
        0 where an instance cannot belong to a box.
    given_columns : (N,) int64
        Column of the instance that the annotation gives a box, which no other box can
        have then; `NOT_MEASURED` where it gives none.

    References
    ----------
    .. [1] D. F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE
       Transactions on Aerospace and Electronic Systems 52(4), 2016, as in SciPy.
    """
    chosen: IntArray = given_columns.astype(np.int64)
    open_rows = np.flatnonzero(
        (given_columns == NOT_MEASURED) & (weight > 0).any(axis=1)
    )
    taken = given_columns[given_columns != NOT_MEASURED]
    columns = np.setdiff1d(np.flatnonzero((weight > 0).any(axis=0)), taken)
    if not len(open_rows) or not len(columns):
        return chosen
    # Imported here: it takes a fifth of the time to start a server, and few need it.
    from scipy.optimize import linear_sum_assignment

    part = weight[np.ix_(open_rows, columns)]
    for row, column in zip(*linear_sum_assignment(part, maximize=True), strict=True):
        if part[row, column] > 0:
            chosen[open_rows[row]] = columns[column]
    return chosen
