"""Runs one capture, from the first tick to the last frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Final

from unghost.capture.annotating import Annotator, Moment
from unghost.capture.folder import CaptureFolder, encode
from unghost.capture.rig import (
    Missed,
    RunningSensor,
    collect,
    drain,
    prepare_rig,
    start_rig,
)
from unghost.capture.scenario import Scenario
from unghost.capture.session import (
    CaptureSession,
    Note,
    StopRequest,
    listening_for_stop,
    open_session,
)
from unghost.capture.simulator import (
    CaptureError,
    Carla,
    Client,
    SimulatorAway,
    WorldSnapshot,
    answers,
    connect,
    has_wrong_metadata,
)
from unghost.capture.traffic import choose_traffic, spawn
from unghost.capture.weather import WeatherPlan

Advance = Callable[[int, "int | None"], None]

_MOST_MISSED: Final = 20
"""Ticks in a row without a complete frame that end the capture."""
_SETTLING_TICKS: Final = 10
"""Ticks that the exposure of the cameras needs after a change of the preset."""
_STILL_THERE_S: Final = 5.0
_ANOTHER_CLIENT: Final = "another client ticked the world"


@dataclass
class Recorded:
    """The counts of a capture.

    Attributes
    ----------
    frames : int
        In the folder, those of earlier captures included.
    added : int
    missed : Counter
        Ticks that could not be recorded, by reason.
    left_out : Counter
        Objects that got no box in a frame, by reason.
    vehicles, walkers : int
        Spawned; fewer than asked for if the map had no room.
    poses_differ : int
        Frames whose image had another camera pose than the snapshot.
    """

    frames: int = 0
    added: int = 0
    missed: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    vehicles: int = 0
    walkers: int = 0
    poses_differ: int = 0

    def as_dict(self) -> dict[str, object]:
        """The counts as an object."""
        plain: dict[str, object] = {**vars(self)}
        return {**plain, "missed": dict(self.missed), "left_out": dict(self.left_out)}


@dataclass(frozen=True)
class Request:
    """The scenario, the folder to record to, and callbacks for progress."""

    scenario: Scenario
    output: Path
    note: Note
    advance: Advance


def record(carla: Carla, request: Request) -> Recorded:
    """Record a scenario's frames that the folder does not have yet.

    Raises
    ------
    CaptureError
        The scenario does not fit the simulator, or frames stay incomplete.
    SimulatorAway
        No simulator answers, or it stops answering.
    KeyboardInterrupt
        A stop was requested; recorded frames are complete, and the same call
        continues.
    """
    scenario = request.scenario
    client = connect(carla, scenario.host, scenario.port, scenario.timeout_s)
    try:
        return _record(carla, client, request)
    except RuntimeError as error:
        # The library's only class of errors, for time-outs, occupied places and so on.
        if not answers(client, min(scenario.timeout_s, _STILL_THERE_S)):
            raise SimulatorAway(
                f"lost the connection to the simulator: {error}"
            ) from error
        raise CaptureError(f"the simulator reported: {error}") from error


def _record(carla: Carla, client: Client, request: Request) -> Recorded:
    scenario = request.scenario
    with (
        listening_for_stop() as stop,
        open_session(carla, client, scenario, request.note) as session,
    ):
        _compare_versions(session)
        folder = CaptureFolder(request.output)
        folder.open(_about(session))
        recorded = Recorded(frames=len(folder.keys))
        try:
            if recorded.frames < scenario.frames:
                _Recorder(session, folder, recorded, stop).run(request.advance)
        finally:
            folder.describe({**_about(session), "last": recorded.as_dict()})
    # A signal after the last frame, while the simulator was restored, counts too.
    stop.check()
    return recorded


def _compare_versions(session: CaptureSession) -> None:
    if session.server_version != session.client_version:
        session.note(
            f"the simulator is CARLA {session.server_version}, the client library "
            f"{session.client_version}: install the same version for both"
        )


def _about(session: CaptureSession) -> dict[str, object]:
    return {
        "unghost": metadata.version("unghost"),
        "carla_version": session.server_version,
        "client_version": session.client_version,
        "map": session.map_name,
        "scenario_digest": session.scenario.digest,
        "scenario": session.scenario.model_dump(mode="json"),
    }


class _Recorder:
    """The loop: ticks, waits for all sensors, writes; counts what was missed."""

    def __init__(
        self,
        session: CaptureSession,
        folder: CaptureFolder,
        recorded: Recorded,
        stop: StopRequest,
    ) -> None:
        self._session, self._folder = session, folder
        self._recorded, self._stop = recorded, stop
        self._sensors: list[RunningSensor] = []
        self._last: WorldSnapshot | None = None

    def run(self, advance: Advance) -> None:
        """Do everything: choose, spawn, warm up, record."""
        session, scenario = self._session, self._session.scenario
        before = self._recorded.frames
        session.seed += before
        # All of it is checked before any of it is spawned.
        kinds, rig = choose_traffic(session), prepare_rig(session)
        weather = WeatherPlan(session)
        weather.set(self._recorded.frames)
        spawned = spawn(session, kinds, self._stop)
        self._recorded.vehicles = spawned.vehicles
        self._recorded.walkers = spawned.walkers
        self._sensors = start_rig(session, rig, spawned.ego)
        self._wait(scenario.warm_up_ticks)
        annotator = Annotator(session, spawned.ego, self._sensors)
        self._recorded.left_out = annotator.left_out
        advance(0, scenario.frames - before)
        with ThreadPoolExecutor(len(self._sensors)) as encoders:
            while self._recorded.frames < scenario.frames:
                moment = self._shoot()
                self._store(annotator, moment, encoders)
                advance(self._recorded.added, scenario.frames - before)
                if self._recorded.frames < scenario.frames:
                    changed = weather.set(self._recorded.frames)
                    least = _SETTLING_TICKS if changed else 0
                    self._wait(max(self._ticks_between, least))

    @property
    def _ticks_between(self) -> int:
        """Ticks between two frames that are not used for either."""
        used = 2 if has_wrong_metadata(self._session.server_version) else 1
        return max(0, self._session.scenario.ticks_per_frame - used)

    def _wait(self, ticks: int) -> None:
        """Tick so many times without recording."""
        for _ in range(ticks):
            self._stop.check()
            self._last = self._session.tick()
            drain(self._sensors)

    def _shoot(self) -> Moment:
        """The moment of the next tick that all sensors measured."""
        missed: Counter[str] = Counter()
        while missed.total() < _MOST_MISSED:
            self._stop.check()
            found = self._try_tick()
            if isinstance(found, Moment):
                return found
            missed[str(found)] += 1
            self._recorded.missed[str(found)] += 1
            drain(self._sensors)
        reason, count = missed.most_common(1)[0]
        raise CaptureError(
            f"no complete frame in {_MOST_MISSED} ticks, {count} times because {reason}"
        )

    def _try_tick(self) -> Moment | Missed:
        session, scenario = self._session, self._session.scenario
        before, snapshot = self._last, session.tick()
        self._last = snapshot
        if snapshot is None:
            return Missed(_ANOTHER_CLIENT)
        wait_s, check = scenario.sensor_wait_s, self._stop.check
        found = collect(self._sensors, session.frame, wait_s, check=check)
        if isinstance(found, Missed):
            return found
        if not has_wrong_metadata(session.server_version):
            return Moment(snapshot, found)
        self._last = after = session.tick()
        drain(self._sensors)
        return Moment(snapshot, found, before, after)

    def _store(
        self, annotator: Annotator, moment: Moment, encoders: ThreadPoolExecutor
    ) -> None:
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        frame = annotator.annotate(
            moment,
            captured_at=now.replace("+00:00", "Z"),
            missed_before=self._recorded.missed.total(),
        )
        measured = moment.measured
        encoded = encoders.map(encode, measured.keys(), measured.values())
        # The scenario is in it: captures of one map may go into one dataset.
        take = f"{self._session.map_name}/{self._session.scenario.digest[:8]}"
        key = f"{take}/{len(self._folder.keys):06d}"
        self._folder.add(key, dict(zip(measured, encoded, strict=True)), frame)
        if annotator.poses_differ and not self._recorded.poses_differ:
            self._session.note(
                "an image has another camera pose than the world; both are stored"
            )
        self._recorded.poses_differ = annotator.poses_differ
        self._recorded.added += 1
        self._recorded.frames += 1
