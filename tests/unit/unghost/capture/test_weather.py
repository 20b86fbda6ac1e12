import pytest

from unghost.capture.scenario import Sweep, Weather
from unghost.capture.weather import preset_of, weather_numbers


@pytest.mark.parametrize(
    ("index", "count", "angle"), [(0, 11, 70), (5, 11, 45), (10, 11, 20), (0, 1, 70)]
)
def test_sweep_is_linear_from_first_frame_to_last(index, count, angle):
    weather = Weather(
        parameters={"wetness": 4},
        sweep={"sun_altitude_angle": Sweep(first=70, last=20)},
    )

    numbers = weather_numbers(weather, index, count)

    assert numbers == {"wetness": 4, "sun_altitude_angle": pytest.approx(angle)}


def test_weather_presets_alternate_every_frames_per_preset():
    weather = Weather(presets=("WetNoon", "ClearNoon"), frames_per_preset=2)

    turns = [preset_of(weather, index) for index in range(6)]

    assert turns == ["WetNoon"] * 2 + ["ClearNoon"] * 2 + ["WetNoon"] * 2
    assert not Weather().is_given
    assert preset_of(Weather(), 3) is None
    assert Weather(parameters={"wetness": 0}).is_given
