"""The filter's classes, and the tags whose pixels match each of them.

What the names of classes in labels mean is in `class_names`. `accept_mask_of` returns
the tags that a class accepts in a tag family, as bits; only `accepts` tests such a
mask. `canonical_accept` checks the accept set of a configuration, which replaces it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, IntArray
from filter_core.class_names import canonical_class
from filter_core.errors import ConfigError
from filter_core.evidence_numbers import UNKNOWN_COLUMN
from filter_core.segmentation.palettes import (
    FAMILIES,
    LAST_TAG,
    PUBLISHED_COLORS,
    Palette,
)
from filter_core.values import nearest, pointer_token, prefix_of, shown
from filter_core.verdicts import Profile

# A class accepts several tags: a driven van is tagged Truck and a parked one Car, a
# cybertruck either, and the box of a two-wheeler also contains its rider.
_ACCEPT_SINCE_0_9_14: Final = {
    "car": ("Car",),
    "truck": ("Truck", "Car"),
    "van": ("Truck", "Car"),
    "bus": ("Bus",),
    "motorcycle": ("Motorcycle", "Rider"),
    "bicycle": ("Bicycle", "Rider"),
    "walker": ("Pedestrian",),
    "traffic_light": ("TrafficLight",),
    "vehicle": ("Car", "Truck", "Bus", "Motorcycle", "Bicycle", "Rider"),
}

CLASSES: Final = tuple(_ACCEPT_SINCE_0_9_14)
"""The filter's own classes, in the order in which they are listed."""

_ONE_TAG: Final = {
    "rider": ("Rider",),
    "train": ("Train",),
    "traffic_sign": ("TrafficSign",),
    "building": ("Building",),
    "fence": ("Fence",),
    "pole": ("Pole",),
    "road_line": ("RoadLine",),
    "road": ("Road",),
    "sidewalk": ("Sidewalk",),
    "vegetation": ("Vegetation",),
    "wall": ("Wall",),
    "sky": ("Sky",),
    "ground": ("Ground",),
    "bridge": ("Bridge",),
    "rail_track": ("RailTrack",),
    "guard_rail": ("GuardRail",),
    "static": ("Static",),
    "dynamic": ("Dynamic",),
    "water": ("Water",),
    "terrain": ("Terrain",),
    "rock": ("Rock",),
}
"""Classes that are one of CARLA's tags, in the families that have it."""

MEASURED_CLASSES: Final = (*CLASSES, *_ONE_TAG)
"""The classes that some family of tags can measure."""

_ACCEPT_BEFORE: Final = {
    **_ONE_TAG,
    **dict.fromkeys(("car", "truck", "van", "bus", "vehicle"), ("Vehicle",)),
    **dict.fromkeys(("motorcycle", "bicycle"), ("Vehicle", "Pedestrian")),
    **dict.fromkeys(("walker", "rider"), ("Pedestrian",)),
}

_ACCEPT: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "carla-0.9.14": {**_ONE_TAG, **_ACCEPT_SINCE_0_9_14},
    "carla-0.9.10": {**_ACCEPT_BEFORE, "traffic_light": ("TrafficLight",)},
    "carla-0.9.0": _ACCEPT_BEFORE,
}

PASS: Final = "pass"
"""In place of a class in a class map: boxes of that name are not measured."""


def accept_mask_of(
    class_name: str,
    family: str | None,
    profile: Profile = "paper",
    override: Sequence[str | int] | None = None,
) -> int:
    """The tags whose pixels count for a class, as bits: bit t is set for tag t.

    0 if the class is not mapped.

    Parameters
    ----------
    class_name : str
        One of `MEASURED_CLASSES` or an alias; `class_meant_by` gives it for any name.
    family : str or None
        A key of `filter_core.segmentation.palettes.FAMILIES`. None: nothing was
        measured, and the newest family that maps the class answers. Masks of several
        classes may then be of several families: compare them with 0 only.
    profile : Profile
        ``carlasimu`` (as family ``paper-table1``): one colour per class.
    override : tag names and numbers, or None
        Replaces the class's own set.

    Raises
    ------
    ConfigError
        The override names a tag that the family does not have.
    """
    if family is None:
        return _mask_in_first_family(class_name, profile, override)
    palette = FAMILIES[family]
    if override is not None:
        return _mask_of_tags(tuple(override), palette, class_name)
    return _default_mask(canonical_class(class_name), family, profile)


@lru_cache(maxsize=1024)
def _default_mask(class_name: str, family: str, profile: Profile) -> int:
    palette = FAMILIES[family]
    if profile == "carlasimu" or family == "paper-table1":
        color = PUBLISHED_COLORS.get(class_name)
        return sum(1 << tag.tag for tag in palette.tags if tuple(tag.rgb) == color)
    names = _ACCEPT[family].get(class_name, ())
    return sum(1 << tag.tag for tag in palette.tags if tag.name in names)


def _mask_of_tags(tags: tuple[str | int, ...], palette: Palette, owner: str) -> int:
    numbers = {tag.name: tag.tag for tag in palette.tags}
    mask = 0
    for tag in tags:
        number = tag if isinstance(tag, int) else numbers.get(tag)
        if number is None or number not in numbers.values():
            raise ConfigError(
                f"classes.{owner}.accept: palette {palette.name} has no tag {tag!r}; "
                f"the nearest is {nearest(tag, numbers)!r}",
                pointer=f"/classes/{owner}/accept",
            )
        mask |= 1 << number
    return mask


def _mask_in_first_family(
    class_name: str, profile: Profile, override: Sequence[str | int] | None
) -> int:
    """The mask in the newest family that maps the class; 0 if none does.

    Tags of an override that a family does not have are passed over.
    """
    for family in ("carla-0.9.14", "carla-0.9.10", "carla-0.9.0", "paper-table1"):
        if override is None:
            mask = _default_mask(canonical_class(class_name), family, profile)
        else:
            family_tags = {
                key for tag in FAMILIES[family].tags for key in (tag.tag, tag.name)
            }
            tags = tuple(tag for tag in override if tag in family_tags)
            mask = _mask_of_tags(tags, FAMILIES[family], class_name)
        if mask:
            return mask
    return 0


def accepts(accept_mask: int | IntArray, tags: NDArray[np.integer]) -> BoolArray:
    """Whether accept masks accept tags; no other code interprets these masks.

    Bit t of `accept_mask` is set if tag t is accepted, as `accept_mask_of` gives it; it
    broadcasts to the shape of `tags`. The result is bool, of the shape that both have.
    Always False for Unknown and for every number beyond the last tag.
    """
    # No known tag has the bit of Unknown's column, so that all others may share it.
    bit = np.minimum(tags, UNKNOWN_COLUMN).astype(np.int64)
    mask = accept_mask & ((1 << UNKNOWN_COLUMN) - 1)
    return np.asarray(mask >> bit & 1, np.bool_)


@lru_cache(maxsize=1024)
def accepted_names(accept_mask: int, family: str) -> tuple[str, ...]:
    """The names of the tags in an accept set, in the order of their numbers.

    `accept_mask` is one of `accept_mask_of`, `family` a key of `FAMILIES`.
    """
    tags = FAMILIES[family].tags
    accepted = accepts(accept_mask, np.arange(len(tags)))
    return tuple(tags[number].name for number in np.flatnonzero(accepted))


MAX_ACCEPT: Final = 32
"""Tags in an accept set."""

_TAG_NAMES: Final = {
    tag.name.casefold(): tag.name
    for palette in FAMILIES.values()
    for tag in palette.tags
}


def canonical_accept(value: object, *, at: str = "") -> tuple[str | int, ...]:
    """A config's accept set: tag names and numbers, sorted, each of them once.

    `at` is the JSON pointer of the key. Raises `ConfigError`: not a list, or a tag that
    no palette has; names the nearest tag.
    """
    if not isinstance(value, list | tuple) or not 0 < len(value) <= MAX_ACCEPT:
        raise ConfigError(
            f"{prefix_of(at) or 'accept: '}expected a list of 1 to {MAX_ACCEPT} tag "
            f"names or numbers, found {shown(value)}",
            pointer=at,
        )
    tags = {_canonical_tag(tag, at) for tag in value}
    return tuple(sorted(tags, key=lambda tag: (isinstance(tag, int), tag)))


def _canonical_tag(tag: object, at: str) -> str | int:
    if isinstance(tag, int) and not isinstance(tag, bool):
        if 0 <= tag <= LAST_TAG:
            return tag
        fault = f"expected a tag from 0 to {LAST_TAG}, found {str(tag)[:60]}"
        raise ConfigError(f"{prefix_of(at) or 'accept: '}{fault}", pointer=at)
    return _canonical_name(tag, at, "accept: ")


def _canonical_name(tag: object, at: str, owner: str = "") -> str:
    if isinstance(tag, str) and tag.casefold() in _TAG_NAMES:
        return _TAG_NAMES[tag.casefold()]
    close = nearest(str(tag).casefold(), _TAG_NAMES)
    raise ConfigError(
        f"{prefix_of(at) or owner}unknown tag {str(tag)[:60]!r}; the nearest valid "
        f"name is {_TAG_NAMES[close]!r}",
        pointer=at,
    )


MAX_CHANGED_TAGS: Final = 64
"""Numbers and colours of a changed CARLA."""

_COLOR: Final = re.compile(r"#([0-9a-f]{6})", re.IGNORECASE)

_CHANNELS: Final = re.compile(r"[\[(]?\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*[\])]?")


def canonical_tags(value: object, *, at: str = "") -> dict[str, str]:
    """The tags of a changed CARLA: names by number and by colour, as ``#dc143c``.

    Parameters are those of `canonical_accept`. Raises `ConfigError`: not a mapping,
    neither a number up to 255 nor a colour, the same twice, or a tag that no palette
    has.
    """
    if not isinstance(value, Mapping) or len(value) > MAX_CHANGED_TAGS:
        raise ConfigError(
            f"{prefix_of(at) or 'tags: '}expected at most {MAX_CHANGED_TAGS} numbers "
            f"or colours, each with the name of a tag, found {shown(value)}",
            pointer=at,
        )
    tags: dict[str, str] = {}
    for raw_key, name in value.items():
        place = f"{at}/{pointer_token(raw_key)}"
        key = _canonical_value(raw_key, place)
        if key in tags:
            raise ConfigError(
                f"{prefix_of(at)}{key} is given twice; keep one", pointer=place
            )
        tags[key] = _canonical_name(name, place)
    # In one order, since equal configurations have equal digests.
    return dict(sorted(tags.items(), key=lambda item: (len(item[0]), item[0])))


def _canonical_value(value: object, at: str) -> str:
    text = str(value).strip() if isinstance(value, int | str) else ""
    if text.isdecimal() and int(text) <= _MAX_LEVEL:
        return str(int(text))
    if color := _COLOR.fullmatch(text):
        return f"#{color[1].lower()}"
    channels = _CHANNELS.fullmatch(text)
    if channels and all(int(level) <= _MAX_LEVEL for level in channels.groups()):
        return f"#{bytes(map(int, channels.groups())).hex()}"
    raise ConfigError(
        f"{prefix_of(at)}expected a number from 0 to {_MAX_LEVEL}, or a colour such as "
        f'"#dc143c" (in quotes) or [220, 20, 60], found {str(value)[:60]!r}',
        pointer=at,
    )


_MAX_LEVEL: Final = 255
