"""A small scenario for captures of the fake street."""

from typing import Any

from unghost.capture.scenario import Scenario, parse_scenario

SMALL: dict[str, Any] = {
    "frames": 3,
    "delta_s": 0.05,
    "interval_s": 0.1,
    "warm_up_ticks": 10,
    "sensor_wait_s": 60.0,
    "ego": {"spawn_point": 0, "autopilot": False},
    "camera": {"width": 160, "height": 96},
    "vehicles": {"count": 4, "filter": "vehicle.tesla.*"},
    "walkers": {"standing": 2},
}


def scenario(**changes: Any) -> Scenario:
    """Parse the small scenario with these keys changed."""
    return parse_scenario({**SMALL, **changes}, "test.yaml")
