"""Runs one capture, from the first tick to the last frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError
from filter_core.pipeline import FrameResult
from unghost.capture.annotating import Annotator, Moment
from unghost.capture.folder import CaptureFolder, FrameRecord, encode
from unghost.capture.live import decide_tick
from unghost.capture.rig import (
    Missed,
    RunningSensor,
    collect,
    drain,
    first_complete,
    prepare_rig,
    start_rig,
)
from unghost.capture.scenario import Scenario, short_name
from unghost.capture.session import (
    CaptureSession,
    Note,
    StopRequest,
    listening_for_stop,
    open_session,
    require_maps,
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
from unghost.capture.traffic import Traffic
from unghost.capture.weather import WeatherPlan, preset_of

Advance = Callable[[int, "int | None"], None]

_SETTLING_TICKS: Final = 10
"""Ticks that the exposure of the cameras needs after a change of the preset."""
_STILL_THERE_S: Final = 5.0
_ANOTHER_CLIENT: Final = "another client ticked the world"


@dataclass
class Recorded:
    """The counts of a capture.

    `frames` are those in the folder, those of earlier captures included, `added` the
    new ones; `undecided` of these could not be decided, and `decided` counts their
    boxes by verdict. `missed` are ticks that could not be recorded and `left_out`
    objects without a box in a frame, by reason. `vehicles` and `walkers` were spawned,
    fewer than asked for if the map had no room. Of `poses_differ` frames the image had
    another camera pose than the snapshot. `tally` is of the whole folder, at the end;
    see `CaptureFolder.tally`.
    """

    frames: int = 0
    added: int = 0
    missed: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    vehicles: int = 0
    walkers: int = 0
    poses_differ: int = 0
    decided: Counter[str] = field(default_factory=Counter)
    undecided: int = 0
    tally: dict[str, dict[str, dict[str, int]]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """The counts as an object."""
        plain: dict[str, object] = {**vars(self)}
        counters = {
            name: dict(v) for name, v in plain.items() if isinstance(v, Counter)
        }
        return {**plain, **counters}


class StoredTick(NamedTuple):
    """A frame that was recorded, its files by kind, and its boxes, if decided."""

    key: str
    record: FrameRecord
    files: Mapping[str, Path]
    result: FrameResult | None


@dataclass(frozen=True)
class Request:
    """The scenario, the folder to record to, and callbacks for progress.

    `stored` is called with each frame, whose boxes are decided by `config`.
    """

    scenario: Scenario
    output: Path
    note: Note
    advance: Advance
    config: FilterConfig = field(default_factory=FilterConfig)
    stored: Callable[[StoredTick], None] = lambda _: None


def record(carla: Carla, request: Request) -> Recorded:
    """Record a scenario's frames that the folder does not have yet.

    Raises `CaptureError`: the scenario does not fit the simulator, or frames stay
    incomplete.
    Raises `SimulatorAway`: no simulator answers, or it stops answering.
    Raises `KeyboardInterrupt`: a stop was requested; recorded frames are complete, and
    the same call continues.
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
    recorded, folder = Recorded(), CaptureFolder(request.output)
    if scenario.maps:
        require_maps(client, scenario)
        folder.open(_about(client, scenario, list(map(short_name, scenario.maps))))
    with listening_for_stop() as stop:
        for part in scenario.of_each_map:
            stop.check()
            if (
                scenario.maps
                and folder.count_of(short_name(str(part.map))) >= part.frames
            ):
                continue
            with open_session(carla, client, part, request.note) as session:
                about = _about(client, scenario, session.map_name)
                if scenario.maps:
                    about["map"] = list(map(short_name, scenario.maps))
                else:
                    folder.open(about)
                if session.server_version != session.client_version:
                    session.note(
                        f"the simulator is CARLA {session.server_version}, the client "
                        f"library {session.client_version}: install the same version "
                        "for both"
                    )
                recorded.frames = len(folder.keys)
                try:
                    recorder = _Recorder(session, folder, recorded, stop, request)
                    recorder.run(request.advance, scenario.all_frames)
                finally:
                    folder.describe({**about, "last": recorded.as_dict()})
            # A signal while the simulator was restored counts too.
            stop.check()
    recorded.frames = len(folder.keys)
    recorded.tally = folder.tally()
    return recorded


def _about(
    client: Client, scenario: Scenario, maps: str | list[str]
) -> dict[str, object]:
    return {
        "unghost": metadata.version("unghost"),
        "carla_version": client.get_server_version(),
        "client_version": client.get_client_version(),
        "map": maps,
        "scenario_digest": scenario.digest,
        "scenario": scenario.model_dump(mode="json"),
    }


class _Recorder:
    """The loop: ticks, waits for all sensors, writes; counts what was missed."""

    def __init__(
        self,
        session: CaptureSession,
        folder: CaptureFolder,
        recorded: Recorded,
        stop: StopRequest,
        request: Request,
    ) -> None:
        self._request = request
        self._session, self._folder = session, folder
        self._recorded, self._stop = recorded, stop
        self._take = f"{session.map_name}/{request.scenario.digest[:8]}"
        self._of_map = folder.count_of(session.map_name)
        self._sensors: list[RunningSensor] = []
        self._last: WorldSnapshot | None = None

    def run(self, advance: Advance, all_frames: int) -> None:
        """Do everything: choose, spawn, warm up, record; unless it is all recorded.

        `all_frames` are those of all maps.
        """
        session, scenario = self._session, self._session.scenario
        if self._of_map >= scenario.frames:
            return
        left = all_frames - self._recorded.frames + self._recorded.added
        session.seed += self._of_map
        # All of it is checked before any of it is spawned.
        traffic, rig = Traffic(session), prepare_rig(session)
        weather = WeatherPlan(session)
        weather.set(self._of_map)
        ego, vehicles, walkers = traffic.spawn(self._stop)
        self._recorded.vehicles += vehicles
        self._recorded.walkers += walkers
        self._sensors = start_rig(session, rig, ego)
        self._wait(scenario.warm_up_ticks)
        annotator = Annotator(
            session,
            ego,
            self._sensors,
            self._recorded.left_out,
            self._recorded.poses_differ,
        )
        advance(self._recorded.added, left)
        with ThreadPoolExecutor(len(self._sensors)) as encoders:
            while self._of_map < scenario.frames:
                moment = first_complete(self._try_tick, self._recorded.missed)
                self._store(annotator, moment, encoders)
                advance(self._recorded.added, left)
                if self._of_map < scenario.frames:
                    changed = weather.set(self._of_map)
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

    def _try_tick(self) -> Moment | Missed:
        self._stop.check()
        session, scenario = self._session, self._session.scenario
        before, snapshot = self._last, session.tick()
        self._last = snapshot
        if snapshot is None:
            drain(self._sensors)
            return Missed(_ANOTHER_CLIENT)
        wait_s, check = scenario.sensor_wait_s, self._stop.check
        outcome = collect(self._sensors, session.frame, wait_s, check=check)
        if isinstance(outcome, Missed):
            drain(self._sensors)
            return outcome
        if not has_wrong_metadata(session.server_version):
            return Moment(snapshot, outcome)
        self._last = after = session.tick()
        drain(self._sensors)
        return Moment(snapshot, outcome, before, after)

    def _store(
        self, annotator: Annotator, moment: Moment, encoders: ThreadPoolExecutor
    ) -> None:
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        frame = annotator.annotate(
            moment,
            captured_at=now.replace("+00:00", "Z"),
            missed_before=self._recorded.missed.total(),
            preset=preset_of(self._session.scenario.weather, self._of_map),
        )
        measured = moment.measured
        encoded = encoders.map(encode, measured.keys(), measured.values())
        # The scenario is in it: captures of one map may go into one dataset.
        key = f"{self._take}/{self._of_map:06d}"
        files = dict(zip(measured, encoded, strict=True))
        result = None
        try:
            points = files["semantic_lidar"][1] if "semantic_lidar" in files else None
            config = self._request.config
            result = decide_tick(config, key, frame, measured, points)
        except FilterError as error:
            if not self._recorded.undecided:
                self._session.note(f"{key}: its boxes are not decided: {error}")
            self._recorded.undecided += 1
        else:
            self._recorded.decided.update(
                decision["verdict"] for decision in result.decisions
            )
        paths = self._folder.add(key, files, frame)
        self._request.stored(StoredTick(key, frame, paths, result))
        if annotator.poses_differ and not self._recorded.poses_differ:
            self._session.note(
                "an image has another camera pose than the world; both are stored"
            )
        self._recorded.poses_differ = annotator.poses_differ
        self._recorded.added += 1
        self._recorded.frames += 1
        self._of_map += 1
