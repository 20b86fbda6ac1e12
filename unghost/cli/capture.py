"""`unghost capture`: frames from a running CARLA simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from unghost.cli.options import ServerOptions
from unghost.cli.push import PushOptions, PushReport, send
from unghost.cli.screen import partly_done
from unghost.cli.target import NewDataset, ensure_dataset

if TYPE_CHECKING:
    from unghost.capture.recording import Recorded
    from unghost.capture.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class CaptureOptions(ServerOptions):
    """Options of `unghost capture`."""

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
            "--push",
            metavar="DATASET",
            help="Upload what was recorded to this dataset; created if it does not "
            "exist.",
        ),
    ] = None
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the plan and do nothing.")
    ] = False
    from_carlasimu: Annotated[
        Path | None,
        typer.Option(
            "--from-carlasimu",
            metavar="DIR",
            help="Print carlasimu's YAML files as a scenario, instead of capturing.",
            exists=True,
            file_okay=False,
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
        _convert(options.from_carlasimu, options)
        return
    if options.scenario is None:
        raise typer.BadParameter("give SCENARIO or --from-carlasimu")
    scenario = read_scenario(options.scenario)
    if scenario.rounding is not None:
        options.screen.note(scenario.rounding)
    output = options.output or Path(f"capture-{options.scenario.stem}")
    if options.dry_run:
        plan = plan_of(scenario, output, options.push)
        options.screen.record(plan.record)
        options.screen.table(("what", "how"), plan.rows)
        return
    if options.push is not None:
        _require_dataset(output, options.push, options)
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
        "--dry-run": options.dry_run or None,
        "--server": options.server,
        "--token": options.token,
    }
    given = [name for name, value in useless.items() if value is not None]
    if given:
        raise typer.BadParameter(
            f"--from-carlasimu only prints a scenario: leave out {', '.join(given)}"
        )


def _convert(folder: Path, options: CaptureOptions) -> None:
    from unghost.capture.carlasimu import convert_carlasimu

    converted = convert_carlasimu(folder)
    record = {"scenario": converted.scenario, "notes": converted.notes}
    options.screen.record(record, converted.as_yaml().rstrip("\n"))


def _record(scenario: Scenario, output: Path, options: CaptureOptions) -> Recorded:
    from unghost.capture.recording import Request, record
    from unghost.capture.simulator import load_carla

    carla = load_carla()
    screen = options.screen
    with screen.progress("capture", "frames") as advance:
        try:
            return record(carla, Request(scenario, output, screen.note, advance))
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "interrupted; the same command continues the capture"
            ) from None


def _print_recorded(recorded: Recorded, output: Path, options: CaptureOptions) -> None:
    screen = options.screen
    for reason, count in sorted(recorded.missed.items()):
        screen.note(f"ticks not recorded: {count}: {reason}")
    for reason, count in sorted(recorded.left_out.items()):
        screen.note(f"objects without a box: {count}: {reason.replace('_', ' ')}")
    screen.record(
        {"output": str(output), **recorded.as_dict()},
        f"{recorded.frames} frames\t{recorded.added} new\t"
        f"{recorded.missed.total()} ticks missed",
    )


def _pushing(folder: Path, dataset: str, options: CaptureOptions) -> PushOptions:
    return PushOptions(
        source=folder,
        dataset=dataset,
        server=options.server,
        token=options.token,
        json=options.json,
        layout="manifest",
    )


def _require_dataset(folder: Path, dataset: str, options: CaptureOptions) -> None:
    """Check the dataset now, so that a wrong token is not found after hours."""
    pushing = _pushing(folder, dataset, options)
    with pushing.connect() as client:
        ensure_dataset(client, dataset, NewDataset(pushing.reading), options.screen)


def _push(folder: Path, dataset: str, options: CaptureOptions) -> None:
    from unghost.cli.sources import open_source

    pushing = _pushing(folder, dataset, options)
    report = PushReport(options.screen)
    found = open_source(folder, pushing.layout, pushing.describe(folder))
    with pushing.connect() as client:
        send(client, pushing, found, report)
    report.print_summary(found.unmatched, dataset)
    if report.refused:
        raise partly_done(report.succeeded)
