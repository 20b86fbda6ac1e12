"""The classes that names mean: those of labels, and those of CARLA's blueprints.

`class_meant_by` has the vocabulary of labels, `class_of` CARLA's catalogue of
blueprints.

Nobody's labels have to be renamed before they are filtered: KITTI's ``Pedestrian``,
COCO's ``person`` and CARLA's ``walker.pedestrian.0012`` are all a ``walker``. A name
only says as what a box is measured; it goes out as it came in.

Names are compared without case and without what separates words (``_``, ``-``, ``.``,
spaces). A name that is not in the vocabulary means nothing: no guess is made.

References
----------
.. [1] CARLA 0.9.0 to 0.10: ``carla.CityObjectLabel``, the tags of its segmentation
   camera, and the catalogues of vehicle blueprints (older ones: 0.9.0 to 0.9.11).
.. [2] KITTI object detection, development kit, ``readme.txt``: types of objects.
.. [3] COCO 2017 and PASCAL VOC 2012: lists of categories.
.. [4] Cityscapes, ``cityscapesScripts/helpers/labels.py``.
.. [5] nuScenes: ``category.json``.
.. [6] BDD100K: categories of object detection.
.. [7] Open Images V7: boxable classes of streets.
.. [8] Public Roboflow exports of CARLA pictures, with their spellings.
"""

from __future__ import annotations

import re
from difflib import SequenceMatcher
from functools import lru_cache
from typing import Final

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
"""Beginnings of blueprints that name the class."""


def canonical_class(name: str) -> str:
    """The canonical name of a class, from that name or an alias."""
    return _ALIASES.get(name, name)


def class_of(type_id: str | None, base_type: str | None) -> str | None:
    """The class of a CARLA actor, by its blueprint, or None if nothing maps it.

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


_NAMES: Final = {
    "car": """
        car cars automobile passenger_car sedan suv hatchback coupe convertible jeep
        taxi cab limousine station_wagon minivan police_car golf_cart
        vehicle_car vehicle_taxi vehicle_emergency_police
        bmw_isetta dodge_charger_police dodge_charger dodgecop_charger mustang_mustang
        lincoln_mkz2017 lincoln_mkz lincoln2020_mkz2020 mercedes_benz_coupe
        mercedesccc_mercedesccc mini_cooperst mini_cooper charger2020_charger2020
        chargercop2020_chargercop2020 tesla_model3_2020 taxi_ford
        ue4_audi_tt ue4_bmw_grantourer ue4_bmw_grandtourer ue4_chevrolet_impala
        ue4_ford_crown ue4_ford_mustang ue4_mercedes_ccc
    """,
    "truck": """
        truck trucks lorry lorries pickup pickup_truck semi semi_truck fire_truck
        firetruck box_truck heavy_truck vehicle_truck
        carlacola_actors firetruck_actors
    """,
    "van": """
        van vans delivery_van vehicle_van ambulance vehicle_emergency_ambulance
        ambulance_ford sprinter_mercedes
    """,
    "bus": """
        bus buses busses coach minibus school_bus vehicle_bus vehicle_bus_bendy
        vehicle_bus_rigid fuso_mitsubishi
    """,
    "motorcycle": """
        motorcycle motorcycles motorbike motorbikes motobike motobikes motor_bike
        motor motors motor_cycle motor_scooter moped scooter motorcyclist
        vehicle_motorcycle vehicle_motorbike harley_davidson_lowrider
    """,
    "bicycle": """
        bicycle bicycles bike bikes cycle push_bike cyclist cyclists bicyclist
        vehicle_bicycle vehicle_bike
    """,
    "walker": """
        walker walkers pedestrian pedestrians person persons people human humans
        person_sitting pedestrian_sitting man woman boy girl child
        human_pedestrian human_pedestrian_adult human_pedestrian_child
        human_pedestrian_construction_worker human_pedestrian_police_officer
        human_pedestrian_wheelchair human_pedestrian_stroller
        human_pedestrian_personal_mobility walker_pedestrian
    """,
    "traffic_light": """
        traffic_light traffic_lights traffic_signal traffic_signals stoplight
        stop_light street_light street_lights traffic_traffic_light trafficlights
    """,
    "vehicle": "vehicle vehicles",
    "rider": "rider riders",
    "train": "train trains tram trams streetcar vehicle_train on_rails",
    "traffic_sign": """
        traffic_sign traffic_signs road_sign road_signs stop_sign stop_signs yield_sign
        speed_limit speed_limit_sign street_sign traffic_stop traffic_yield
        traffic_speed_limit trafficsigns
    """,
    "building": "building buildings",
    "fence": "fence fences",
    "pole": "pole poles",
    "road_line": "road_line road_lines roadline roadlines lane_marking",
    "road": "road roads",
    "sidewalk": "sidewalk sidewalks pavement",
    "vegetation": "vegetation",
    "wall": "wall walls",
    "sky": "sky",
    "ground": "ground",
    "bridge": "bridge bridges",
    "rail_track": "rail_track rail_tracks railtrack",
    "guard_rail": "guard_rail guard_rails guardrail guardrails",
    "static": "static",
    "dynamic": "dynamic",
    "water": "water",
    "terrain": "terrain",
    "rock": "rock rocks",
}
"""By class: what it is called, with ``_`` between words."""

_STATES: Final = {
    "traffic_light": {
        *("red", "green", "yellow", "orange", "amber", "off", "on", "unknown"),
        *("go", "stop", "warning", "left", "right", "straight", "forward"),
    },
    "traffic_sign": {"stop", "yield", "speed", "limit"},
}
"""Words that say in which state or of which kind an object is: a
``traffic_light_red`` is a traffic light, and a ``traffic_sign_30`` a traffic sign."""

_WORD: Final = re.compile(r"[^\W\d_]+|\d+")

_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")

_MEANING: Final = {
    name.replace("_", ""): class_name
    for class_name, names in _NAMES.items()
    for name in names.split()
}


@lru_cache(maxsize=4096)
def class_meant_by(name: str) -> str | None:
    """The class that a name of labels means, such as ``traffic light``.

    The name may also be a blueprint's, such as ``vehicle.tesla.model3``. One of
    `filter_core.classes.MEASURED_CLASSES`; None if the vocabulary does not have it.
    """
    if class_name := class_of(name, None):
        return class_name
    words = [word.casefold() for word in _WORD.findall(_CAMEL.sub(" ", name))]
    meaning = _meaning_of(words)
    if meaning is None and words[:1] == ["vehicle"]:
        vehicle = _meaning_of(words[1:])  # such as vehicle.bmw.isetta
        return vehicle if vehicle in _VEHICLES else None
    return meaning


def _meaning_of(words: list[str]) -> str | None:
    plain = "".join(words)
    if plain in _MEANING:
        return _MEANING[plain]
    for class_name, states in _STATES.items():
        named = _MEANING.get("".join(words[:2])) == class_name
        if named and all(word in states or word.isdigit() for word in words[2:]):
            return class_name
    return None


_MOST_EDITS: Final = 2
"""Letters of a long word that a typing error changes; never the first one."""

_LONG: Final = 8
"""Letters of a long word; in a shorter one, only one letter may be wrong."""

_SHORT: Final = 5
"""In words of so few letters, another letter makes another word, such as bush, cart."""

_FEWEST: Final = 4
"""Letters of a word that lacks one."""

_REPEATED: Final = re.compile(r"(.)\1+")


def misspelt_class(name: str) -> str | None:
    """The class whose name this one probably misspells, for a hint; None if unclear.

    Only names that differ by a typing error: a ``traffic_cone`` is no traffic light.
    """
    plain = "".join(word.casefold() for word in _WORD.findall(name))
    once = _REPEATED.sub(r"\1", plain)
    for spelling, meaning in _MEANING.items():
        if _REPEATED.sub(r"\1", spelling) == once:
            return meaning
        lacks_one = len(plain) + 1 == len(spelling) and len(plain) >= _FEWEST
        if lacks_one and plain in (
            spelling[:at] + spelling[at + 1 :] for at in range(len(spelling))
        ):
            return meaning
    if len(plain) <= _SHORT:
        return None
    allowed = _MOST_EDITS if len(plain) >= _LONG else 1
    edits = {
        spelling: _edits(plain, spelling)
        for spelling in _MEANING
        if len(spelling) > _SHORT
        and spelling[0] == plain[0]
        and abs(len(spelling) - len(plain)) <= allowed
    }
    close = min(edits, key=edits.__getitem__, default=None)
    return _MEANING[close] if close is not None and edits[close] <= allowed else None


def _edits(word: str, spelling: str) -> int:
    """How many letters have to be changed, added or removed to make one the other."""
    steps = SequenceMatcher(None, word, spelling, autojunk=False).get_opcodes()
    return sum(
        max(end - start, spelling_end - spelling_start)
        for kind, start, end, spelling_start, spelling_end in steps
        if kind != "equal"
    )
