"""Clean boxes while a simulation runs: `live` in a script of one's own.

The simulation stays the script's: nothing is spawned, moved or set. `decide_tick` is
also what `unghost capture` decides with while it records.
"""

from __future__ import annotations

import queue
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.decisions.record import Decision
from filter_core.pipeline import FrameOptions, FrameResult, filter_frame
from filter_core.values import nearest
from unghost.capture.annotating import Annotator, Moment
from unghost.capture.folder import MANIFEST_KEYS, FrameRecord, encode, pixels_of
from unghost.capture.rig import (
    BLUEPRINTS,
    CAMERAS,
    Missed,
    RunningSensor,
    collect,
    drain,
    first_complete,
    main_camera,
)
from unghost.capture.scenario import parse_scenario, short_name
from unghost.capture.session import Scene
from unghost.capture.simulator import (
    Actor,
    CaptureError,
    Measurement,
    Sensor,
    World,
    WorldSnapshot,
    as_image,
    load_carla,
)

Drop = Literal["nothing", "oldest"]

_PICTURES: Final = ("depth", "instances")
"""Cameras besides the segmentation whose pixels are evidence."""
_POINTS: Final = "semantic_lidar"
_RED: Final = 2


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Options of `live`.

    `boxes` are as the key ``boxes`` of a scenario: which objects get boxes. `ego` is
    the vehicle without a box, by default the parent of the camera; `version` that of
    the simulator, by default that of the client library.

    `drop` says what happens to ticks that come while a frame is decided: they wait, or
    all but the newest are dropped and counted. `ticks`: the world is ticked here; None:
    in synchronous mode, if there is no `on_frame`. Sensors may take `wait_s` seconds
    for a tick, and the simulation for the next one.
    """

    boxes: Mapping[str, object] = field(default_factory=dict)
    ego: Actor | None = None
    version: str | None = None
    drop: Drop = "nothing"
    ticks: bool | None = None
    wait_s: float = 10.0


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One tick with its boxes, decided; `tick` is the simulator's number of it.

    `image` is that of the camera ``rgb``, (H, W, 3) uint8: blue, green, red, as OpenCV
    has them; None if there is no such camera. `record` is the annotation of the frame:
    camera, map, weather and all boxes.
    """

    tick: int
    image: NDArray[np.uint8] | None
    record: FrameRecord
    result: FrameResult

    @property
    def decisions(self) -> Sequence[Decision]:
        """All boxes with verdict and reason, in the order of the record."""
        return self.result.decisions

    @property
    def boxes(self) -> list[Decision]:
        """The clean boxes: those that are kept."""
        return [
            decision for decision in self.decisions if decision["verdict"] == "kept"
        ]

    def _repr_html_(self) -> str:
        return self.result._repr_html_()  # what notebooks call


def decide_tick(
    config: FilterConfig,
    key: str,
    record: FrameRecord,
    measured: Mapping[str, Measurement],
    points: bytes | None,
) -> FrameResult:
    """Decide the boxes of one tick, from the pixels of its measurements.

    `key` is the frame's name in explanations and errors, `points` the file of the
    semantic LiDAR, as `unghost.capture.folder.encode` makes it.
    """
    tags = None
    if "segmentation" in measured:
        pixels = pixels_of(as_image(measured["segmentation"]))
        tags = np.asarray(cv2.extractChannel(pixels, _RED), np.uint8)
    pictures = {name: _colors(measured[name]) for name in _PICTURES if name in measured}
    files = {} if points is None else {MANIFEST_KEYS[_POINTS]: points}
    options = FrameOptions(key=key, sensors=files, pixels=pictures)
    return filter_frame(record, tags, config, options)


def _colors(measured: Measurement) -> NDArray[np.uint8]:
    """(H, W, 3): blue, green and red of an image, in memory of their own."""
    pixels = pixels_of(as_image(measured))
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR), np.uint8)


def live(
    world: World,
    *,
    sensors: Mapping[str, Actor],
    config: FilterConfig | Mapping[str, object] | Path | str | None = None,
    on_frame: Callable[[LiveFrame], object] | None = None,
    options: LiveOptions | None = None,
) -> Live:
    """Clean boxes of each tick of a running simulation: an iterator of `LiveFrame`.

    `sensors` are those of the script, by what they are: ``rgb``, ``segmentation``,
    ``depth``, ``instances``, ``semantic_lidar``; at least ``rgb`` or ``segmentation``.
    All cameras have one pose, which is not checked, one size and angle, and
    ``sensor_tick`` 0. They are listened to here, so that the script must not call
    ``listen`` itself. In synchronous mode without `on_frame`, each step of the iterator
    ticks the world, unless `LiveOptions.ticks` says otherwise. `config` is a
    configuration, or the path or the keys of one, as `unghost filter --config` takes
    it.

    `on_frame` is called with each `LiveFrame` in a thread of its own, until `close`;
    without it, iterate.

    Raises `CaptureError`: an unknown name, an actor of another blueprint, cameras of
    different size or angle, or neither ``rgb`` nor ``segmentation``.
    Raises `ConfigError`: the configuration cannot be used.
    """
    synchronous = world.get_settings().synchronous_mode
    options = options or LiveOptions()
    ticks = options.ticks
    if ticks is None:
        ticks = synchronous and on_frame is None
    if ticks and not synchronous:
        raise CaptureError("ticks: expected a world in synchronous mode, found another")
    if isinstance(config, str | Path):
        config = Path(config).read_text("utf-8")
    if not isinstance(config, FilterConfig):
        config = load_config(config or {}).config
    running = _running(sensors)
    session = Live(world, running, config, replace(options, ticks=ticks))
    off = dict.fromkeys(("rgb", "segmentation"), False)
    document: dict[str, object] = {
        "sensors": {**off, **dict.fromkeys(sensors, True)},
        "boxes": options.boxes,
    }
    scenario = parse_scenario(document, "live")
    camera = sensors[main_camera(scenario)]
    fov = float(camera.attributes["fov"])
    view = scenario.camera.model_copy(update={"fov": fov})
    installed = metadata.version("carla")
    # What the first camera is attached to, else itself, which has no box either
    session.annotator = Annotator(
        Scene(
            carla=load_carla(),
            world=world,
            scenario=scenario.model_copy(update={"camera": view}),
            server_version=options.version or installed,
            client_version=installed,
            map_name=short_name(world.get_map().name),
        ),
        options.ego or (running[0].actor.parent or running[0].actor),
        running,
    )
    session.start(on_frame)
    return session


class Live:
    """An iterator over the ticks of a simulation; made by `live`.

    It ends with `close`, also as a context manager. Neither actors nor settings change.
    `dropped` ticks were left out because newer ones were there; `missed` are those that
    a sensor did not measure, by reason.
    """

    annotator: Annotator

    def __init__(
        self,
        world: World,
        sensors: Sequence[RunningSensor],
        config: FilterConfig,
        options: LiveOptions,
    ) -> None:
        self._world, self._sensors, self._config = world, sensors, config
        self._wait_s, self._drop = options.wait_s, options.drop
        self._ticks = options.ticks
        self._coming: queue.Queue[WorldSnapshot | None] = queue.Queue()
        self._callback: int | None = None
        self._thread: threading.Thread | None = None
        self._fault: BaseException | None = None
        self._is_over = False
        self.dropped = 0
        self.missed: Counter[str] = Counter()

    @property
    def waiting(self) -> int:
        """Ticks that have come and are not decided yet."""
        return self._coming.qsize()

    def start(self, on_frame: Callable[[LiveFrame], object] | None) -> None:
        """Listen to the sensors and, unless it ticks itself, to the world's ticks."""
        for sensor in self._sensors:
            assert isinstance(sensor.actor, Sensor), "checked when it was made"
            sensor.actor.listen(sensor.inbox.put)
        if not self._ticks:
            self._callback = self._world.on_tick(self._coming.put)
        if on_frame is not None:
            self._thread = threading.Thread(
                target=self._run, args=(on_frame,), name="unghost-live", daemon=True
            )
            self._thread.start()

    def __iter__(self) -> Iterator[LiveFrame]:
        return self

    def __next__(self) -> LiveFrame:
        """The next tick that all sensors measured.

        Raises `CaptureError`: the simulation stands still, or sensors miss many ticks
        in a row.
        Raises `StopIteration`: it was closed.
        """
        return self._decided(first_complete(self._try_tick, self.missed))

    def _try_tick(self) -> Moment | Missed:
        snapshot = self._snapshot()
        outcome = collect(
            self._sensors, snapshot.frame, self._wait_s, check=self._check
        )
        if not isinstance(outcome, Missed):
            return Moment(snapshot, outcome)
        if self._ticks:
            drain(self._sensors)
        return outcome

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening; raises what `on_frame` or its thread raised, if anything."""
        self._is_over = True
        self._coming.put(None)
        if self._callback is not None:
            self._world.remove_on_tick(self._callback)
            self._callback = None
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
            self._thread = None
        for sensor in self._sensors:
            assert isinstance(sensor.actor, Sensor), "checked when it was made"
            with suppress(RuntimeError):  # the script may have destroyed it
                sensor.actor.stop()
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def _run(self, on_frame: Callable[[LiveFrame], object]) -> None:
        try:
            for frame in self:
                on_frame(frame)
        except BaseException as error:
            self._fault = error

    def _check(self) -> None:
        if self._is_over:
            raise StopIteration

    def _snapshot(self) -> WorldSnapshot:
        """Of the next tick."""
        self._check()
        if self._ticks:
            self._world.tick(self._wait_s)
            return self._world.get_snapshot()
        try:
            snapshot = self._coming.get(timeout=self._wait_s)
            while self._drop == "oldest" and not self._coming.empty():
                newer = self._coming.get_nowait()
                snapshot, self.dropped = newer or snapshot, self.dropped + 1
        except queue.Empty:
            raise CaptureError(
                f"the simulation did not tick in {self._wait_s:g} s"
            ) from None
        self._check()
        assert snapshot is not None, "only `close` puts None, which ended it above"
        return snapshot

    def _decided(self, moment: Moment) -> LiveFrame:
        """The boxes of a moment, annotated and decided."""
        tick, measured = moment.snapshot.frame, moment.measured
        now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        record = self.annotator.annotate(
            moment,
            captured_at=now.replace("+00:00", "Z"),
            missed_before=self.missed.total() + self.dropped,
        )
        cloud = measured.get(_POINTS)
        points = None if cloud is None else encode(_POINTS, cloud)[1]
        result = decide_tick(self._config, f"{tick:06d}", record, measured, points)
        image = _colors(measured["rgb"]) if "rgb" in measured else None
        return LiveFrame(tick, image, record, result)


def _running(sensors: Mapping[str, Actor]) -> list[RunningSensor]:
    for name, actor in sensors.items():
        expected = BLUEPRINTS.get(name)
        if expected is None:
            raise CaptureError(
                f"sensors: unknown name {name!r}; the nearest is "
                f"{nearest(name, tuple(BLUEPRINTS))!r}"
            )
        if actor.type_id != expected or not isinstance(actor, Sensor):
            raise CaptureError(
                f"sensors: expected {expected} as {name}, found {actor.type_id}"
            )
        if float(actor.attributes.get("sensor_tick", 0)) != 0:
            raise CaptureError(
                f"sensors: {name} has a sensor_tick; it must be 0, so that it measures "
                "each tick"
            )
    if not sensors.keys() & {"rgb", "segmentation"}:
        raise CaptureError("sensors: expected rgb or segmentation, found neither")
    shapes = {
        name: tuple(sensors[name].attributes.get(key) for key in _SHAPE)
        for name in CAMERAS
        if name in sensors
    }
    first, *others = shapes.items()
    for name, shape in others:
        if shape != first[1]:
            raise CaptureError(
                f"sensors: {name} has another size or angle than {first[0]}: {shape}, "
                f"not {first[1]}"
            )
    return [
        RunningSensor(name, sensors[name]) for name in BLUEPRINTS if name in sensors
    ]


_SHAPE: Final = ("image_size_x", "image_size_y", "fov")
