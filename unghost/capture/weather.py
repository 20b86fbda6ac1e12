"""The weather of each frame: a preset, parameters, presets in turn, sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from unghost.capture.scenario import Scenario, Weather
from unghost.capture.session import CaptureSession
from unghost.capture.simulator import WEATHER_PARAMETERS, Carla

_DIGITS: Final = 6


def weather_numbers(weather: Weather, index: int, frames: int) -> dict[str, float]:
    """Parameters that frame `index`, of so many, sets on top of its preset."""
    share = index / (frames - 1) if frames > 1 else 0.0
    swept = {
        name: sweep.first + (sweep.last - sweep.first) * share
        for name, sweep in weather.sweep.items()
    }
    return {**weather.parameters, **swept}


def preset_of(weather: Weather, index: int) -> str | None:
    """The preset of a frame; None to keep the simulator's own weather."""
    if weather.presets:
        turn = index // weather.frames_per_preset
        return weather.presets[turn % len(weather.presets)]
    return weather.preset


class WeatherPlan:
    """Sets the weather of a session, frame by frame."""

    def __init__(self, session: CaptureSession) -> None:
        self._session = session
        self._before = session.world.get_weather()
        self._last: dict[str, float] | None = None
        self._preset: str | None = None
        before, world = self._before, session.world
        if session.scenario.weather.is_given:
            session.at_end("restore the weather", lambda: world.set_weather(before))

    def set(self, index: int) -> bool:
        """Set the weather of frame `index`; return whether the preset changed."""
        scenario: Scenario = self._session.scenario
        if not scenario.weather.is_given:
            return False
        carla, weather = self._session.carla, scenario.weather
        preset = preset_of(weather, index)
        presets = carla.WeatherParameters
        base = self._before if preset is None else getattr(presets, preset)
        changed = weather_numbers(weather, index, scenario.frames)
        numbers = {**as_numbers(base), **changed}
        if numbers == self._last:
            return False
        self._session.world.set_weather(parameters(carla, numbers))
        self._last = numbers
        previous, self._preset = self._preset, preset
        return previous != preset


def parameters(carla: Carla, numbers: Mapping[str, float]) -> object:
    """`carla.WeatherParameters` with these numbers."""
    weather = carla.WeatherParameters()
    for name, value in numbers.items():
        setattr(weather, name, float(value))
    return weather


def as_numbers(weather: object) -> dict[str, float]:
    """All parameters that the library's version has, by name."""
    return {
        name: round(float(getattr(weather, name)), _DIGITS)
        for name in WEATHER_PARAMETERS
        if hasattr(weather, name)
    }
