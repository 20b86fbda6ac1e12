"""The class of a box, and the tags whose pixels match that class.

`class_of` returns the class of a CARLA actor by its blueprint. `accept_mask_of` returns
the tags that a class accepts in a tag family, as bits; only `accepts` tests such a
mask. `canonical_accept` checks the accept set of a configuration, which replaces it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.errors import ConfigError
from filter_core.segmentation.palettes import (
    FAMILIES,
    LAST_TAG,
    PUBLISHED_COLORS,
    Palette,
)
from filter_core.types import UNKNOWN_COLUMN, BoolArray, IntArray, Profile
from filter_core.values import nearest, place_of, shown

_ALIASES: Final = {"street_light": "traffic_light"}
"""Other names under which a class is known."""

_VEHICLES: Final = {
    "car": """
        audi.a2 audi.etron audi.tt bmw.grandtourer chevrolet.impala citroen.c3
        dodge.charger_2020 dodge.charger_police dodge.charger_police_2020
        ford.crown ford.mustang jeep.wrangler_rubicon lincoln.mkz_2017
        lincoln.mkz_2020 mercedes.coupe mercedes.coupe_2020 micro.microlino
        mini.cooper_s mini.cooper_s_2021 nissan.micra nissan.patrol
        nissan.patrol_2021 seat.leon tesla.model3 toyota.prius
    """,
    "truck": """
        carlamotors.carlacola carlamotors.european_hgv carlamotors.firetruck
        tesla.cybertruck
    """,
    "van": """
        ford.ambulance mercedes.sprinter volkswagen.t2 volkswagen.t2_2021
    """,
    "bus": """
        mitsubishi.fusorosa
    """,
    "motorcycle": """
        harley-davidson.low_rider kawasaki.ninja vespa.zx125 yamaha.yzf
    """,
    "bicycle": """
        bh.crossbike diamondback.century gazelle.omafiets
    """,
}

BLUEPRINT_CLASS: Final = {
    f"vehicle.{name}": base_type
    for base_type, names in _VEHICLES.items()
    for name in names.split()
}
"""CARLA's vehicle blueprints and the class of each."""

_BASE_TYPES: Final = frozenset(_VEHICLES)

_PREFIXES: Final = (("walker.", "walker"), ("traffic.traffic_light", "traffic_light"))


def canonical_class(name: str) -> str:
    """The canonical name of a class, from that name or an alias."""
    return _ALIASES.get(name, name)


def class_of(type_id: str | None, base_type: str | None) -> str | None:
    """The class of a CARLA actor, or None if nothing maps it.

    Parameters
    ----------
    type_id : str or None
        Blueprint, such as ``vehicle.audi.tt``: looked up in CARLA's catalogue.
    base_type : str or None
        The actor's own attribute, for blueprints that the catalogue does not have. If
        it names no class either, ``walker.*`` and ``traffic.traffic_light*`` map by
        their beginning; any other blueprint is not guessed at.
    """
    blueprint = type_id or ""
    if blueprint in BLUEPRINT_CLASS:
        return BLUEPRINT_CLASS[blueprint]
    if base_type in _BASE_TYPES:
        return base_type
    for prefix, name in _PREFIXES:
        if blueprint.startswith(prefix):
            return name
    return None


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

_ACCEPT_BEFORE: Final = {
    **dict.fromkeys(("car", "truck", "van", "bus", "vehicle"), ("Vehicle",)),
    **dict.fromkeys(("motorcycle", "bicycle"), ("Vehicle", "Pedestrian")),
    "walker": ("Pedestrian",),
}

_ACCEPT: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "carla-0.9.14": _ACCEPT_SINCE_0_9_14,
    "carla-0.9.10": {**_ACCEPT_BEFORE, "traffic_light": ("TrafficLight",)},
    "carla-0.9.0": _ACCEPT_BEFORE,
}

CLASSES: Final = tuple(_ACCEPT_SINCE_0_9_14)
"""The filter's own classes, in the order in which they are listed."""


def accept_mask_of(
    class_name: str,
    family: str | None,
    profile: Profile = "paper",
    override: Sequence[str | int] | None = None,
) -> int:
    """The tags whose pixels count for a class, as bits: bit t is set for tag t.

    Parameters
    ----------
    class_name : str
        Aliases are understood.
    family : str or None
        A key of `filter_core.segmentation.palettes.FAMILIES`. None: nothing was
        measured, so only whether the class is mapped matters; the newest family that
        maps it answers.
    profile : Profile
        ``carlasimu`` (as family ``paper-table1``): one colour per class.
    override : tag names and numbers, or None
        Replaces the class's own set.

    Returns
    -------
    int
        0 if the class is not mapped.

    Raises
    ------
    ConfigError
        The override names a tag that the family does not have.
    """
    if family is None:
        return _mask_in_any_family(class_name, profile, override)
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
    numbers = {one.name: one.tag for one in palette.tags}
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


def _mask_in_any_family(
    class_name: str, profile: Profile, override: Sequence[str | int] | None
) -> int:
    for family in ("carla-0.9.14", "carla-0.9.10", "carla-0.9.0", "paper-table1"):
        if override is None:
            mask = _default_mask(canonical_class(class_name), family, profile)
        else:
            known = {
                key for tag in FAMILIES[family].tags for key in (tag.tag, tag.name)
            }
            tags = tuple(tag for tag in override if tag in known)
            mask = _mask_of_tags(tags, FAMILIES[family], class_name)
        if mask:
            return mask
    return 0


def accepts(accept_mask: int | IntArray, tags: NDArray[np.integer]) -> BoolArray:
    """Whether accept masks accept tags; no other code interprets these masks.

    Parameters
    ----------
    accept_mask : int, or an array of int64
        Bit t is set if tag t is accepted, as `accept_mask_of` gives it.
    tags : array of integers from 0
        In a shape to which `accept_mask` broadcasts.

    Returns
    -------
    bool, of the shape that both broadcast to
        Always False for Unknown and for every number beyond the last tag.
    """
    # No known tag has the bit of Unknown's column, so that all others may share it.
    bit = np.minimum(tags, UNKNOWN_COLUMN).astype(np.int64)
    known = accept_mask & ((1 << UNKNOWN_COLUMN) - 1)
    return np.asarray(known >> bit & 1, np.bool_)


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

    Parameters
    ----------
    value : object
        As a file or a request has it.
    at : str
        JSON pointer of the key.

    Raises
    ------
    ConfigError
        Not a list, or a tag that no palette has; names the nearest tag.
    """
    if not isinstance(value, list | tuple) or not 0 < len(value) <= MAX_ACCEPT:
        raise ConfigError(
            f"{place_of(at) or 'accept: '}expected a list of 1 to {MAX_ACCEPT} tag "
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
    elif isinstance(tag, str) and tag.casefold() in _TAG_NAMES:
        return _TAG_NAMES[tag.casefold()]
    else:
        close = nearest(str(tag).casefold(), _TAG_NAMES)
        fault = (
            f"unknown tag {str(tag)[:60]!r}; the nearest valid name is "
            f"{_TAG_NAMES[close]!r}"
        )
    raise ConfigError(f"{place_of(at) or 'accept: '}{fault}", pointer=at)
