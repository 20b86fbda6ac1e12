"""Evidence under other accept sets: from histograms, without a pixel."""

from __future__ import annotations

from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError
from filter_core.evidence.semantic import with_accept_masks
from filter_core.types import BoolArray, Evidence, IntArray


class NeedsPixels(FilterError):
    """Other accept sets in profile ``carlasimu``, whose one colour is counted anew."""

    code = "needs_pixels"


def accept_sets_differ(
    evidence: Evidence, config: FilterConfig, family: str | None
) -> BoolArray:
    """(N,) bool: boxes that were measured with another accept set than the config's.

    Where none does, `filter_core.decide.decide` needs neither rectangles nor
    histograms; where one does, the evidence must go through `with_accept_sets` first.

    Parameters
    ----------
    evidence : Evidence of N boxes, of any number of frames
    config : FilterConfig
    family : tag family of their segmentations, None where there was none
    """
    differs: BoolArray = _masks(evidence, config, family) != evidence.accept_mask
    return differs


def with_accept_sets(
    evidence: Evidence, config: FilterConfig, family: str | None
) -> Evidence:
    """The evidence of one frame as the config's accept sets would have measured it.

    Parameters
    ----------
    evidence : Evidence of one frame
        With `tag_counts` and `xyxy` where the accept sets differ.
    config : FilterConfig
    family : tag family of the frame's segmentation, None if there was none

    Returns
    -------
    Evidence
        The same object if nothing differs.

    Raises
    ------
    NeedsPixels
        Profile ``carlasimu``: only measuring again can tell.
    FilterError
        ``no_histogram``: `tag_counts` or `xyxy` were not measured or not loaded.
    """
    masks = _masks(evidence, config, family)
    if (masks == evidence.accept_mask).all():
        return evidence
    if config.profile == "carlasimu":
        raise NeedsPixels("other accept sets in profile carlasimu: measure again")
    return with_accept_masks(evidence, masks)


def _masks(evidence: Evidence, config: FilterConfig, family: str | None) -> IntArray:
    per_class = config.accept_masks(evidence.class_names, family)
    masks: IntArray = per_class[evidence.class_index]
    return masks
