import pytest

from unghost.capture.scenario import Scenario, parse_scenario, read_scenario
from unghost.capture.simulator import ScenarioError

WRONG = [
    ("vehicles: {cuont: 5}", "vehicles.cuont: unknown key; .* is 'count'"),
    ("wether: {}", "wether: unknown key; the nearest valid key is 'weather'"),
    ("sensors: {lidra: true}", "sensors.lidra: .* is 'lidar'"),
    ("ego: {spawnpoint: 3}", "ego.spawnpoint: .* is 'spawn_point'"),
    ("camera: {mount: {X: 1}}", "camera.mount.X: .* is 'x'"),
    ("weather: {preset: ClearNon}", "weather.preset: .*'ClearNoon'"),
    ("weather: {presets: [WetNoon, WetNon]}", "weather.presets.1: .*'WetNoon'"),
    ("weather: {parameters: {fog_densty: 3}}", "fog_densty: .*'fog_density'"),
    (
        "weather: {sweep: {wetness: {first: 1, lst: 3}}}",
        "weather.sweep.wetness.lst: .* is 'last'",
    ),
    ("weather: {preset: WetNoon, presets: [WetNoon]}", "cannot be given together"),
    (
        "weather: {parameters: {wetness: 1}, sweep: {wetness: {first: 1, last: 3}}}",
        "wetness is in both parameters and sweep",
    ),
    ("vehicles: {lights: [LowBean]}", "vehicles.lights.0: .*'LowBeam'"),
    ("vehicles: {wheels: 3}", "vehicles.wheels: .* 2, 4 or 'all', found 3"),
    ("vehicles: {count: many}", "vehicles.count: .*found 'many'"),
    ("map_layers: {ParkedVehicle: false}", "ParkedVehicle: .*'ParkedVehicles'"),
    ("frames: true", "frames: true and false are not allowed here, found True"),
    ("vehicles: {generation: on}", "vehicles.generation: true and false are not"),
    ("camera: {mount: {x: yes}}", "camera.mount.x: true and false are not"),
    ("weather: {parameters: {wetness: on}}", "weather.parameters: true and false are"),
    ("boxes: {bands: [true, 50]}", "boxes.bands: true and false are not"),
    ("frames: 0", "frames: .*greater than or equal to 1, found 0"),
    ("delta_s: 0.2", "delta_s: .*less than or equal to 0.1, found 0.2"),
    ("interval_s: 0.01", "interval_s 0.01 is shorter than a tick"),
    ("warm_up_ticks: 3", "warm_up_ticks: .*greater than or equal to 10"),
    ("camera: {lens: {lens_kk: 1}}", "camera.lens.lens_kk: .*'lens_k'"),
    ("sensors: {rgb: {attributes: {fov: 3}}}", "the same for all cameras"),
    ("sensors: {depth: {attributes: {lens_k: 3}}}", "the same for all cameras"),
    ("sensors: {rgb: {attributes: {sensor_tick: 1}}}", "must stay 0"),
    ("sensors: {radar: {attributes: {sensor_tick: 1}}}", "must stay 0"),
    ("sensors: {rgb: false, segmentation: false}", "a frame needs rgb or segmentation"),
    ("boxes: {min_distance: 50, max_distance: 50}", "min_distance must be below"),
    ("boxes: {bands: [100, 50]}", "bands must rise"),
    ("{map: Town01, maps: [Town02]}", "map and maps cannot be given together"),
    ("maps: [Town01, /Game/Town01]", "maps: 'Town01' occurs twice"),
    ("frames: [", "cannot be read as YAML"),
    ("seed: 1\nframes: 5\nseed: 2", "'seed' occurs twice.*line 3"),
    ("host: " + "[" * 9 + "&a [x, x], *a" + "]" * 9, r"host: .*found \[\[.*\.\.\."),
    ("seed: 2026-13-45", "a value cannot be read"),
    ("seed: !!int many", "a value cannot be read"),
    ("interval_s: 1.0e+300", "interval_s: .*less than or equal to 86400"),
    ("sensor_wait_s: 1.0e+300", "sensor_wait_s: .*less than or equal to 3600"),
    ("timeout_s: 1.0e+300", "timeout_s: .*less than or equal to 3600"),
    ("- 1", "expected keys and values"),
    ("frames: .nan", "frames: "),
]


@pytest.mark.parametrize(("text", "words"), WRONG, ids=[text for text, _ in WRONG])
def test_invalid_scenario_raises_error_with_file_name_and_key(tmp_path, text, words):
    path = tmp_path / "street.yaml"
    path.write_text(text)

    with pytest.raises(ScenarioError, match=words) as told:
        read_scenario(path)

    assert str(told.value).startswith("street.yaml: ")


def test_yaml_may_have_anchors_and_merge_keys_or_be_empty(tmp_path):
    path = tmp_path / "street.yaml"
    path.write_text("""
        camera: {mount: &roof {x: 1, z: 2}}
        sensors: {radar: {mount: *roof}, lidar: {mount: {<<: *roof, z: 3}}}
    """)

    sensors = read_scenario(path).sensors

    assert sensors.radar is not None
    assert sensors.lidar is not None
    assert (sensors.radar.mount.z, sensors.lidar.mount.z) == (2, 3)
    path.write_text("")

    assert read_scenario(path) == Scenario()


def test_scenario_error_lists_all_faults():
    wrong = {"frames": 0, "vehicles": {"cuont": 1}, "sensors": {"lidra": True}}

    with pytest.raises(ScenarioError) as told:
        parse_scenario(wrong, "x.yaml")

    assert len(str(told.value).splitlines()) == 3


def test_sensors_are_enabled_by_true_or_by_settings():
    flare = {"attributes": {"lens_flare_intensity": 0.1}}  # of a single camera
    others = {"depth": True, "segmentation": False, "radar": {"mount": {"x": 2}}}

    sensors = parse_scenario({"sensors": {**others, "rgb": flare}}, "x").sensors

    assert sensors.rgb is not None
    assert sensors.depth is not None
    assert sensors.segmentation is None
    assert sensors.lidar is None
    assert sensors.radar is not None
    assert sensors.radar.mount.x == 2


@pytest.mark.parametrize(
    ("interval", "ticks", "is_exact"),
    [
        (0.05, 1, True),
        (0.1, 2, True),
        (0.15, 3, True),
        (1.0, 20, True),
        (0.12, 2, False),
    ],
)
def test_interval_is_rounded_to_ticks_and_that_is_put_in_words(
    interval, ticks, is_exact
):
    scenario = parse_scenario({"interval_s": interval, "delta_s": 0.05}, "x")

    assert scenario.ticks_per_frame == ticks
    words = (
        "interval_s 0.12 is not a whole number of ticks (delta_s 0.05): frames are "
        "0.1 s apart"
    )
    assert scenario.rounding == (None if is_exact else words)


def test_digest_covers_only_keys_that_recorded_frames_depend_on():
    plain = Scenario().digest
    # Otherwise a capture that an earlier version began could not be continued.
    assert plain == "a7ea7a787e4e648335a66dc1457c767205b899a01b1c08440424002b96d4fbde"
    assert parse_scenario({"host": "10.0.0.5", "frames": 9}, "x").digest == plain
    assert parse_scenario({"sensor_wait_s": 60, "timeout_s": 5}, "x").digest == plain
    assert parse_scenario({"seed": 1}, "x").digest != plain
    assert parse_scenario({"camera": {"fov": 91}}, "x").digest != plain
