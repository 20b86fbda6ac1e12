"""When two families explain an image's colours, and it matters which one it is."""

from __future__ import annotations

from collections.abc import Iterable

from filter_core.classes import accept_mask_of
from filter_core.errors import SegmentationError
from filter_core.segmentation.codes import tags_of_codes
from filter_core.segmentation.pixel_codes import Segmentation
from filter_core.types import UNKNOWN_COLUMN


def refuse_ambiguity(
    segmentation: Segmentation, masks: Iterable[tuple[str, int]]
) -> None:
    """Refuse to measure a class whose pixels depend on which family it is.

    (0, 0, 142) is Car in carla-0.9.14 and Vehicle in carla-0.9.10. That is the same
    to a car, which accepts it either way, but not to a bus.

    Parameters
    ----------
    segmentation : Segmentation
        Its `rivals` are the families that the colours allow as well.
    masks : (class name, accept mask) of each class
        A mask that is not the class's own in the family was chosen by somebody who
        knew the family, so it is not ambiguous.

    Raises
    ------
    SegmentationError
        ``ambiguous_palette``, naming the class and the families.
    """
    for name, mask in masks if segmentation.rivals else ():
        if mask != accept_mask_of(name, segmentation.family):
            continue
        colors = _accepted(segmentation, segmentation.family, mask)
        for rival in segmentation.rivals:
            if colors == _accepted(segmentation, rival, accept_mask_of(name, rival)):
                continue
            raise SegmentationError(
                f"the colours that occur fit {segmentation.family} and {rival}, which "
                f"differ in what counts as {name}; name the palette in the dataset or "
                "the config, or give the frame's carla_version",
                code="ambiguous_palette",
            )


def _accepted(segmentation: Segmentation, family: str, mask: int) -> frozenset[int]:
    """The codes that occur and that a mask of the family accepts."""
    tags = tags_of_codes(family, segmentation.channel_order)
    return frozenset(
        code
        for code in segmentation.codes.occurring
        if tags[code] < UNKNOWN_COLUMN and mask >> int(tags[code]) & 1
    )
