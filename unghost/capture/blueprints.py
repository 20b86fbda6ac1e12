"""Blueprints of the simulator: chosen, with attributes set, before anything spawns."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Final

from filter_core.values import nearest
from unghost.capture.scenario import AttributeValue, Generation, Wheels
from unghost.capture.simulator import Blueprint, ScenarioError, World

NUMBERS: Final = frozenset({"Int", "Float"})
"""Kinds of attributes whose text has to be a number."""


def find_blueprint(world: World, name: str, at: str) -> Blueprint:
    """One blueprint by its id; `ScenarioError` names the key and the nearest id."""
    library = world.get_blueprint_library()
    ids = [str(each.id) for each in library]
    if name not in ids:
        close = nearest(name, ids)
        raise ScenarioError(f"{at}: no blueprint {name!r}; the nearest is {close!r}")
    return library.find(name)


def choose_blueprints(
    world: World, pattern: str, generation: Generation, at: str
) -> list[Blueprint]:
    """The blueprints of a pattern and a generation, in the order of their ids.

    `ScenarioError` names the key if there are none.
    """
    blueprints = sorted(
        world.get_blueprint_library().filter(pattern), key=lambda b: b.id
    )
    if not blueprints:
        raise ScenarioError(f"{at}.filter: no blueprint matches {pattern!r}")
    if generation != "all":
        blueprints = [
            each for each in blueprints if _has_number(each, "generation", generation)
        ]
    if not blueprints:
        raise ScenarioError(
            f"{at}.generation: no blueprint of {pattern!r} is of generation "
            f"{generation}"
        )
    return blueprints


def with_wheels(
    blueprints: list[Blueprint], wheels: Wheels, at: str
) -> list[Blueprint]:
    """The blueprints with so many wheels; `ScenarioError` if there are none."""
    if wheels == "all":
        return blueprints
    chosen = [
        each for each in blueprints if _has_number(each, "number_of_wheels", wheels)
    ]
    if not chosen:
        raise ScenarioError(f"{at}.wheels: no blueprint has {wheels} wheels")
    return chosen


def set_attributes(
    blueprint: Blueprint, attributes: Mapping[str, AttributeValue], at: str
) -> None:
    """Set attributes by name.

    `ScenarioError` if the blueprint lacks one (names the nearest), or refuses a value.
    """
    for name, value in attributes.items():
        if not blueprint.has_attribute(name):
            names = [str(attribute.id) for attribute in blueprint]
            hint = f"; the nearest is {nearest(name, names)!r}" if names else ""
            raise ScenarioError(f"{at}.{name}: {blueprint.id} has no such key{hint}")
        kind = str(blueprint.get_attribute(name).type.name)
        try:
            blueprint.set_attribute(name, _as_text(value, kind))
        except (RuntimeError, ValueError) as error:
            raise ScenarioError(f"{at}.{name}: {error}, found {value!r}") from error


def _as_text(value: AttributeValue, kind: str) -> str:
    """A value as text; checked, because CARLA reads ``10 m`` as 10 and ``far`` as 0."""
    if kind not in NUMBERS:
        return str(value).lower() if isinstance(value, bool) else str(value)
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except ValueError:
        number = math.nan
    whole = kind == "Int"
    if not math.isfinite(number) or (whole and not number.is_integer()):
        raise ValueError(f"expected a {'whole ' if whole else ''}number")
    return str(int(number)) if whole else str(number)


def randomise(blueprint: Blueprint, dice: random.Random) -> None:
    """A colour and a driver of those that the blueprint recommends."""
    for name in ("color", "driver_id"):
        if blueprint.has_attribute(name):
            offered = blueprint.get_attribute(name).recommended_values
            if offered:
                blueprint.set_attribute(name, dice.choice(list(offered)))


def _has_number(blueprint: Blueprint, name: str, value: int) -> bool:
    # CARLA does not return numbers as text.
    has = blueprint.has_attribute(name)
    return bool(has and int(blueprint.get_attribute(name).as_int()) == value)
