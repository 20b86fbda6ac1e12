from typing import Any

import pytest
import yaml

from unghost.capture.carlasimu import convert_carlasimu, scenario_text
from unghost.capture.scenario import parse_scenario
from unghost.capture.simulator import ScenarioError

CAMERA = {
    "fov": 100.0,
    "image_size_x": 640,
    "image_size_y": 360,
    "sensor_tick": 0.0,
    "lens_k": -1.0,
    "location": [1.2, 2.1],
}
FILES: dict[str, dict[str, Any]] = {
    "data.yaml": {
        "host": "10.0.0.9", "port": 2002, "tm_port": 8002, "hybrid": True,
        "safe": False, "filterv": "vehicle.*", "number_of_wheels": "4",
        "generationv": "All", "generationw": "2", "number_of_vehicles": 42,
        "number_of_walkers": {"stand": 1, "walk": 2, "run": 3},
        "light_state": {"ALL": False, "Fog": True, "LowBeam": True},
        "seed": None, "seedw": 5, "set_timeout": 12.0, "fixed_delta_seconds": 0.04,
        "asynch": False, "synchronous": True, "respawn": True, "wait_for_tick": 10,
    },
    "sensors.yaml": {
        "rgb_camera": {**CAMERA, "iso": 90.0, "lens_flare_intensity": 0.2},
        "semantic_segmentation_camera": CAMERA,
        "lidar_sensor": {"range": 30.0, "sensor_tick": 0.0, "location": [0.5, 2.2]},
        "radar_sensor": {"points_per_second": 900, "location": [2.0, 1.0]},
    },
    "weather.yaml": {"fog_density": 7, "wetness": 0},
    "mapLayer.yaml": {"building": False, "ParkedVehicles": True},
    "boundingBox.yaml": {
        "cam_rgb": {
            "save_to_file": True, "max_distance": 60, "min_distance": 2,
            "actors": {"vehicles": True, "walkers": False}, "num_image": 77,
        },
        "image_segmentation": {"save_to_file": True},
        "lidar_sensor": {"save_to_file": True},
        "radar_sensor": {"save_to_file": False},
        "threshold_small_box": 10, "time_screen_shot": 2,
    },
    "vehicles_name.yaml": {
        "car": ["vehicle.audi.a2"], "lorry": ["vehicle.carlamotors.carlacola"],
    },
    "color_segmentation.yaml": {"car": [142, 0, 0]},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """A folder with the seven configuration files of carlasimu."""
    for name, content in FILES.items():
        write_config_file(tmp_path, name, content)
    return tmp_path


def write_config_file(folder, name, content):
    (folder / name).write_text(yaml.safe_dump({"sitting": content}))


def test_seven_carlasimu_files_are_converted_to_one_scenario(folder):
    converted, notes = convert_carlasimu(folder)

    scenario = parse_scenario(yaml.safe_load(scenario_text(converted, notes)), "x")
    assert (scenario.host, scenario.port, scenario.timeout_s) == ("10.0.0.9", 2002, 12)
    assert (scenario.delta_s, scenario.interval_s, scenario.frames) == (0.04, 2, 77)
    assert (scenario.seed, scenario.walkers.seed) == (0, 5)
    assert scenario.traffic_manager.port == 8002
    assert (scenario.vehicles.count, scenario.vehicles.wheels) == (42, 4)
    assert set(scenario.vehicles.lights) == {"LowBeam", "Fog"}
    people = scenario.walkers
    assert (people.standing, people.walking, people.running) == (1, 2, 3)
    assert people.generation == 2
    assert scenario.weather.parameters == {"fog_density": 7, "wetness": 0}
    assert scenario.map_layers == {"Buildings": False}
    boxes = scenario.boxes
    assert (boxes.vehicles, boxes.walkers, boxes.parked_vehicles) == (1, 0, 0)
    # Its distances do not limit what is recorded, and it labels every traffic light.
    assert (boxes.min_distance, boxes.max_distance) == (0, 200)
    assert boxes.traffic_lights
    assert scenario.classes == {"vehicle.carlamotors.carlacola": "lorry"}
    lines = scenario_text(converted, notes).splitlines()
    comments = "\n".join(line for line in lines if line.startswith("#"))
    for words in ("thresholds", "color_segmentation.yaml"):
        assert words in comments
    assert "keys that are not used: wait_for_tick" in comments
    # `safe` leaves out the two blueprints that its code does.
    write_config_file(folder, "data.yaml", {**FILES["data.yaml"], "safe": True})
    safe, _ = convert_carlasimu(folder)
    vehicles = parse_scenario(safe, "x").vehicles
    assert (vehicles.exclude, vehicles.safe) == (("*carlacola", "*firetruck"), False)


def test_converted_sensors_keep_attributes_and_mounts(folder):
    converted, _ = convert_carlasimu(folder)
    scenario = parse_scenario(converted, "x")

    camera, sensors = scenario.camera, scenario.sensors
    assert (camera.width, camera.height, camera.fov) == (640, 360, 100)
    assert (camera.mount.x, camera.mount.z) == (1.2, 2.1)
    assert camera.lens == {"lens_k": -1.0}
    assert sensors.rgb is not None
    assert sensors.rgb.attributes == {"iso": 90.0, "lens_flare_intensity": 0.2}
    assert sensors.lidar is not None
    assert sensors.lidar.attributes == {"range": 30.0}
    assert (sensors.lidar.mount.x, sensors.lidar.mount.z) == (0.5, 2.2)
    assert sensors.radar is None  # not saved there either


BOMB = "&a0 [x]" + "".join(
    f", &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 8)
)


LONG_TEXT = f"&a {'x' * 1000}" + ", *a" * 3000
LONG_PAIRS = f"!!pairs [a: &a {'x' * 1000}" + ", a: *a" * 3000 + "]"


@pytest.mark.parametrize("aliases", [BOMB, "&a [*a]", LONG_TEXT, LONG_PAIRS])
@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("data.yaml", "generationv: [{}]"),
        ("vehicles_name.yaml", "car: [{}]"),
        ("weather.yaml", "fog_density: [{}]"),
    ],
)
def test_aliases_for_too_many_values_are_refused(tmp_path, name, line, aliases):
    # Written out, nine levels of ten are ten gigabytes.
    (tmp_path / name).write_text(f"sitting: {{{line.format(aliases)}}}")

    with pytest.raises(ScenarioError, match="aliases that stand for more than") as told:
        convert_carlasimu(tmp_path)

    assert len(str(told.value)) < 200


def test_few_aliases_are_read(tmp_path):
    (tmp_path / "sensors.yaml").write_text(
        "sitting: {rgb_camera: &camera {fov: 100.0}, depth_camera: *camera}"
    )

    converted, _ = convert_carlasimu(tmp_path)

    assert converted["camera"] == {"fov": 100.0}


NO_SEGMENTATION = {"image_segmentation": {"save_to_file": False}}
OTHER_CAMERA = {"rgb_camera": CAMERA, "depth_camera": {**CAMERA, "fov": 60}}
UNUSED = {"cam_rgb": {"3D": False, "save_dir": "x"}, "lidar_sensor": {"save_dir": "y"}}


@pytest.mark.parametrize(
    ("sensors", "saved", "words"),
    [
        (OTHER_CAMERA, {}, "depth_camera differs"),
        ({}, UNUSED, "boundingBox.yaml: keys that are not used: save_dir, 3D"),
        ({}, NO_SEGMENTATION, "the segmentation is recorded all the same"),
        ({"semantic_lidar": {"range": 9}}, {}, "semantic_lidar is not recorded"),
    ],
)
def test_what_is_recorded_otherwise_is_noted(tmp_path, sensors, saved, words):
    write_config_file(tmp_path, "sensors.yaml", sensors)
    write_config_file(tmp_path, "boundingBox.yaml", saved)

    converted, notes = convert_carlasimu(tmp_path)

    assert any(words in note for note in notes)
    assert parse_scenario(converted, "x").sensors.segmentation is not None


def test_empty_values_leave_what_the_simulator_has(tmp_path):
    write_config_file(tmp_path, "weather.yaml", {"fog_density": 3, "wetness": None})
    write_config_file(
        tmp_path, "sensors.yaml", {"rgb_camera": {"fov": 80, "iso": None}}
    )

    converted, _ = convert_carlasimu(tmp_path)

    assert converted["weather"] == {"parameters": {"fog_density": 3.0}}
    assert converted["camera"] == {"fov": 80}
    assert converted["sensors"] == {"rgb": {"attributes": {}}}
    sensors = {"rgb_camera": None, "radar_sensor": {"fov": 30}}
    write_config_file(tmp_path, "sensors.yaml", sensors)

    converted, _ = convert_carlasimu(tmp_path)
    scenario = parse_scenario(converted, "x")

    assert scenario.camera.width == 1280
    assert scenario.sensors.radar is not None
    assert scenario.sensors.radar.attributes == {"fov": 30}


WRONG = [
    ("data.yaml", {"number_of_vehicle": 3}, "is 'number_of_vehicles'"),
    ("data.yaml", {"light_state": {"LowBean": True}}, "nearest is 'LowBeam'"),
    ("data.yaml", {"number_of_walkers": {"jog": 1}}, "number_of_walkers: jog"),
    ("sensors.yaml", {"rgb_cam": {}}, "is 'rgb_camera'"),
    ("sensors.yaml", {"rgb_camera": {"location": [1]}}, "expected x and z"),
    ("mapLayer.yaml", {"buildings": True}, "is 'building"),
    ("boundingBox.yaml", {"treshold": 3}, "is 'threshold"),
    ("weather.yaml", {"fog": 3}, "weather.yaml: weather.parameters.fog: .*'fog_"),
    ("weather.yaml", {"fog_density": "dense"}, "fog_density: expected a number"),
    ("weather.yaml", {3: 3}, "weather.parameters.3: unknown"),
    ("data.yaml", {"light_state": ["Fog"]}, "light_state: expected keys and values"),
    ("data.yaml", {"number_of_walkers": 3}, "number_of_walkers: expected keys and"),
    ("data.yaml", {"number_of_vehicles": -3}, "data.yaml: vehicles.count: .*found -3"),
    ("data.yaml", {"number_of_wheels": "four"}, "data.yaml: vehicles.wheels: "),
    ("sensors.yaml", {"rgb_camera": 3}, "rgb_camera: expected keys and values"),
    ("sensors.yaml", {"rgb_camera": {"location": ["a", 1]}}, "location: expected a nu"),
    ("boundingBox.yaml", {"cam_rgb": 3}, "cam_rgb: expected keys and values"),
    ("boundingBox.yaml", {"cam_rgb": {"actors": 3}}, "cam_rgb.actors: expected keys"),
    ("vehicles_name.yaml", {"car": "vehicle.audi.a2"}, "car: expected a list"),
    ("vehicles_name.yaml", {"car": ["a.b"], "van": ["a.b"]}, "a.b is in both car and"),
    ("boundingBox.yaml", {"cam_rgb": {"max_distanse": 9}}, "is 'max_distance'"),
    ("boundingBox.yaml", {"cam_rgb": {"actors": {"walker": 1}}}, "is 'walkers'"),
    ("boundingBox.yaml", {"lidar_sensor": {"save_to_fil": True}}, "is 'save_to_file'"),
    ("boundingBox.yaml", {"lidar_sensor": {"num_image": 3}}, "num_image: unknown key"),
    (
        "boundingBox.yaml",
        {"lidar_sensor": {"save_to_file": "often"}},
        "lidar_sensor: save_to_file: expected true or false, found 'often'",
    ),
    ("data.yaml", {"light_state": {"Fog": 3}}, "light_state: Fog: expected true or"),
    ("data.yaml", {"synchronous": "maybe"}, "synchronous: expected true or false"),
    ("mapLayer.yaml", {"building": []}, "building: expected true or false"),
]


@pytest.mark.parametrize(("name", "content", "words"), WRONG)
def test_invalid_setting_raises_scenario_error_that_names_it(
    tmp_path, name, content, words
):
    write_config_file(tmp_path, name, content)

    with pytest.raises(ScenarioError, match=f"(?i){words}"):
        convert_carlasimu(tmp_path)


def test_truth_values_in_words_are_read_as_the_scenario_reads_them(tmp_path):
    write_config_file(tmp_path, "mapLayer.yaml", {"building": "off"})
    write_config_file(
        tmp_path, "data.yaml", {"light_state": {"Fog": "off", "LowBeam": "on"}}
    )

    converted, _ = convert_carlasimu(tmp_path)
    scenario = parse_scenario(converted, "x")

    assert scenario.map_layers == {"Buildings": False}
    assert scenario.vehicles.lights == ("LowBeam",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sitting: {port: 1}\nsetting: {port: 2}", r"data\.yaml: setting: unknown key"),
        ("host: 127.0.0.1", "expected keys under 'sitting'"),
        (None, r"at least one of data\.yaml"),
    ],
)
def test_file_of_another_form_or_no_file_raises_scenario_error(tmp_path, text, words):
    if text is not None:
        (tmp_path / "data.yaml").write_text(text)

    with pytest.raises(ScenarioError, match=words):
        convert_carlasimu(tmp_path)
