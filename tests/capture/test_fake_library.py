"""The fake cannot drift: names and signatures are those of the real library."""

from __future__ import annotations

import inspect
import re

import carla
import pytest

from tests.capture.fake_carla.library import FAKES, VALUES
from unghost.capture.blueprints import NUMBERS
from unghost.capture.carla_words import (
    MAP_LAYERS,
    VEHICLE_LIGHTS,
    WEATHER_PARAMETERS,
    WEATHER_PRESETS,
)
from unghost.capture.rig import BLUEPRINTS

# What the fakes have for the tests alone, beside what the library has.
OWN = {
    *("kind", "pose", "solid", "receive", "heads", "autopilot", "light_state"),
    *("speed", "walking", "attributes", "shared", "solids", "true_pose"),
}


def public(thing):
    """Names that a class or an object offers."""
    fields = getattr(thing, "__dataclass_fields__", {})
    return {name for name in {*dir(thing), *fields} if not name.startswith("_")}


PROTOCOLS = ("__iter__", "__len__", "__getitem__")
"""What makes a `for` and a `[0]` work; the library's texts say nothing of them."""
METHODS = [
    (name, method)
    for name, cls in FAKES.items()
    for method in sorted(public(cls) - OWN)
    if inspect.isfunction(getattr(cls, method, None))
]


@pytest.mark.parametrize("name", FAKES)
def test_the_real_class_has_everything_the_fake_has(name):
    assert public(FAKES[name]) - OWN <= set(dir(getattr(carla, name)))


@pytest.mark.parametrize("name", FAKES)
def test_what_the_fake_lets_one_go_through_the_library_does_as_well(name):
    offered = {one for one in PROTOCOLS if hasattr(FAKES[name], one)}

    assert offered <= {one for one in PROTOCOLS if hasattr(getattr(carla, name), one)}


def test_kinds_of_attributes_are_named_as_the_library_names_them():
    assert set(carla.ActorAttributeType.names) >= {*NUMBERS, "Bool", "String"}


def test_real_actors_have_everything_that_fake_actors_have(stage):
    for type_id in ("vehicle.x", "walker.x", "controller.x", "sensor.x"):
        actor = stage.simulator.add(type_id, {}, carla.Transform())

        real = getattr(carla, type(actor).__name__)

        # A sensor has no box until 0.9.16, where every actor has one.
        assert public(actor) - OWN - {"bounding_box"} <= set(dir(real))


@pytest.mark.parametrize(("name", "method"), METHODS)
def test_methods_take_what_the_real_ones_take(name, method):
    real = parameters(getattr(getattr(carla, name), method).__doc__, method)
    fake = [
        (parameter.name, parameter.default is not inspect.Parameter.empty)
        for parameter in inspect.signature(
            getattr(FAKES[name], method)
        ).parameters.values()
    ][1:]

    assert fake == real


def test_the_client_is_made_as_the_real_one():
    real = parameters(carla.Client.__init__.__doc__, "__init__")
    fake = inspect.signature(FAKES["Client"]).parameters.values()

    assert [(p.name, p.default is not p.empty) for p in fake] == real


def parameters(documentation, method):
    """(name, is optional) of each parameter but the object, from Boost's text."""
    line = next(
        line for line in documentation.splitlines() if line.startswith(f"{method}(")
    )
    inside = line[line.index("(") + 1 : line.rindex(") ->")]
    required, _, optional = inside.partition("[")
    names = [(found, False) for found in re.findall(r"\(\w+\)(\w+)", required)]
    return names[1:] + [
        (found, True) for found in re.findall(r"\(\w+\)(\w+)", optional)
    ]


def test_values_come_from_the_real_library():
    assert set(VALUES) <= set(dir(carla))


def test_the_words_of_scenarios_are_the_librarys():
    weather = carla.WeatherParameters
    presets = {n for n in dir(weather) if isinstance(getattr(weather, n), weather)}

    assert set(WEATHER_PRESETS) == presets
    assert set(WEATHER_PARAMETERS) == public(weather) - presets
    assert {*VEHICLE_LIGHTS, "NONE"} == set(carla.VehicleLightState.names)
    assert {*MAP_LAYERS, "NONE"} == set(carla.MapLayer.names)
    assert len(set(BLUEPRINTS.values())) == len(BLUEPRINTS)
