"""Which instance belongs to which box: one to one, as well as possible for all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from filter_core.channel_types import NOT_MEASURED, ChannelNumbers
from filter_core.evidence.accepted import accepted_codes
from filter_core.evidence.instances import (
    ID_BITS,
    InstanceImage,
    InstancePixels,
    group_pixels,
)
from filter_core.evidence.silhouettes import Silhouette
from filter_core.types import BoxesXYXY, FloatArray, IntArray

_FREE: Final = NOT_MEASURED

_MOSTLY_INSIDE: Final = 0.5

_NEAREST: Final = 1e-3

_TAGS: Final = np.arange(256, dtype=np.uint8)
"""The pixels of an instance image are tags: their own codes."""


@dataclass(frozen=True, eq=False)
class InstanceBoxes:
    """What is needed of N boxes to find their instances.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        Corrected; NaN rows for boxes that are not in the image.
    accept_mask : (N,) int64
    distance : (N,) float64, metres, NaN where unknown
    instance_id : (N,) int64
        As given, `NOT_MEASURED` where it was not.
    """

    xyxy: BoxesXYXY
    accept_mask: IntArray
    distance: FloatArray
    instance_id: IntArray


def measure_instances(
    numbers: ChannelNumbers,
    image: InstanceImage,
    boxes: InstanceBoxes,
    outlines: list[Silhouette],
) -> None:
    """Fill in the visible pixels and the tight rectangles of the boxes' instances.

    Parameters
    ----------
    numbers : ChannelNumbers
        `instance_pixels` and `tight_xyxy`; 0 pixels where no instance belongs to a
        box, and outside of the image.
    image : InstanceImage
    boxes : InstanceBoxes
    outlines : silhouettes of the boxes that are in the image
    """
    pixels = group_pixels(image, np.unique(boxes.accept_mask).tolist())
    weight = pair_weights(image, pixels, boxes, outlines)
    # A box that names its instance gets that one or none: it may be out of sight.
    weight[boxes.instance_id != _FREE] = 0.0
    chosen = assign_instances(weight, _given(pixels, boxes))
    numbers.instance_pixels[:] = 0
    for outline in outlines:
        row = outline.row
        if chosen[row] != _FREE:
            mask = int(boxes.accept_mask[row])
            count, around = pixels.accepted(int(chosen[row]), mask)
            numbers.instance_pixels[row] = count
            numbers.tight_xyxy[row] = around


def pair_weights(
    image: InstanceImage,
    pixels: InstancePixels,
    boxes: InstanceBoxes,
    outlines: list[Silhouette],
) -> FloatArray:
    """How well each instance fits each box.

    Parameters
    ----------
    image : InstanceImage
    pixels : InstancePixels
    boxes : InstanceBoxes of N boxes
    outlines : silhouettes of the boxes that are in the image

    Returns
    -------
    (N, K) float64
        0 where less than half of an instance is inside the box's silhouette, and where
        the box accepts none of its pixels.

    Notes
    -----
    ``share * sqrt(iou) / distance ** 2``: the share of the instance's pixels inside the
    silhouette, and the overlap of its tight rectangle with the box. What is seen of a
    hidden object is a fragment, which fits the small box of something far behind it
    better than its own. Pixels times overlap takes it for that; preferring what is near
    does not. Boxes of unknown distance count as far as the median of the others.
    """
    weight = np.zeros((len(boxes.xyxy), len(pixels)))
    if not len(pixels):
        return weight
    dense = np.full(ID_BITS + 1, len(pixels), np.int64)
    dense[pixels.ids] = np.arange(len(pixels))
    rectangles, total = pixels.rectangles(), np.diff(pixels.start)
    nearness = _nearness(boxes.distance)
    for outline in outlines:
        row = outline.row
        accepted = outline.of(
            accepted_codes(_TAGS, int(boxes.accept_mask[row]))[
                image.tags[outline.region]
            ]
        )
        inside = dense[image.ids[outline.region][accepted]]
        counts = np.bincount(inside, minlength=len(pixels) + 1)[: len(pixels)]
        share = counts / total
        fit = share * np.sqrt(overlap(boxes.xyxy[row], rectangles)) * nearness[row]
        weight[row] = np.where(share >= _MOSTLY_INSIDE, fit, 0.0)
    return weight


def _nearness(distance: FloatArray) -> FloatArray:
    """(N,): one over the square of the distance, in units of the median."""
    known = distance[~np.isnan(distance) & (distance > 0)]
    if not len(known):
        return np.ones(len(distance))
    relative = distance / np.median(known)
    relative[np.isnan(relative)] = 1.0
    nearness: FloatArray = 1.0 / np.maximum(relative, _NEAREST) ** 2
    return nearness


def assign_instances(weight: FloatArray, given: IntArray) -> IntArray:
    """One instance per box and one box per instance, of the largest total weight.

    Parameters
    ----------
    weight : (N, K) float64
        0 where an instance cannot belong to a box.
    given : (N,) int64
        The instance that a box names itself, which no other box can have then;
        `NOT_MEASURED` where it names none.

    Returns
    -------
    (N,) int64
        Column of each box's instance; `NOT_MEASURED` where it has none.

    References
    ----------
    .. [1] D. F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE
       Transactions on Aerospace and Electronic Systems 52(4), 2016, as in SciPy.
    """
    chosen: IntArray = given.astype(np.int64)
    open_rows = np.flatnonzero((given == _FREE) & (weight > 0).any(axis=1))
    taken = given[given != _FREE]
    columns = np.setdiff1d(np.flatnonzero((weight > 0).any(axis=0)), taken)
    if not len(open_rows) or not len(columns):
        return chosen
    # Not above: it takes a fifth of the time in which a server starts, and few need it.
    from scipy.optimize import linear_sum_assignment

    part = weight[np.ix_(open_rows, columns)]
    for row, column in zip(*linear_sum_assignment(part, maximize=True), strict=True):
        if part[row, column] > 0:
            chosen[open_rows[row]] = columns[column]
    return chosen


def overlap(xyxy: FloatArray, rectangles: FloatArray) -> FloatArray:
    """(K,): intersection over union of one rectangle with K others."""
    low = np.maximum(xyxy[:2], rectangles[:, :2])
    high = np.minimum(xyxy[2:], rectangles[:, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=1)
    areas = np.prod(rectangles[:, 2:] - rectangles[:, :2], axis=1)
    union = areas + np.prod(xyxy[2:] - xyxy[:2]) - common
    return np.asarray(common / np.where(union > 0, union, 1.0), np.float64)


def _given(pixels: InstancePixels, boxes: InstanceBoxes) -> IntArray:
    """Columns of the instances that boxes name; an id that is nowhere is no column."""
    wanted = boxes.instance_id & ID_BITS
    at = np.searchsorted(pixels.ids, wanted)
    at[at == len(pixels)] = 0
    there = (boxes.instance_id != _FREE) & (len(pixels) > 0)
    if len(pixels):
        there &= pixels.ids[at] == wanted
    columns: IntArray = np.where(there, at, _FREE).astype(np.int64)
    return columns
