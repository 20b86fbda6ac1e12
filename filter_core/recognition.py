"""How the images of a whole recording are read: their family of tags, their depth.

A recording has one family of tags and one encoding of depth, but not every image shows
them. So some images are looked at together, before any is measured.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError, LayoutError
from filter_core.evidence.depth import DepthImage, read_depth
from filter_core.evidence_kinds import files_for
from filter_core.formats.reading import FrameSet, FrameSource, read_file
from filter_core.images.pixels import ChannelOrder
from filter_core.segmentation.codes import ORDERS
from filter_core.segmentation.palettes import PAPER_TABLE, known_family
from filter_core.segmentation.reading import read_segmentation

_DEPTH_IMAGES: Final = 8
"""Depth images of a recording that are looked at."""

_FEWEST_LOOKED_AT: Final = 3

_LOOKED_AT_SHARE: Final = 40
"""Of so many segmentations of a recording, one is looked at, but some at least."""

_MOST_TIMES: Final = 4
"""So many times more are looked at while they do not tell the family of tags."""


class Shown(NamedTuple):
    """What the images of a recording show about how they are read.

    `keys` of a configuration with their values; and `notes`, sentences for people: what
    was recognised, and how sure it is.
    """

    keys: Mapping[str, str] = MappingProxyType({})
    notes: tuple[str, ...] = ()

    def of(self, frames: FrameSet) -> FrameSet:
        """The frames, which are read so, unless they name their own version."""
        return replace(frames, frames=lambda: map(self.of_frame, frames))

    def of_frame(self, frame: FrameSource) -> FrameSource:
        """One of these frames."""
        keys = dict(self.keys)
        if "palette" in keys and _family_by_version(frame):
            del keys["palette"]
        return replace(frame, shown=keys) if keys else frame


def recognise_recording(
    frames: Iterable[FrameSource], config: FilterConfig, channels: Collection[str] = ()
) -> Shown:
    """How the images of a recording are read, by some of them together.

    Parameters
    ----------
    frames : iterable of FrameSource
        Some of the recording. A few of their images are read.
    config : FilterConfig
        What it names is not recognised.
    channels : collection of EvidenceName
        What is measured besides the segmentation.

    Raises
    ------
    LayoutError
        ``several_families``: images prove different families of tags.

    Notes
    -----
    A recording has one family of tags and one encoding of depth, and not every image
    shows them: many colours have the same name in all families, and a wall that fills
    an image of depth is too flat. What none of the images shows is left to each frame.
    """
    several = list(frames)
    keys, notes = _shown_family(several, config)
    if config.depth_encoding == "auto" and "depth" in files_for(channels):
        shown = {
            depth.encoding
            for _, depth in depth_images(several)
            # A fault is said when the frame is used.
            if isinstance(depth, DepthImage) and depth.is_certain
        }
        if len(shown) == 1:
            keys["depth_encoding"] = shown.pop()
    return Shown(keys, notes)


def depth_images(
    frames: Iterable[FrameSource],
) -> Iterator[tuple[str, DepthImage | FilterError]]:
    """A few depth images of some frames: the frame's key, and the image or its fault.

    Each is read as it shows itself, whatever others show.
    """
    there = [frame for frame in frames if "depth" in frame.others]
    step = max(1, len(there) // _DEPTH_IMAGES)
    for frame in there[::step][:_DEPTH_IMAGES]:
        try:
            yield frame.key, read_depth(read_file(frame.others["depth"], "depth"))
        except FilterError as fault:
            yield frame.key, fault


_Image: TypeAlias = tuple[str, Path]
"""The key of a frame, and its segmentation."""


_Readings: TypeAlias = frozenset[tuple[str, ChannelOrder]]
"""The families that a segmentation may have, each with an order of channels."""


def _shown_family(
    frames: Iterable[FrameSource], config: FilterConfig
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The palette, if images tell it; the order of channels, if swapped; and notes."""
    if config.palette != "auto":
        return {}, ()
    images = [
        (frame.key, frame.segmentation)
        for frame in frames
        if frame.segmentation and not frame.problem and not _family_by_version(frame)
    ]
    fewest = min(len(images), max(_FEWEST_LOOKED_AT, len(images) // _LOOKED_AT_SHARE))
    votes: list[_Readings] = []
    keys: dict[frozenset[str], str] = {}  # the first frame that tells these families
    common: frozenset[str] = frozenset()
    # Some images in an order in which any number of them is spread over all
    most = min(len(images), fewest * _MOST_TIMES)
    places = [
        place
        for count in (fewest, most)
        for place in np.linspace(0, len(images) - 1, count).astype(int).tolist()
    ]
    for number, (key, image) in enumerate(
        images[place] for place in dict.fromkeys(places)
    ):
        if len(common) == 1 and number >= fewest:
            break
        if readings := _readings(image, config):
            votes.append(readings)
            keys.setdefault(_families(readings), key)
            common = _common(keys)
    if len(common) != 1:
        return {}, ()
    (family,) = common
    orders = frozenset(ORDERS).intersection(
        *({order for name, order in vote if name == family} for vote in votes)
    )
    telling = sum(_families(vote) == common for vote in votes)
    note = (
        f"tags of {family}: told by {telling or 'none'} of the {len(votes)} "
        f"segmentations that were looked at{'' if telling else ' alone, but together'}"
    )
    swapped = {"channel_order": "bgr"} if orders == {"bgr"} else {}
    return {"palette": family, **swapped}, (note,)


def _family_by_version(frame: FrameSource) -> str | None:
    """The family of the version of CARLA that a frame names, if it is known."""
    return known_family((frame.annotation or {}).get("carla_version"))


def _readings(image: Path, config: FilterConfig) -> _Readings:
    try:
        content = read_file(image, "segmentation")
        return read_segmentation(content, config.measuring().reading).readings
    except FilterError:
        return frozenset()  # said when the frame is used, unless others tell its family


def _families(readings: _Readings) -> frozenset[str]:
    """The families alone; the paper's table only if no version of CARLA is told."""
    families = frozenset(family for family, _ in readings)
    return families - {PAPER_TABLE} or families


def _common(keys: Mapping[frozenset[str], str]) -> frozenset[str]:
    """The families that fit all images; `keys` has a frame for those that differ."""
    # CARLA does not render the paper's table, so that others can explain such an image.
    usual = [families for families in keys if families != {PAPER_TABLE}] or [*keys]
    common = frozenset.intersection(*usual)
    if common:
        return common
    *before, last = usual
    other = min(before, key=lambda families: len(families & last))
    first, second = (
        f"{keys[families]} is of {' or '.join(sorted(families))}"
        for families in (other, last)
    )
    raise LayoutError(
        f"expected segmentations of one family of tags, found several: {first}, "
        f"{second}. Read recordings of different versions of CARLA apart, or give "
        "their frames a carla_version; --palette names the family if one of these is "
        "wrong",
        code="several_families",
    )
