"""Order of distance: what a nearer box explains is no evidence for a farther one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.channel_types import NOT_MEASURED
from filter_core.evidence.accepted import AcceptedPixels
from filter_core.evidence.patches import bounds_of, islands
from filter_core.types import FloatArray, IntArray

_FREE: Final = -1


def owned_pixels(
    accepted: Sequence[AcceptedPixels],
    distance: FloatArray,
    ids: Sequence[str],
    image_wh: tuple[int, int],
) -> tuple[IntArray, IntArray]:
    """Hand out pixels to boxes from near to far.

    Parameters
    ----------
    accepted : of the boxes that are in the image
    distance : (N,) float64, metres
        Boxes of unknown distance (NaN) neither claim pixels nor are tested.
    ids : of the N boxes
        Break ties of distance.
    image_wh : (width, height), px

    Returns
    -------
    owned : (N,) int64, px
        What each box claims: the accepted pixels of its silhouette that no nearer one
        has claimed. `NOT_MEASURED` for boxes that are not tested.
    explained_by : (N,) int64
        The nearer box that claims most of the others (the nearest of several);
        `NOT_MEASURED` where none does.

    Notes
    -----
    A box that claims nothing takes nothing from those behind it, so a ghost in front
    does not hide what is seen through it. Nor does a box take from others what it
    cannot show, pixels whose centres are outside of its outline, or islands that a
    box behind it holds completely (`filter_core.channels.patches.islands`).
    """
    owned = np.full(len(distance), NOT_MEASURED, np.int64)
    explained_by = np.full(len(distance), NOT_MEASURED, np.int64)
    claims = np.full(image_wh[::-1], _FREE, np.int32)
    ranked = near_to_far(accepted, distance, ids)
    bounds = bounds_of(ranked)
    for rank, pixels in enumerate(ranked):
        row = pixels.silhouette.row
        claimed = claims[pixels.silhouette.region]
        free = pixels.mask & (claimed == _FREE)
        owned[row] = np.count_nonzero(free)
        if owned[row] < pixels.count:
            explained_by[row] = _commonest(claimed[pixels.mask & ~free])
        if owned[row]:
            taken = free & pixels.own
            left = islands(pixels, ranked[rank + 1 :], bounds[rank + 1 :])
            claimed[taken if left is None else taken & ~left] = rank
    row_of_rank = np.array([one.silhouette.row for one in ranked], np.int64)
    known = explained_by != NOT_MEASURED
    explained_by[known] = row_of_rank[explained_by[known]]
    return owned, explained_by


def near_to_far(
    accepted: Sequence[AcceptedPixels], distance: FloatArray, ids: Sequence[str]
) -> list[AcceptedPixels]:
    """Boxes of known distance, the nearest first; ties by id."""
    known = [one for one in accepted if not np.isnan(distance[one.silhouette.row])]
    return sorted(
        known,
        key=lambda one: (distance[one.silhouette.row], ids[one.silhouette.row]),
    )


def _commonest(ranks: NDArray[np.int32]) -> int:
    """The lowest, hence nearest, of the commonest ranks."""
    return int(np.bincount(ranks).argmax())
