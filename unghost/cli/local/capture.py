"""`unghost capture`: frames from a running CARLA simulator."""

from __future__ import annotations

import queue
import threading
import time
import webbrowser
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.options import ServerOptions, error_context, read_file, read_folder
from unghost.cli.remote.push import PushOptions, PushReport, send
from unghost.cli.remote.target import NewDataset, ensure_dataset
from unghost.cli.screen import Screen, partly_done

if TYPE_CHECKING:
    from unghost.capture.recording import Recorded, StoredTick
    from unghost.capture.scenario import Scenario
    from unghost.client.client import Client

_SAY_EVERY_S: Final = 5.0


@dataclass(frozen=True, kw_only=True)
class CaptureOptions(ServerOptions):
    scenario: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENARIO",
            help="The scenario (YAML).",
            exists=True,
            dir_okay=False,
            readable=True,
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="The folder to record into; default: one named after the scenario. "
            "A capture in it is continued.",
            file_okay=False,
        ),
    ] = None
    push: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET",
            help="Upload what was recorded to this dataset; created if it does not "
            "exist.",
        ),
    ] = None
    config: Annotated[
        Path | None,
        read_file(
            help="The configuration (YAML) by which boxes are decided while recording; "
            "default: the built-in one."
        ),
    ] = None
    show: Annotated[
        bool,
        typer.Option(
            "--show", help="With --push: open the page, which follows the newest frame."
        ),
    ] = False
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the plan and do nothing.")
    ] = False
    from_carlasimu: Annotated[
        Path | None,
        read_folder(
            metavar="DIR",
            help="Print carlasimu's YAML files as a scenario, instead of capturing.",
        ),
    ] = None


def capture(options: CaptureOptions) -> None:
    """Record what a scenario describes from a running CARLA simulator.

    Can be interrupted: the simulator's settings are restored, and the same command
    continues. Exit code 69 if no simulator answers, or it stops answering.
    """
    from unghost.capture.plan import plan_of
    from unghost.capture.scenario import read_scenario
    from unghost.capture.simulator import ScenarioError

    if options.from_carlasimu is not None:
        _refuse_beside_conversion(options)
        from unghost.capture.carlasimu import convert_carlasimu, scenario_text

        converted, notes = convert_carlasimu(options.from_carlasimu)
        record = {"scenario": converted, "notes": notes}
        options.screen.record(record, scenario_text(converted, notes).rstrip("\n"))
        return
    if options.scenario is None:
        raise typer.BadParameter("give SCENARIO or --from-carlasimu")
    scenario = read_scenario(options.scenario)
    if scenario.rounding is not None:
        options.screen.note(scenario.rounding)
    output = options.output or Path(f"capture-{options.scenario.stem}")
    if options.dry_run:
        rows, plan = plan_of(scenario, output, options.push)
        options.screen.record(plan)
        options.screen.table(("what", "how"), rows)
        return
    if options.push is not None:
        # Check the dataset now, so that a wrong token is not found after hours
        pushing = _pushing(output, options.push, options)
        with pushing.connect() as client:
            ensure_dataset(
                client, options.push, NewDataset(pushing.reading), options.screen
            )
    try:
        recorded = _record(scenario, output, options)
    except ScenarioError as error:
        # Faults that the simulator detects are reported like those of the file itself.
        raise ScenarioError(f"{options.scenario.name}: {error}") from error
    _print_recorded(recorded, output, options)
    if options.push is not None:
        _push(output, options.push, options)


def _refuse_beside_conversion(options: CaptureOptions) -> None:
    """A conversion records nothing, so that these options would have no effect."""
    useless = {
        "SCENARIO": options.scenario,
        "--output": options.output,
        "--push": options.push,
        "--config": options.config,
        "--show": options.show or None,
        "--dry-run": options.dry_run or None,
        "--server": options.server,
        "--token": options.token,
    }
    names = [name for name, value in useless.items() if value is not None]
    if names:
        raise typer.BadParameter(
            f"--from-carlasimu only prints a scenario: leave out {', '.join(names)}"
        )


def _record(scenario: Scenario, output: Path, options: CaptureOptions) -> Recorded:
    from filter_core.config.file import load_config
    from unghost.capture.recording import Request, record
    from unghost.capture.simulator import load_carla

    if options.show and options.push is None:
        raise typer.BadParameter(
            "--show shows what --push DATASET sends: give that, too"
        )
    carla = load_carla()
    screen = options.screen
    with error_context(options.config):
        config = load_config(options.config.read_bytes() if options.config else b"")
    watch = _Watch(screen)
    with ExitStack() as stack:
        if options.push is not None:
            client = stack.enter_context(
                _pushing(output, options.push, options).connect()
            )
            watch.uploader = stack.enter_context(
                _Uploader(client, options.push, screen, show=options.show)
            )
        advance = stack.enter_context(screen.progress("capture", "frames"))
        request = Request(
            scenario, output, screen.note, advance, config.config, watch.add
        )
        try:
            return record(carla, request)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "interrupted; the same command continues the capture"
            ) from None


class _Watch:
    """Says while frames are recorded how many boxes are kept and rejected."""

    def __init__(self, screen: Screen) -> None:
        self.uploader: _Uploader | None = None
        self._screen = screen
        self._since = time.monotonic()
        self._counts: Counter[str] = Counter()

    def add(self, stored: StoredTick) -> None:
        """Count a frame, and let it be sent."""
        if self.uploader is not None:
            self.uploader.add(stored)
        if stored.result is not None:
            decisions = stored.result.decisions
            self._counts.update(decision["verdict"] for decision in decisions)
        self._counts["frames"] += 1
        passed = time.monotonic() - self._since
        if passed >= _SAY_EVERY_S:
            rates = (
                f"{self._counts[name] / passed:.1f} {name}"
                for name in ("frames", "kept", "rejected", "unmeasured")
                if self._counts[name]
            )
            self._screen.note(f"per second: {', '.join(rates)}")
            self._since, self._counts = time.monotonic(), Counter()


class _Uploader:
    """Sends frames in a thread while others are recorded.

    What cannot be sent is left to the push at the end.
    """

    def __init__(
        self, client: Client, dataset: str, screen: Screen, *, show: bool
    ) -> None:
        self._client, self._dataset, self._screen = client, dataset, screen
        self._is_to_show = show
        self._coming: queue.Queue[StoredTick | None] = queue.Queue()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> _Uploader:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._coming.put(None)
        self._thread.join()

    def add(self, stored: StoredTick) -> None:
        """Send a frame as soon as those before it are sent."""
        self._coming.put(stored)

    def _send(self) -> None:
        from unghost.client.errors import ApiError, Unavailable

        failed = False
        while (tick := self._coming.get()) is not None:
            if failed:
                continue
            try:
                file = tick.files.get
                sent = self._client.put_frame(
                    self._dataset,
                    tick.key,
                    tick.record,
                    image=file("image"),
                    segmentation=file("segmentation"),
                    instances=file("instances"),
                    depth=file("depth"),
                    lidar=file("lidar"),
                    radar=file("radar"),
                )
            except (ApiError, Unavailable, OSError) as error:
                failed = True
                self._screen.note(f"frames are sent at the end only: {error}")
                continue
            if self._is_to_show:
                self._is_to_show = False
                page = f"{self._client.url}/#/frames/{sent.frame.id}?follow=1"
                self._screen.note(f"the newest frame is shown at {page}")
                webbrowser.open(page)


def _print_recorded(recorded: Recorded, output: Path, options: CaptureOptions) -> None:
    screen = options.screen
    for reason, count in sorted(recorded.missed.items()):
        screen.note(f"ticks not recorded: {count}: {reason}")
    for reason, count in sorted(recorded.left_out.items()):
        screen.note(f"objects without a box: {count}: {reason.replace('_', ' ')}")
    rows = [
        (what, name, count["frames"], count["boxes"])
        for what, names in recorded.tally.items()
        for name, count in names.items()
    ]
    screen.table(("by", "name", "frames", "boxes"), rows, tag="count", headed=True)
    screen.record(
        {"output": str(output), **recorded.as_dict()},
        f"{recorded.frames} frames\t{recorded.added} new\t"
        f"{recorded.missed.total()} ticks missed\t"
        f"{recorded.decided['kept']} kept\t{recorded.decided['rejected']} rejected",
    )


def _pushing(folder: Path, dataset: str, options: CaptureOptions) -> PushOptions:
    return PushOptions(
        source=folder,
        dataset=dataset,
        server=options.server,
        token=options.token,
        retry_for=options.retry_for,
        json=options.json,
        layout="manifest",
    )


def _push(folder: Path, dataset: str, options: CaptureOptions) -> None:
    from unghost.cli.sources import open_source

    pushing = _pushing(folder, dataset, options)
    report = PushReport(options.screen)
    frames = open_source(folder, pushing.layout, pushing.description_of(folder))
    with pushing.connect() as client:
        send(client, pushing, frames, report)
    report.print_summary(frames.unmatched, dataset)
    if report.refused:
        raise partly_done(report.succeeded)
