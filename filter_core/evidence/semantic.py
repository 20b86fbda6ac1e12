"""The segmentation as evidence: how many pixels of each box have an accepted tag.

`measure` counts the pixels in each box that the box's class accepts and, as a
histogram, the pixels of every tag. The counts for other accept sets follow from the
histogram, without pixels: `with_accept_sets` takes these sets from a configuration,
`with_accept_masks` as bit masks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray, Mask
from filter_core.classes import accept_mask_of, accepts
from filter_core.config.measure import NEWEST_VERSION, MeasureConfig
from filter_core.errors import FilterError, ImageSizeMismatch, SegmentationError
from filter_core.evidence.counting import Regions, count_codes_in, count_pixels
from filter_core.evidence.crowding import crowding_percent
from filter_core.evidence_numbers import N_TAGS, UNKNOWN_COLUMN, BoxState, Evidence
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.boxes import correct_xyxy, pixel_bounds
from filter_core.segmentation.codes import CODE_OF, Segmentation, packed, tags_of_codes
from filter_core.segmentation.palettes import PUBLISHED_COLORS
from filter_core.verdicts import Profile


@dataclass(frozen=True)
class MeasureOptions:
    """How boxes are measured on a segmentation.

    Attributes
    ----------
    profile : ``paper`` or ``carlasimu``
    version : int
        Of `MeasureConfig`. In the first version edges stay as given, and unknown pixels
        are not counted by themselves.
    """

    profile: Profile = "paper"
    version: int = NEWEST_VERSION


_DEFAULTS: Final = MeasureOptions()


def measure(
    segmentation: Segmentation | None,
    boxes: FrameBoxes,
    options: MeasureOptions = _DEFAULTS,
    *,
    ignore: Mask | None = None,
) -> Evidence:
    """Measure each of N boxes of a frame: numbers, no verdicts.

    Boxes that are outside the image or degenerate have no pixels, a match of 0 % and no
    crowding.

    Parameters
    ----------
    segmentation : Segmentation or None
        None: only numbers that need no pixels are measured.
    boxes : FrameBoxes of N boxes
    ignore : (H, W) bool, optional
        True: the pixel never counts, neither as matched nor as the box's.

    Raises
    ------
    ImageSizeMismatch
        The segmentation or the ignore mask has another size than `boxes.image_wh`.
    AnnotationError
        A coordinate is not finite.
    SegmentationError
        ``ambiguous_palette``: the segmentation fits two families, and what counts for
        a class differs between them.

    Notes
    -----
    Profile ``paper``: a box's pixels are those that it touches; the match is the share
    of them that have an accepted tag. Profile ``carlasimu``: its pixels are the crop
    ``[int(y_min):int(y_max), int(x_min):int(x_max)]``; the match is the number of
    pixels of the class's one colour, in percent of the box's area as a float, and can
    exceed 100.

    References
    ----------
    .. [1] M. Chaar, J. Raiyn, G. Weidl, "Improve Bounding Box in Carla Simulator",
       VEHITS 2024, Algorithms 1 and 2.
    """
    if segmentation is not None:
        _require_size("segmentation", segmentation.wh, boxes.image_wh)
    if ignore is not None:
        _require_size("ignore mask", ignore.shape[::-1], boxes.image_wh)
    wh = boxes.image_wh
    corrected, state = correct_xyxy(
        boxes.xyxy, wh, options.profile, rounded_edges=options.version > 1
    )
    is_inside = (state == BoxState.MEASURABLE) | (state == BoxState.COVERS_IMAGE)
    state[boxes.not_ahead & is_inside] = BoxState.NOT_AHEAD
    live = state == BoxState.MEASURABLE
    areas = _areas(corrected)
    bounds = (
        pixel_bounds(corrected, wh)
        if options.profile == "paper"
        # The cast drops fractions, as int() in the published code; NaN cannot be cast.
        else np.nan_to_num(corrected, nan=0.0).astype(np.int64)
    )
    counts = _Counts.of_geometry(bounds)
    if segmentation is not None:
        regions = Regions(
            segmentation.codes, bounds, None if ignore is None else ~ignore
        )
        counts = _counts(segmentation, regions, boxes, options)
    return Evidence(
        class_names=boxes.class_names,
        class_index=boxes.class_index,
        state=state,
        accept_mask=boxes.accept_mask,
        measured=np.full(len(boxes), segmentation is not None),
        box_pixels=counts.box_pixels,
        matched_pixels=counts.matched_pixels,
        image_pixels=np.full(len(boxes), wh[0] * wh[1], dtype=np.int64),
        match_percent=(
            np.full(len(boxes), np.nan)
            if segmentation is None
            else _match_percent(counts, areas, options.profile)
        ),
        area_percent=(areas / float(wh[0] * wh[1])) * 100,
        crowding=crowding_percent(corrected, np.where(live, boxes.accept_mask, 0)),
        distance=boxes.distance,
        unknown_pixels=(
            np.zeros(len(boxes), np.int64)
            if counts.tag_counts is None or options.version == 1
            else counts.tag_counts[:, UNKNOWN_COLUMN].astype(np.int64)
        ),
        xyxy=corrected,
        distance_range=boxes.distance_range,
        tag_counts=counts.tag_counts,
    )


def _require_size(what: str, wh: tuple[int, ...], image_wh: tuple[int, int]) -> None:
    if wh != tuple(image_wh):
        raise ImageSizeMismatch(
            f"the {what} is {wh[0]} x {wh[1]} pixels, "
            f"the image is {image_wh[0]} x {image_wh[1]}"
        )


def _areas(xyxy: BoxesXYXY) -> FloatArray:
    """(N,) px: areas, in the published code's order of operations; 0 for NaN rows."""
    areas: FloatArray = (xyxy[:, 2] - xyxy[:, 0]) * (xyxy[:, 3] - xyxy[:, 1])
    areas[np.isnan(areas)] = 0.0
    return areas


class _Counts(NamedTuple):
    """Counted pixels of N boxes; `tag_counts` are None if no tags were counted."""

    box_pixels: IntArray
    matched_pixels: IntArray
    tag_counts: NDArray[np.int32] | None

    @classmethod
    def of_geometry(cls, bounds: IntArray) -> _Counts:
        """The counts that are known without a segmentation."""
        x0, y0, x1, y1 = bounds.T
        return cls((x1 - x0) * (y1 - y0), np.zeros(len(bounds), np.int64), None)


def _counts(
    segmentation: Segmentation,
    regions: Regions,
    boxes: FrameBoxes,
    options: MeasureOptions,
) -> _Counts:
    if options.profile == "paper":
        _refuse_ambiguous_family(segmentation, boxes)
    codes = list(regions.codes.occurring)
    is_exact = segmentation.encoding == "palette" and not segmentation.lossy
    # The published code knows no colours of a changed CARLA, so their tags count.
    by_color = is_exact and not segmentation.codes.changed.colors
    if options.profile == "carlasimu" and by_color:
        # (N, 256): true at the code of each class's one colour, in the family or not
        table = np.zeros((len(boxes.class_names), 256), dtype=np.bool_)
        for row, name in enumerate(boxes.measured_as):
            color = PUBLISHED_COLORS.get(name)
            if color is not None:
                code = CODE_OF.get(packed(color, segmentation.channel_order))
                table[row, [] if code is None else code] = True
        accepted: BoolArray = table[boxes.class_index]
        accepted = accepted[:, codes]
    else:
        tags = regions.codes.tag_of_code[codes]
        accepted = accepts(boxes.accept_mask[:, None], tags)
    box_pixels = count_pixels(regions)
    counts = count_codes_in(regions, codes)
    # (N, N_TAGS): counts by tag from counts by code; several codes are Unknown
    tags = regions.codes.tag_of_code[codes]
    tag_counts = np.zeros((len(counts), N_TAGS), dtype=np.int32)
    is_known = tags < UNKNOWN_COLUMN
    tag_counts[:, tags[is_known]] = counts[:, is_known]
    tag_counts[:, UNKNOWN_COLUMN] = counts[:, ~is_known].sum(axis=1)
    return _Counts(box_pixels, (counts * accepted).sum(axis=1), tag_counts)


def _refuse_ambiguous_family(segmentation: Segmentation, boxes: FrameBoxes) -> None:
    """Raise if a box's class accepts other pixels in another family that fits.

    (0, 0, 142) is Car in carla-0.9.14 and Vehicle in carla-0.9.10. The class car
    accepts it in both families, the class bus only as Vehicle.
    """
    if not segmentation.rivals:
        return
    rows = zip(boxes.class_index.tolist(), boxes.accept_mask.tolist(), strict=True)
    masks = {(boxes.measured_as[index], mask) for index, mask in rows}
    for name, mask in sorted(masks):
        # A mask that is configured names tags of a known family: no ambiguity.
        if mask != accept_mask_of(name, segmentation.family):
            continue
        codes = _accepted_codes(segmentation, segmentation.family, mask)
        for rival in segmentation.rivals:
            meant = accept_mask_of(name, rival)
            if codes == _accepted_codes(segmentation, rival, meant):
                continue
            raise SegmentationError(
                f"the colours that occur fit {segmentation.family} and {rival}, which "
                f"differ in what counts as {name}; name the palette in the dataset or "
                "the config, or give the frame's carla_version",
                code="ambiguous_palette",
            )


def _accepted_codes(
    segmentation: Segmentation, family: str, mask: int
) -> frozenset[int]:
    """The codes that occur and that a mask of the family accepts."""
    tags = tags_of_codes(family, segmentation.channel_order)
    occurring = np.array(segmentation.codes.occurring, np.int64)
    return frozenset(occurring[accepts(mask, tags[occurring])].tolist())


def _match_percent(counts: _Counts, areas: FloatArray, profile: Profile) -> FloatArray:
    if profile == "paper":
        return 100.0 * counts.matched_pixels / np.maximum(counts.box_pixels, 1)
    # The published code's order of operations, since matches equal to a threshold fail.
    return (counts.matched_pixels / np.where(areas > 0, areas, 1.0)) * 100


class NeedsPixels(FilterError):
    """Other accept sets in profile ``carlasimu`` need the pixels to be read again."""

    code = "needs_pixels"


def with_accept_sets(
    evidence: Evidence, config: MeasureConfig, family: str | None
) -> Evidence:
    """The evidence of one frame as the config's accept sets would have measured it.

    The same object if nothing differs. It has `tag_counts` and `xyxy` where the accept
    sets differ; `family` is that of the frame's segmentation, None if there was none.

    Raises
    ------
    NeedsPixels
        Profile ``carlasimu``: only measuring again can tell.
    FilterError
        ``no_histogram``: `tag_counts` or `xyxy` were not measured or not loaded.
    """
    per_class = config.accept_masks(evidence.class_names, family)
    masks: IntArray = per_class[evidence.class_index]
    if (masks == evidence.accept_mask).all():
        return evidence
    if config.profile == "carlasimu":
        raise NeedsPixels("other accept sets in profile carlasimu: measure again")
    return with_accept_masks(evidence, masks)


def with_accept_masks(evidence: Evidence, accept_mask: IntArray) -> Evidence:
    """The same evidence with other accept sets, (N,) int64; reads no pixel.

    It is that of one frame, with `tag_counts` and `xyxy`, and measured with profile
    ``paper``. Raises `FilterError` (``no_histogram``): `tag_counts` or `xyxy` were not
    measured or not loaded.
    """
    if evidence.xyxy is None or (
        evidence.tag_counts is None and evidence.measured.any()
    ):
        raise FilterError(
            "other accept sets need the tag histogram and the boxes; "
            "they were not measured or not loaded",
            code="no_histogram",
        )
    live = evidence.state == BoxState.MEASURABLE
    crowding = crowding_percent(evidence.xyxy, np.where(live, accept_mask, 0))
    changed = replace(evidence, accept_mask=accept_mask, crowding=crowding)
    if evidence.tag_counts is None:
        return changed
    accepted = accepts(accept_mask[:, None], np.arange(N_TAGS))
    matched = (evidence.tag_counts * accepted).sum(axis=1)
    counts = _Counts(evidence.box_pixels, matched.astype(np.int64), None)
    percent = _match_percent(counts, _areas(evidence.xyxy), "paper")
    return replace(
        changed,
        matched_pixels=counts.matched_pixels,
        match_percent=np.where(evidence.measured, percent, np.nan),
    )
