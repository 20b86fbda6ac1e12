"""The plan of a capture, which `--dry-run` shows: for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from unghost.capture.rig import BLUEPRINTS, CAMERAS, recorded_sensors
from unghost.capture.scenario import Scenario

_BYTES_PER_PIXEL: Final[Mapping[str, float]] = {
    "rgb": 2.0,
    "segmentation": 0.05,
    "instances": 0.1,
    "depth": 2.2,
}
"""Of PNG files of streets, by order of magnitude."""
_BYTES_OF_POINTS: Final = {"lidar": 16, "semantic_lidar": 24, "radar": 28}
_USUAL_POINTS_PER_S: Final = {"lidar": 56_000, "semantic_lidar": 56_000, "radar": 1500}
_MOST_POINTS_PER_S: Final = 1e9


def plan_of(
    scenario: Scenario, output: Path, dataset: str | None
) -> tuple[list[tuple[str, str]], dict[str, object]]:
    """The plan of a capture: rows for people, a record for programs."""
    sensors = recorded_sensors(scenario)
    frames = scenario.all_frames
    seconds = frames * scenario.ticks_per_frame * scenario.delta_s
    starts = len(scenario.of_each_map)
    ticks = starts * scenario.warm_up_ticks + frames * scenario.ticks_per_frame
    size = sum(_bytes_of(scenario, name) for name in sensors) * frames
    camera, people = scenario.camera, scenario.walkers
    off = [name for name, is_on in scenario.map_layers.items() if not is_on]
    without = f" without {', '.join(off)}" if off else ""
    maps = ", ".join(scenario.maps) or scenario.map or "the one that is loaded"
    weather = scenario.weather
    words = [weather.preset] if weather.preset else []
    words += [", ".join(weather.presets)] if weather.presets else []
    words += [f"{name} {value:g}" for name, value in weather.parameters.items()]
    words += [
        f"{name} {sweep.first:g} to {sweep.last:g}"
        for name, sweep in weather.sweep.items()
    ]
    by_map = (
        f" ({len(scenario.maps)} maps x {scenario.frames})" if scenario.maps else ""
    )
    rules = scenario.boxes
    kinds = ("vehicles", "walkers", "parked_vehicles", "traffic_lights")
    named = [kind.replace("_", " ") for kind in kinds if getattr(rules, kind)]
    reach = f"{rules.min_distance:g} to {rules.max_distance:g} m"
    rows = [
        ("simulator", f"{scenario.host}:{scenario.port}"),
        ("map", f"{maps}{without}"),
        ("seed", str(scenario.seed)),
        ("weather", ", ".join(words) or "unchanged"),
        ("ego", scenario.ego.blueprint),
        ("vehicles", f"{scenario.vehicles.count} of {scenario.vehicles.filter}"),
        (
            "walkers",
            f"{people.standing} standing, {people.walking} walking, "
            f"{people.running} running",
        ),
        ("camera", f"{camera.width} x {camera.height} px, {camera.fov:g} degrees"),
        *((f"sensor {name}", BLUEPRINTS[name]) for name in sensors),
        ("boxes", f"{', '.join(named) or 'none'}, {reach}"),
        (
            "frames",
            f"{frames}{by_map}, one every {scenario.ticks_per_frame} ticks "
            f"of {scenario.delta_s:g} s: {seconds:g} s simulated",
        ),
        ("size", f"about {max(1, round(size / 1e6)):,} MB"),
        ("output", str(output)),
        *([("push to", dataset)] if dataset else []),
    ]
    record = {
        "scenario": scenario.model_dump(mode="json"),
        "digest": scenario.digest,
        "sensors": {name: BLUEPRINTS[name] for name in sensors},
        "ticks": ticks,
        "simulated_s": seconds,
        "bytes": round(size),
        "output": str(output),
        "dataset": dataset,
    }
    return rows, record


def _bytes_of(scenario: Scenario, name: str) -> float:
    if name in CAMERAS:
        pixels = scenario.camera.width * scenario.camera.height
        return pixels * _BYTES_PER_PIXEL[name]
    attributes = getattr(scenario.sensors, name).attributes
    try:
        rate = float(attributes["points_per_second"])
    except (KeyError, ValueError):  # the simulator refuses values that are no numbers
        rate = _USUAL_POINTS_PER_S[name]
    return min(rate, _MOST_POINTS_PER_S) * scenario.delta_s * _BYTES_OF_POINTS[name]
