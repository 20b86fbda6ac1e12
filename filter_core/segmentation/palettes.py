"""CARLA's tag families: which tag number has which name and colour, per version.

A *family* is a name for the tags that a range of CARLA's versions share, and its
`Palette` the table of these tags, which converts them to names and back, and to
colours. `FAMILIES` has the palettes by family, `family_of_version` returns the family
that a version renders. For users, a family is a value of the option `palette`, as in
its errors. Comments name the tables' sources.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import UNKNOWN_TAG, TagImage
from filter_core.errors import FilterError

RGB: TypeAlias = tuple[int, int, int]

_UNKNOWN_NAME: Final = "Unknown"

_UNKNOWN_RGB: Final[RGB] = (255, 255, 255)
"""White: what a tag without a colour is painted with; no family uses it."""


class UnknownVersion(FilterError):
    """A CARLA version whose tags are not known."""

    code = "unknown_carla_version"


class UnknownTag(FilterError):
    """A tag name that a family does not have."""

    code = "unknown_tag"


class UnknownFamily(FilterError):
    """A name that is not one of the families."""

    code = "unknown_palette"


@dataclass(frozen=True)
class Tag:
    """One row of a palette: a tag's number, its name and its colour."""

    tag: int
    name: str
    rgb: RGB


@dataclass(frozen=True)
class Palette:
    """The table of the family `name`: tag, name and colour are a bijection.

    Tag t is at place t.
    """

    name: str
    tags: tuple[Tag, ...]

    def name_of(self, tag: int) -> str:
        """The tag's name; a tag that the family does not have is named by its number.

        ``255`` is Unknown.
        """
        if 0 <= tag < len(self.tags):
            return self.tags[tag].name
        return _UNKNOWN_NAME if tag == UNKNOWN_TAG else f"Tag {tag}"

    def tag_of(self, name: str) -> int:
        """The number of a tag given by name, in any case.

        Raises `UnknownTag`: if the family has no tag of that name.
        """
        for tag in self.tags:
            if tag.name.casefold() == name.casefold():
                return tag.tag
        names = ", ".join(tag.name for tag in self.tags)
        raise UnknownTag(f"{self.name} has no tag {name!r}; it has {names}")

    @cached_property
    def rgb_table(self) -> NDArray[np.uint8]:
        """(256, 3) uint8: the colour of every tag number, white for others."""
        table = np.full((256, 3), _UNKNOWN_RGB, dtype=np.uint8)
        table[: len(self.tags)] = [tag.rgb for tag in self.tags]
        table.setflags(write=False)
        return table

    def paint(self, tags: TagImage) -> NDArray[np.uint8]:
        """(H, W, 3) uint8, RGB: the colour of every pixel of (H, W) tags.

        Tags that the family does not have become white.
        """
        colors: NDArray[np.uint8] = self.rgb_table[tags]
        return colors


_COLORS: Final[Mapping[str, RGB]] = {
    "Unlabeled": (0, 0, 0),
    "Road": (128, 64, 128),
    "Sidewalk": (244, 35, 232),
    "Building": (70, 70, 70),
    "Wall": (102, 102, 156),
    "Fence": (190, 153, 153),
    "Pole": (153, 153, 153),
    "TrafficLight": (250, 170, 30),
    "TrafficSign": (220, 220, 0),
    "Vegetation": (107, 142, 35),
    "Terrain": (152, 251, 152),
    "Sky": (70, 130, 180),
    "Pedestrian": (220, 20, 60),
    "Rider": (255, 0, 0),
    "Car": (0, 0, 142),
    "Truck": (0, 0, 70),
    "Bus": (0, 60, 100),
    "Train": (0, 80, 100),
    "Motorcycle": (0, 0, 230),
    "Bicycle": (119, 11, 32),
    "Static": (110, 190, 160),
    "Dynamic": (170, 120, 50),
    "Other": (55, 90, 80),
    "Water": (45, 60, 150),
    "RoadLine": (157, 234, 50),
    "Ground": (81, 0, 81),
    "Bridge": (150, 100, 100),
    "RailTrack": (230, 150, 140),
    "GuardRail": (180, 165, 180),
    "Rock": (180, 130, 70),
    "Vehicle": (0, 0, 142),
    "Unlabelled": (0, 0, 0),
    "Car and Truck": (0, 0, 142),
    "Van": (0, 0, 70),
}
"""The colours of tags by their names; a family may have others (`_palette`)."""


def _palette(
    name: str, tags: str, others: Mapping[str, RGB] = MappingProxyType({})
) -> Palette:
    """The palette of a family of these tags, in the order of their numbers.

    `others` are the colours that are not those of `_COLORS`.
    """
    colors = {**_COLORS, **others}
    names = enumerate(tags.split(", "))
    return Palette(
        name, tuple(Tag(tag, tag_name, colors[tag_name]) for tag, tag_name in names)
    )


# 0.9.0: CARLA's documentation; 0.9.10 and 0.9.14: the CityScapesPalette table inside
# the client libraries 0.9.12 to 0.9.16 (29 Rock: later builds of the UE5 branch);
# paper-table1: Chaar, Raiyn, Weidl (VEHITS 2024), Table 1, as printed.
_PALETTES: Final = (
    _palette(
        "carla-0.9.0",
        "Unlabeled, Building, Fence, Other, Pedestrian, Pole, RoadLine, Road, "
        "Sidewalk, Vegetation, Vehicle, Wall, TrafficSign",
        {"Other": (250, 170, 160)},
    ),
    _palette(
        "carla-0.9.10",
        "Unlabeled, Building, Fence, Other, Pedestrian, Pole, RoadLine, Road, "
        "Sidewalk, Vegetation, Vehicle, Wall, TrafficSign, Sky, Ground, Bridge, "
        "RailTrack, GuardRail, TrafficLight, Static, Dynamic, Water, Terrain",
        {"Fence": (100, 40, 40), "Terrain": (145, 170, 100)},
    ),
    _palette(
        "carla-0.9.14",
        "Unlabeled, Road, Sidewalk, Building, Wall, Fence, Pole, TrafficLight, "
        "TrafficSign, Vegetation, Terrain, Sky, Pedestrian, Rider, Car, Truck, Bus, "
        "Train, Motorcycle, Bicycle, Static, Dynamic, Other, Water, RoadLine, Ground, "
        "Bridge, RailTrack, GuardRail, Rock",
    ),
    _palette(
        "paper-table1",
        "Unlabelled, Car and Truck, Bus, Van, Bicycle, Motorcycle, Building, Fence, "
        "Other, Pedestrian, Pole, RoadLine, Road, Sidewalk, Vegetation, Wall, "
        "TrafficSign, Sky, Ground, Bridge, RailTrack, GuardRail, TrafficLight, "
        "Static, Dynamic, Water, Terrain",
        {"Fence": (100, 40, 40), "Terrain": (145, 170, 100)},
    ),
)

FAMILIES: Final[Mapping[str, Palette]] = {
    palette.name: palette for palette in _PALETTES
}

LAST_TAG: Final = max(len(palette.tags) for palette in _PALETTES) - 1
"""The highest tag that any family has; they count from 0 without a gap."""

PUBLISHED_COLORS: Final[Mapping[str, RGB]] = MappingProxyType(
    {
        "car": (0, 0, 142),
        "truck": (0, 0, 142),
        "bus": (0, 60, 100),
        "van": (0, 0, 70),
        "bicycle": (119, 11, 32),
        "motorcycle": (0, 0, 230),
        "walker": (220, 20, 60),
        "traffic_light": (250, 170, 30),
        "street_light": (250, 170, 30),
    }
)
"""The one colour per class that the paper's published code counts."""

PAPER_TABLE: Final = "paper-table1"
"""The only family that no CARLA server renders: a hybrid, to reproduce the paper."""

_OLDEST_KNOWN: Final = (0, 9, 0)

_FIRST_UNKNOWN: Final = (0, 11)

_FIRST_VERSION: Final = (
    ((0, 9, 14), "carla-0.9.14"),
    ((0, 9, 10), "carla-0.9.10"),
    ((0, 9, 0), "carla-0.9.0"),
)


def palette_of(family: str) -> Palette:
    """The family's palette.

    Raises `UnknownFamily`: if there is no such family; the text lists those that there
    are.
    """
    try:
        return FAMILIES[family]
    except KeyError:
        names = ", ".join(FAMILIES)
        raise UnknownFamily(
            f"palette must be auto or one of {names}; found {family!r}"
        ) from None


@dataclass(frozen=True)
class ChangedTags:
    """What a changed CARLA writes otherwise than the family that it was made of.

    All other numbers and colours mean what they mean in that family. `numbers` and
    `colors` have the name of a tag each; raw images have multiples of `scale` in the
    place of numbers.
    """

    numbers: tuple[tuple[int, str], ...] = ()
    colors: tuple[tuple[RGB, str], ...] = ()
    scale: int = 1

    def target(self, family: str) -> str:
        """The family whose numbers the tags get: this one, if it has all their names.

        Else the newest, which calls the tags of all others the same, but for Vehicle.
        Raises `UnknownTag`: neither of the two has all names.
        """
        names = {name for _, name in (*self.numbers, *self.colors)}
        lacking = [
            sorted(names.difference(tag.name for tag in palette_of(candidate).tags))
            for candidate in (family, NEWEST)
        ]
        if not lacking[0]:
            return family
        if not lacking[1]:
            return NEWEST
        raise UnknownTag(
            f"tags: expected names of one family, found {lacking[0][0]}, which is none "
            f"of {family}, and {lacking[1][0]}, which is none of {NEWEST}"
        )

    def renumbered(self, family: str) -> NDArray[np.uint8]:
        """(256,) uint8: the tag in `target` of each tag of a family; 255 if none."""
        return _renumbered(family, self.target(family))

    def tags_of_numbers(self, family: str) -> NDArray[np.uint8]:
        """(256,) uint8: the tag in `target` that a number means; 255 if none."""
        return _tags_of_numbers(self, family)

    @property
    def levels(self) -> NDArray[np.uint8]:
        """(256,) uint8: the number of each level of a raw image; 255 if it is none."""
        levels = np.arange(256)
        numbers = np.where(levels % self.scale, UNKNOWN_TAG, levels // self.scale)
        return numbers.astype(np.uint8)


UNCHANGED: Final = ChangedTags()

NEWEST: Final = _FIRST_VERSION[0][1]
"""The family of the newest versions of CARLA."""


@lru_cache(maxsize=64)
def _renumbered(family: str, target: str) -> NDArray[np.uint8]:
    numbers = {tag.name: tag.tag for tag in palette_of(target).tags}
    table = np.full(256, UNKNOWN_TAG, dtype=np.uint8)
    for tag in palette_of(family).tags:
        table[tag.tag] = numbers.get(tag.name, UNKNOWN_TAG)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=64)
def _tags_of_numbers(changed: ChangedTags, family: str) -> NDArray[np.uint8]:
    table: NDArray[np.uint8] = changed.renumbered(family).copy()
    target = palette_of(changed.target(family))
    for number, name in changed.numbers:
        if number * changed.scale <= UNKNOWN_TAG:
            table[number] = target.tag_of(name)
    table.setflags(write=False)
    return table


def known_family(version: object) -> str | None:
    """As `family_of_version`; None of anything that is no known version."""
    try:
        return family_of_version(version) if isinstance(version, str) else None
    except UnknownVersion:
        return None


def family_of_version(version: str) -> str:
    """The key in `FAMILIES` of the tag family that a CARLA version renders.

    Such as ``0.9.15``, ``v0.9.13``, ``0.9.14-12-g1a2b3c4-dirty``, ``0.10.0``. Raises
    `UnknownVersion`: if it is no version number, or one before 0.9.0 or after 0.10.
    """
    match = re.match(r"\s*v?(\d+(?:\.\d+)+)", version, re.IGNORECASE)
    if match:
        number = tuple(int(part) for part in match.group(1).split("."))
        if _OLDEST_KNOWN[:2] <= number < _FIRST_UNKNOWN:
            return next(name for first, name in _FIRST_VERSION if (*number, 0) >= first)
    raise UnknownVersion(
        f"carla_version must be of CARLA 0.9 or 0.10, as in 0.9.15; found {version!r}"
    )
