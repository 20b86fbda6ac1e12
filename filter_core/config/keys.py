"""The keys of a configuration, each declared once: what it allows, and what it means.

To add a key, add a field to the class that fits:

`ClassKeys`
    A number that single classes can override. Most thresholds belong here.
`OnlyClassKeys`
    What only a class has: its accepted tags, and what it is measured as.
`DecidingKeys`
    Anything else that verdicts and the doubt about them depend on.
`ReadingKeys`
    How images are read and 3D boxes projected.

Checks, JSON schema, the page's form, docs/configuration.md and configuration files
follow from the field. A new key leaves the digests of stored configurations as they
are (`DecideConfig.digest`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Final, Generic, TypeVar, get_args

from filter_core.arrays import Dataclass
from filter_core.config.declaration import (
    FARTHEST_METRES,
    INHERIT,
    METRES,
    NEAREST_METRES,
    PERCENT,
    AllowedScale,
    AllowedWords,
    ChangedTagNames,
    ClassName,
    Inherit,
    Key,
    Number,
    TagList,
    counted,
    declared_keys,
    key,
)
from filter_core.evidence_kinds import AUTO, SEMANTIC, EvidenceChoice
from filter_core.evidence_numbers import DepthEncoding
from filter_core.frame_boxes import ProjectionMode
from filter_core.segmentation.reading import (
    FAMILY_NAMES,
    Encoding,
    Lossy,
    OrderOfChannels,
    TagScale,
)
from filter_core.verdicts import Profile

NumberT = TypeVar("NumberT")

WholeNumberT = TypeVar("WholeNumberT")

NumberOrNullT = TypeVar("NumberOrNullT")


# No generated comparison: it would fail on the arrays of `LimitsByClass`.
@dataclass(frozen=True, kw_only=True, eq=False)
class ClassKeys(Generic[NumberT, WholeNumberT, NumberOrNullT]):
    """The keys that single classes can override; all of them are numbers.

    A key is annotated with the type variable of the numbers that it allows::

        PERCENT                            NumberT
        counted(...)                       WholeNumberT
        NEAREST_METRES, FARTHEST_METRES    NumberOrNullT

    For example, a key that rejects boxes whose crowding (`Evidence.crowding`) is above
    it, for a reason of its own, would be::

        max_crowding: NumberT = key(
            PERCENT,
            100,
            "Largest share of a box that one other box may cover.",
            evidence=(SEMANTIC,),
        )

    `evidence` names the kinds of evidence whose rules use the key. A key such as
    `max_distance` has none: it decides boxes before pixels are looked at, whatever the
    evidence is (`Reason.is_final`).

    The annotations are type variables, because in each of the three classes in
    `filter.py` that inherit the keys, a key has a value of another type:

    - `ClassLimits`, for one class: a number;
    - `ClassConfig`, for what one class overrides: a number, or `INHERIT`;
    - `LimitsByClass`, for K classes: an array of K numbers.

    `DecideConfig` extends `ClassLimits`. Its numbers apply to all classes that do not
    override them.
    """

    threshold_small_box: NumberT = key(
        PERCENT,
        10,
        "Share of a box's pixels that must carry a tag of its class.",
        evidence=(SEMANTIC,),
    )
    size_big_box: NumberT = key(
        PERCENT,
        70,
        "A box is large if it covers more than this share of the image; in profile "
        "carlasimu, this share or more.",
        evidence=(SEMANTIC,),
    )
    threshold_big_box: NumberT = key(
        PERCENT,
        50,
        "Share of a large box's pixels that must carry a tag of its class.",
        evidence=(SEMANTIC,),
    )
    min_visible_pixels: WholeNumberT = key(
        counted("pixels"),
        10,
        "Fewest pixels that must be seen of a box: with a tag of its class, or of its "
        "instance. Where another `evidence` than auto is chosen, the default is 1.",
        evidence=(SEMANTIC, "ordered", "depth", "instance"),
    )
    min_visible_percent: NumberT = key(
        PERCENT,
        0,
        "Share of a box's pixels that must be its object's own, where order, depth or "
        "instances tell which are.",
        evidence=("ordered", "depth", "instance"),
    )
    min_distance: NumberOrNullT = key(
        NEAREST_METRES,
        None,
        "Nearest distance at which boxes are kept; null: no limit.",
    )
    max_distance: NumberOrNullT = key(
        FARTHEST_METRES,
        None,
        "Farthest distance at which boxes are kept; null: no limit.",
    )


@dataclass(frozen=True, kw_only=True)
class OnlyClassKeys:
    """The keys that only single classes have.

    In the place of these, a class can also have a name: ``Car: car`` is short for
    ``Car: {measures_as: car}``.
    """

    measures_as: str | Inherit = key(
        ClassName(),
        INHERIT,
        "The class as which boxes of this name are measured; pass: they are not "
        "measured, and written as they came.",
        needs_pixels=True,
    )

    accept: tuple[str | int, ...] | Inherit = key(
        TagList(),
        INHERIT,
        "Tags whose pixels count for the class, by name or number.",
        # Because channels and profile carlasimu need the images again if it changes.
        # All other configurations make do with stored histograms of tags.
        needs_pixels=True,
    )


@dataclass(frozen=True, kw_only=True)
class DecidingKeys:
    """The keys that `decide` and `doubts` read and that no class overrides.

    A change of those with `needs_pixels` also changes what is measured, so that images
    may have to be read again.
    """

    profile: Profile = key(
        AllowedWords(get_args(Profile)),
        "paper",
        "How boxes are counted and compared: as the paper says, or bit for bit as its "
        "authors' published code does.",
        needs_pixels=True,
    )
    evidence: EvidenceChoice = key(
        AllowedWords(get_args(EvidenceChoice)),
        AUTO,
        "By what boxes are judged: the segmentation, a channel besides it, or auto, "
        "the strongest that a frame allows. Where a profile is named, the default is "
        "semantic.",
        needs_pixels=True,
    )
    depth_tolerance: Number = key(
        METRES,
        0.15,
        "How far in front of a box and behind it a depth may lie and still be its own.",
        evidence=("depth", "depth_center"),
        needs_pixels=True,
    )
    ordered_min_pixels: int = key(
        counted("pixels"),
        3,
        "Fewest pixels with a tag of its class that nearer boxes must leave to a box.",
        evidence=("ordered",),
    )
    lidar_min_points: int = key(
        counted("points"),
        5,
        "Fewest LiDAR points with a tag of its class that must lie inside a box.",
        evidence=("lidar",),
    )
    review_min_side: int = key(
        counted("pixels"),
        4,
        "Shorter side from which on people are asked about a box: an eye cannot decide "
        "about smaller ones. It changes no verdict.",
    )


@dataclass(frozen=True, kw_only=True)
class ReadingKeys:
    """The keys for reading images and projecting 3D boxes."""

    projection: ProjectionMode = key(
        AllowedWords(get_args(ProjectionMode)),
        "clipped",
        "How 3D boxes become rectangles: cut exactly at the image, or as in the paper.",
        needs_pixels=True,
    )
    min_forward: Number | None = key(
        NEAREST_METRES,
        None,
        "3D boxes are out of range unless their centres are farther ahead of the "
        "camera than this, along its axis; null: no limit. carlasimu skips such boxes "
        "before it projects them.",
        needs_pixels=True,
    )
    palette: str = key(
        AllowedWords(FAMILY_NAMES),
        "auto",
        "Which of CARLA's tables of tags segmentations are made with.",
        needs_pixels=True,
    )
    encoding: Encoding = key(
        AllowedWords(get_args(Encoding)),
        "auto",
        "What pixels of segmentations are: colours of a palette, or raw tag numbers.",
        needs_pixels=True,
    )
    channel_order: OrderOfChannels = key(
        AllowedWords(get_args(OrderOfChannels)),
        "auto",
        "Order of the colour channels of segmentations.",
        needs_pixels=True,
    )
    lossy_segmentation: Lossy = key(
        AllowedWords(get_args(Lossy)),
        "refuse",
        "Whether segmentations as JPEG are refused, or read by the nearest colours.",
        needs_pixels=True,
    )
    tags: Mapping[str, str] = key(
        ChangedTagNames(),
        {},
        "Tags of a changed CARLA: names of CARLA's tags by their number or colour in "
        "segmentations and instance images. All others are those of the palette.",
        needs_pixels=True,
    )
    tag_scale: TagScale = key(
        AllowedScale(),
        "auto",
        "The number by which grey segmentations are divided, if they hold multiples of "
        "tags; auto: they hold tags.",
        needs_pixels=True,
    )
    depth_encoding: DepthEncoding = key(
        AllowedWords(get_args(DepthEncoding)),
        "auto",
        "How depth images hold metres. Those of 8 bits, and those in whole metres, are "
        "too coarse to be evidence.",
        needs_pixels=True,
    )


_LISTED_FIRST: Final = ("profile", *declared_keys(ClassKeys), "evidence", "projection")
"""Lists of keys begin with these; the others follow as they are declared."""


def keys_of(config_class: type[Dataclass]) -> Mapping[str, Key]:
    """The keys of a class, by name, in the order in which they are listed."""
    return _keys_of(config_class)


# Cached: called several times for every configuration that is made.
@cache
def _keys_of(config_class: type[Dataclass]) -> Mapping[str, Key]:
    keys = declared_keys(config_class)
    first = [name for name in _LISTED_FIRST if name in keys]
    return MappingProxyType({name: keys[name] for name in [*first, *keys]})
