from __future__ import annotations

import pytest

from unghost.capture.scenario import Sweep, Weather
from unghost.capture.weather import preset_of, weather_numbers


@pytest.mark.parametrize(("index", "angle"), [(0, 70), (5, 45), (10, 20)])
def test_sweep_is_linear_from_first_frame_to_last(index, angle):
    weather = Weather(
        parameters={"wetness": 4},
        sweep={"sun_altitude_angle": Sweep(first=70, last=20)},
    )

    numbers = weather_numbers(weather, index, 11)

    assert numbers == {"wetness": 4, "sun_altitude_angle": pytest.approx(angle)}


def test_sweep_over_one_frame_has_its_first_value():
    weather = Weather(sweep={"wetness": Sweep(first=7, last=20)})

    assert weather_numbers(weather, 0, 1) == {"wetness": 7}


def test_weather_presets_alternate_every_frames_per_preset():
    weather = Weather(presets=("WetNoon", "ClearNoon"), frames_per_preset=2)

    turns = [preset_of(weather, index) for index in range(6)]

    assert turns == ["WetNoon"] * 2 + ["ClearNoon"] * 2 + ["WetNoon"] * 2


def test_weather_without_settings_has_no_preset():
    assert not Weather().is_given
    assert preset_of(Weather(), 3) is None
    assert Weather(parameters={"wetness": 0}).is_given
