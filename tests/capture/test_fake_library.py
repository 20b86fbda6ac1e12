"""The fake of CARLA's library has the names and signatures of the real one.

The protocols that the product's types use are compared with it, too.
"""

import inspect
import re

import carla
import pytest

from tests.support.fake_carla.library import FAKES
from unghost.capture import simulator as known
from unghost.capture.blueprints import NUMBERS
from unghost.capture.rig import BLUEPRINTS
from unghost.capture.simulator import (
    MAP_LAYERS,
    VEHICLE_LIGHTS,
    WEATHER_PARAMETERS,
    WEATHER_PRESETS,
)

# Names that the fakes have for the tests alone, and that the real library lacks.
ADDED_NAMES = {
    *("kind", "pose", "solid", "receive", "heads", "autopilot", "light_state"),
    *("speed", "walking", "attributes", "shared", "solids", "true_pose"),
}


def public(thing):
    """The public names of a class or an object."""
    fields = getattr(thing, "__dataclass_fields__", {})
    return {name for name in {*dir(thing), *fields} if not name.startswith("_")}


OPERATORS = ("__iter__", "__len__", "__getitem__")
"""Methods behind `for` and `[0]`; the library's docstrings do not describe them."""
PROTOCOLS = {
    known.Vector: ("Location", "Vector3D"),
    known.Turn: ("Rotation",),
    known.Pose: ("Transform",),
    known.Box: ("BoundingBox",),
    known.Attribute: ("ActorAttribute",),
    known.Blueprint: ("ActorBlueprint",),
    known.BlueprintLibrary: ("BlueprintLibrary",),
    known.Actor: ("Actor",),
    known.Vehicle: ("Vehicle",),
    known.WalkerController: ("WalkerAIController",),
    known.TrafficLight: ("TrafficLight",),
    known.Sensor: ("Sensor",),
    known.Measurement: ("SensorData",),
    known.Image: ("Image",),
    known.PointCloud: ("LidarMeasurement", "SemanticLidarMeasurement"),
    known.Detection: ("RadarDetection",),
    known.RadarScan: ("RadarMeasurement",),
    known.ActorList: ("ActorList",),
    known.ActorSnapshot: ("ActorSnapshot",),
    known.Timestamp: ("Timestamp",),
    known.WorldSnapshot: ("WorldSnapshot",),
    known.EnvironmentObject: ("EnvironmentObject",),
    known.Settings: ("WorldSettings",),
    known.Map: ("Map",),
    known.World: ("World",),
    known.GlassWorld: ("World",),
    known.TrafficManager: ("TrafficManager",),
    known.Client: ("Client",),
}
"""Each protocol, with the names of the library's classes that it describes."""
METHODS = [
    (name, method)
    for name, cls in FAKES.items()
    for method in sorted(public(cls) - ADDED_NAMES)
    if inspect.isfunction(getattr(cls, method, None))
]


@pytest.mark.parametrize(
    ("protocol", "name"),
    [(protocol, name) for protocol, names in PROTOCOLS.items() for name in names],
)
def test_real_class_has_every_member_of_its_protocol(protocol, name):
    members = {*vars(protocol), *getattr(protocol, "__annotations__", {})}
    used = {member for member in members if not member.startswith("_")}
    used |= members & {*OPERATORS}

    assert used
    assert used <= set(dir(getattr(carla, name)))


def test_every_class_protocol_is_compared_with_its_class():
    described = {
        value
        for value in vars(known).values()
        if getattr(value, "_is_protocol", False) and value.__module__ == known.__name__
    }
    by_hand = {
        *(known.AttributeType, known.AttachmentTypes, known.Labels, known.Commands),
        *(known.Carla, known.Response),
    }

    assert described - by_hand == {*PROTOCOLS}


def test_module_and_enumerations_have_every_member_of_their_protocols():
    assert set(known.Carla.__annotations__) <= set(dir(carla))
    assert set(known.AttachmentTypes.__annotations__) <= set(dir(carla.AttachmentType))
    assert set(known.Labels.__annotations__) <= set(dir(carla.CityObjectLabel))
    assert set(known.Commands.__annotations__) <= set(dir(carla.command))
    assert "error" in dir(carla.command.Response)
    assert "name" in dir(carla.ActorAttributeType)


@pytest.mark.parametrize(
    ("kind", "own"),
    [
        (known.Vehicle, "Vehicle"),
        (known.WalkerController, "WalkerAIController"),
        (known.TrafficLight, "TrafficLight"),
        (known.Sensor, "Sensor"),
    ],
)
def test_actor_protocol_matches_only_its_own_class(kind, own):
    names = ("Vehicle", "Walker", "WalkerAIController", "TrafficLight", "Sensor")

    assert [name for name in names if issubclass(getattr(carla, name), kind)] == [own]
    assert [name for name in names if issubclass(FAKES[name], kind)] == [own]


def test_attribute_types_have_the_names_of_the_library():
    assert set(carla.ActorAttributeType.names) >= {*NUMBERS, "Bool", "String"}


@pytest.mark.parametrize(("name", "method"), METHODS)
def test_fake_methods_have_the_parameters_of_the_real_methods(name, method):
    real = parameters(getattr(getattr(carla, name), method).__doc__, method)
    fake = [
        (parameter.name, parameter.default is not inspect.Parameter.empty)
        for parameter in inspect.signature(
            getattr(FAKES[name], method)
        ).parameters.values()
    ][1:]

    assert fake == real


def test_fake_client_has_the_constructor_parameters_of_the_real_client():
    real = parameters(carla.Client.__init__.__doc__, "__init__")
    fake = inspect.signature(FAKES["Client"]).parameters.values()

    assert [(p.name, p.default is not p.empty) for p in fake] == real


def parameters(documentation, method):
    """(name, is optional) of each parameter without `self`.

    They are read from the docstring that Boost.Python gives the library's methods.
    """
    line = next(
        line for line in documentation.splitlines() if line.startswith(f"{method}(")
    )
    inside = line[line.index("(") + 1 : line.rindex(") ->")]
    required, _, optional = inside.partition("[")
    names = [(name, False) for name in re.findall(r"\(\w+\)(\w+)", required)]
    return names[1:] + [(name, True) for name in re.findall(r"\(\w+\)(\w+)", optional)]


def test_scenario_presets_lights_and_layers_match_the_library():
    weather = carla.WeatherParameters
    presets = {n for n in dir(weather) if isinstance(getattr(weather, n), weather)}

    assert set(WEATHER_PRESETS) == presets
    assert set(WEATHER_PARAMETERS) == public(weather) - presets
    assert {*VEHICLE_LIGHTS, "NONE"} == set(carla.VehicleLightState.names)
    assert {*MAP_LAYERS, "NONE"} == set(carla.MapLayer.names)
    assert len(set(BLUEPRINTS.values())) == len(BLUEPRINTS)
