"""A fake simulator in place of CARLA's.

A test can compare its state after a capture with its state before.
"""

import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.fake_carla.scenarios import scenario

if importlib.util.find_spec("carla") is None:
    # Without CARLA's client library, which not every machine can install, no test of
    # this folder can run.
    collect_ignore_glob = ["test_*.py"]
else:
    from tests.support.fake_carla.library import as_library
    from tests.support.fake_carla.simulator import Simulator
    from tests.support.fake_carla.street import street

from unghost.capture.recording import Recorded, Request, record


class Stage:
    """A fake simulator, its state at the beginning, and a folder to record into."""

    def __init__(self, simulator: Simulator, folder: Path) -> None:
        self.simulator, self.folder = simulator, folder
        self.notes: list[str] = []
        self._before = self._state()

    def _state(self) -> dict[str, Any]:
        server = self.simulator
        return {
            "actors": sorted(server.actors),
            "synchronous": server.settings.synchronous_mode,
            "delta": server.settings.fixed_delta_seconds,
            "weather": str(server.weather),
            "layers_off": list(server.layers_off),
            "managers": [p for p, on in server.managers_synchronous.items() if on],
        }

    def capture(self, **changes: Any) -> Recorded:
        """Record the small scenario, with these keys changed."""
        request = Request(
            scenario(**changes), self.folder, self.notes.append, lambda *_: None
        )
        return record(as_library(self.simulator), request)

    def frames(self) -> list[dict[str, Any]]:
        """The frames that the recorded manifest lists."""
        text = (self.folder / "manifest.jsonl").read_text("utf-8")
        return [json.loads(line) for line in text.splitlines()]

    def left_behind(self) -> dict[str, Any]:
        """What of the simulator's state differs from the beginning, by name."""
        now = self._state()
        return {k: v for k, v in now.items() if v != self._before[k]}


MakeStage = Callable[..., Stage]


@contextmanager
def stages(place: Path) -> Iterator[MakeStage]:
    """Yield a maker of stages, each with its own simulator, which is closed at the end.

    They record into new folders in `place`.
    """
    made: list[Stage] = []

    def make(version: str = "0.9.16", client_version: str | None = None) -> Stage:
        folder = place / f"captured{len(made)}"
        made.append(Stage(street(version, client_version), folder))
        return made[-1]

    yield make
    for stage in made:
        stage.simulator.close()


@pytest.fixture
def make_stage(tmp_path: Path) -> Iterator[MakeStage]:
    """Makes stages for one test."""
    with stages(tmp_path) as make:
        yield make


@pytest.fixture(scope="module")
def make_shared_stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MakeStage]:
    """Makes stages that tests of a module share, and therefore leave as they are."""
    with stages(tmp_path_factory.mktemp("shared")) as make:
        yield make


@pytest.fixture
def stage(make_stage: MakeStage) -> Stage:
    """A stage whose simulator is a street on CARLA 0.9.16."""
    return make_stage()


@pytest.fixture
def as_carla(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> Stage:
    """The stage, whose fake library replaces the module `carla` during the test."""
    monkeypatch.setitem(sys.modules, "carla", as_library(stage.simulator))
    return stage
