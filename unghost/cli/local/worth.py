"""`unghost worth-it`: what cleaning labels gains, on your own frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, get_args

import typer

from unghost.cli import sources
from unghost.cli.cluster import NodeOptions, connected, settings_of_node
from unghost.cli.options import ServerOptions, read_folder, written_file
from unghost.cli.screen import Kinds, Refused, Screen, partly_done, refusal, refused_on
from unghost.cli.summary import LOOKED_AT

if TYPE_CHECKING:
    from filter_core.evaluation.arms import NoiseObject
    from filter_core.evaluation.scores import MeasuredObject
    from filter_core.evaluation.trials import ComparisonObject
    from filter_core.formats.recording import RecordingDescription
    from filter_core.local import ArmsTask, KnownBox, LabelledFrame, TruthSource
    from unghost.cli.worth_page import Table
    from unghost.experiment.trials import Experiment

_CEILING: Final = (
    " The arms instance and auto read these images, too, so they are ceilings, as "
    "perfect is."
)

_TRAINED: Final = "raw,paper,auto"

_HERE: Final = "local"
"""The engine that trains on this machine."""

_WITHOUT_TRUTH: Final = {
    "instances": "record instance images, or choose --truth reviews or FILE",
    "reviews": "SOURCE must be an export as decisions-jsonl with answers of people",
}
"""What helps where no box is known to be an object."""


@dataclass(frozen=True, kw_only=True)
class WorthOptions(ServerOptions, sources.LocalFilterOptions, NodeOptions):
    dataset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A dataset of the server that shows the result on its page Quality.",
        ),
    ] = None

    truth: Annotated[
        str,
        typer.Option(
            metavar="instances|reviews|FILE",
            help="What tells which boxes show an object: the instance images, people's "
            "answers (of an export as decisions-jsonl), or lines of JSON with key, id, "
            "visible and perhaps visible_pixels.",
        ),
    ] = "instances"
    object_pixels: Annotated[
        int,
        typer.Option(
            min=1,
            help="Visible pixels from which on a box is an object; with fewer it is "
            "doubtful, and does not count.",
        ),
    ] = 10
    arms: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Ways of cleaning labels, separated by commas: raw, clipped, paper, "
            "carlasimu, ordered, depth, instance, auto, perfect, random; ordered@3 is "
            "with 3 visible pixels; all: each of these. The first is what the others "
            f"are compared with. Default: all, and to train {_TRAINED}.",
        ),
    ] = None
    no_train: Annotated[
        bool,
        typer.Option(
            "--no-train",
            help="Only count what is wrong with the labels; takes seconds.",
        ),
    ] = False
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="The folder of the experiment: its data sets, trials and report. If "
            "it exists, what is not finished is continued.",
            file_okay=False,
        ),
    ] = None
    seeds: Annotated[
        str,
        typer.Option(
            metavar="N|FIRST-LAST",
            help="How often each arm is trained; or which seeds, such as 3-5, where "
            "other machines train the others.",
        ),
    ] = "3"
    trainer: Annotated[
        str,
        typer.Option(
            metavar="COMMAND",
            help="torchvision, with options of its own such as --steps and --width; or "
            "a command with {data}, {seed} and {output}.",
        ),
    ] = "torchvision"
    split: Annotated[
        float,
        typer.Option(
            min=0.01,
            max=0.99,
            help="The share of frames for training, by whole sequences, of frames that "
            "are of no part.",
        ),
    ] = 0.8
    parallel: Annotated[
        int,
        typer.Option(
            min=1,
            max=64,
            help="Trials that run at the same time, and share the cores; with "
            "--engine: workers of one machine.",
        ),
    ] = 1
    engine: Annotated[
        str,
        typer.Option(
            metavar="local|ADDRESS",
            help="Where to train: here, or on the workers of a scheduler, such as "
            "tls://HOST:8786, which all reach the folder of --output at the same path.",
        ),
    ] = _HERE
    join: Annotated[
        list[Path] | None,
        read_folder(
            metavar="DIR",
            help="Another experiment's folder, whose trials are reported together with "
            "these: more seeds or arms of the same truth, or another test set. May be "
            "repeated.",
        ),
    ] = None
    html: Annotated[
        Path | None,
        written_file(
            metavar="FILE.html",
            help="With --no-train: write the tables as a page, drawn.",
        ),
    ] = None


@sources.reads_archives
def worth_it(options: WorthOptions) -> None:
    """Count the ghosts among labels, and train on raw and on cleaned labels.

    With --no-train, counts for each way of cleaning (arm): labels, ghosts among them,
    and objects that it loses, by class, distance and visible pixels. Else it writes a
    data set for each arm, trains a detector on each with each seed, and compares them
    on one truth. The same command continues what was interrupted. With --no-train, exit
    code 3 if some frames could not be read, or some files could not be matched.
    """
    from unghost.cli.worth_page import noise_tables

    if options.engine != _HERE:
        # A wrong address is refused, and any spelling of `_HERE` is that.
        engine = settings_of_node(options.engine, options).engine
        options = replace(options, engine=engine)
    if options.dataset is not None:
        with options.connect() as client:
            client.dataset(options.dataset)
    if not options.no_train:
        _train_and_compare(options)
        return
    description = options.description_of(options.source)
    task = _task(options, description, "all")
    noise, left_out = _count_labels(options, description, task)
    facts = {"truth": options.truth, "object_pixels": options.object_pixels}
    options.screen.record({**facts, **noise})
    _print_tables(noise_tables(noise), options.screen)
    if options.html is not None:
        from filter_core.formats.files import write_whole
        from filter_core.formats.reading import name_of
        from unghost.cli.worth_page import worth_page

        title = f"Label noise of {name_of(options.source)}"
        page = worth_page(title, [_truth_text(options)], noise)
        write_whole(options.html, page.encode())
        options.screen.note(f"wrote {options.html}")
    _show_on_page(options, noise)
    if left_out:
        raise partly_done(noise["frames"])


def _count_labels(
    options: WorthOptions,
    description: RecordingDescription,
    task: ArmsTask,
    also: Callable[[LabelledFrame], None] = lambda _: None,
) -> tuple[NoiseObject, list[str]]:
    """The label noise of all frames, and lines about what was left out."""
    from filter_core.evaluation.arms import LabelNoise
    from filter_core.local import LeftOut, label_sources

    screen = options.screen
    frames = sources.open_source(options.source, options.layout, description)
    configs = (arm.config(task.config) for arm in task.arms)
    channels = {name for config in configs if config for name in config.channels}
    if task.truth == "instances":
        channels.add("instance")
    first = islice(frames, LOOKED_AT)
    frames = sources.shown_by(first, task.config, channels, screen).of(frames)
    counted = LabelNoise([arm.name for arm in task.arms])
    refusals, left_out = Kinds(), list[str]()
    with screen.progress("label", "frames") as advance:
        labelled = label_sources(frames, task, workers=options.workers)
        for done, frame in enumerate(labelled, start=1):
            if not isinstance(frame, LeftOut):
                counted.add(frame.boxes)
                also(frame)
            elif refusals.is_listed(sources.kind_of(frame.problem)):
                why = sources.naming_reading(frame.problem.detail)
                left_out.append(refusal(frame.key, why))
            advance(done, frames.count)
    left_out += [*refusals.more(), *sources.unmatched_lines(frames.unmatched)]
    sources.note_reading(screen, frames)
    for line in left_out:
        screen.note(line)
    noise = counted.as_dict()
    if not noise["objects"]:
        other = f"no key and id of {options.truth} are those of a box"
        remedy = _WITHOUT_TRUTH.get(options.truth, other)
        raise Refused(f"no box is known to be an object: {remedy}")
    lacking = {name: arm["without_evidence"] for name, arm in noise["arms"].items()}
    for name, count in (+Counter(lacking)).items():
        screen.note(
            f"{name}: its evidence has no number for {count:,} boxes, which the "
            "segmentation decided"
        )
    return noise, left_out


def _train_and_compare(options: WorthOptions) -> None:
    from filter_core.local import in_order
    from unghost.experiment.cluster import run_on_workers, tasks_of
    from unghost.experiment.trials import Experiment, TrialError, trainer_command

    if options.output is None:
        raise typer.BadParameter("--output DIR is needed, or --no-train")
    if options.html is not None:
        raise typer.BadParameter("--html is for --no-train; --output gets report.html")
    seeds = _seeds(options.seeds)
    description = options.description_of(options.source)
    task = _task(options, description, _TRAINED)
    experiment = Experiment(options.output)
    with refused_on(TrialError), ExitStack() as opened:
        command = trainer_command(options.trainer, is_here=options.engine == _HERE)
        parallel, client = options.parallel, None
        if options.engine != _HERE:
            client = opened.enter_context(connected(options.engine, options))
        noise = _prepare(options, description, task, experiment)
        experiment.require_trainer(options.trainer)
        trials = [(arm.name, seed) for seed in seeds for arm in task.arms]
        pending = [trial for trial in trials if not experiment.is_finished(*trial)]
        done = len(trials) - len(pending)
        finished: Iterator[None]
        if client is None:
            finished = in_order(
                lambda trial: experiment.run(*trial, command, parallel),
                pending,
                parallel,
            )
        else:
            tasks = tasks_of(experiment, pending, options.trainer, parallel)
            finished = run_on_workers(client, tasks, options.screen.note)
        with options.screen.progress("train", "trials") as advance:
            advance(done, len(trials))
            for number, _ in enumerate(finished, start=done + 1):
                advance(number, len(trials))
        _report(options, experiment, noise)


def _prepare(
    options: WorthOptions,
    description: RecordingDescription,
    task: ArmsTask,
    experiment: Experiment,
) -> NoiseObject:
    """Write the data sets, unless they are there; the label noise of all frames."""
    from filter_core.formats.files import json_bytes, new_folder, write_whole
    from filter_core.formats.reading import name_of
    from filter_core.local import class_order
    from unghost.experiment.datasets import DatasetsWriter
    from unghost.experiment.trials import SETTINGS

    arms = [arm.name for arm in task.arms]
    settings = {
        "source": name_of(options.source),
        "truth": options.truth,
        "object_pixels": options.object_pixels,
        "split": options.split,
        "config": task.config.digest,
    }
    if experiment.data.exists():
        there = experiment.settings
        noise = there["noise"]
        missing = [arm for arm in arms if arm not in noise["arms"]]
        changed = [name for name, value in settings.items() if there.get(name) != value]
        if missing or changed:
            what = f"no arm {', '.join(missing)}" if missing else f"other {changed[0]}"
            raise Refused(
                f"{experiment.folder}: its data sets were made with {what}; choose "
                "another --output, or delete this folder"
            )
        options.screen.note(f"the data sets in {experiment.data} are used again")
        return noise
    frames = sources.open_source(options.source, options.layout, description)
    classes = frames.classes or class_order(frames)
    with new_folder(experiment.data) as folder:
        writer = DatasetsWriter(folder, arms, classes, options.split)
        noise, left_out = _count_labels(options, description, task, writer.add)
        for part in ("train", "val"):
            if not writer.frames[part]:
                raise Refused(
                    f"no frame with an image is in the part {part}: --split says how "
                    "many are for training, by whole sequences; frames may also say "
                    "split: val themselves"
                )
        writer.finish()
        record = {**settings, "noise": noise, "frames": dict(writer.frames)}
        write_whole(folder / SETTINGS, json_bytes(record))
    said = ", ".join(f"{name} {count:,}" for name, count in writer.frames.items())
    options.screen.note(f"frames: {said}; left out: {len(left_out)}")
    return noise


def _seeds(text: str) -> list[int]:
    """``3`` is 0, 1, 2; ``3-5`` is 3, 4, 5."""
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise typer.BadParameter(
            f"--seeds: expected a number, or a range such as 3-5, found {text!r}"
        )
    seeds = range(int(first), int(last) + 1) if dash else range(int(first))
    if not seeds:
        raise typer.BadParameter(f"--seeds: {text} has no seed")
    return list(seeds)


def _report(options: WorthOptions, experiment: Experiment, noise: NoiseObject) -> None:
    """Compare all finished trials, those of joined experiments too, and write it."""
    from filter_core.evaluation.trials import compare
    from filter_core.formats.files import json_bytes, write_whole
    from unghost.cli.worth_page import noise_tables, score_tables, text_of, worth_page
    from unghost.experiment.trials import joined

    tests, keys, trials = joined([experiment.folder, *(options.join or ())])
    with options.screen.progress("score", "trials") as advance:
        comparison = compare(tests, trials, lambda done: advance(done, keys))
    tables = [*score_tables(comparison), *noise_tables(noise)]
    title = f"Is it worth it? {', '.join(comparison['tests'])}"
    texts = [comparison["verdict"], _truth_text(options)]
    folder = experiment.folder
    record = {**comparison, "trainer": options.trainer, "noise": noise}
    page = worth_page(title, texts, noise, comparison)
    text = "\n".join([title, *texts, "", text_of(tables)])
    write_whole(folder / "report.html", page.encode())
    write_whole(folder / "report.json", json_bytes(record))
    write_whole(folder / "report.txt", text.encode())
    options.screen.record(record)
    _print_tables(tables, options.screen)
    options.screen.text(comparison["verdict"])
    options.screen.note(f"wrote {folder / 'report.html'}, report.json and report.txt")
    _show_on_page(options, noise, comparison)


def _show_on_page(
    options: WorthOptions,
    noise: NoiseObject,
    comparison: ComparisonObject | None = None,
) -> None:
    """Keep the result with the dataset that the options name, if they name one."""
    if options.dataset is None:
        return
    scores = {} if comparison is None else comparison["arms"]
    differences = {} if comparison is None else comparison["differences"]

    def arm_of(name: str) -> dict[str, object]:
        counts = noise["arms"].get(name)
        score, difference = scores.get(name), differences.get(name)
        return {
            "labels": counts
            and {
                "labels": counts["labels"],
                "ghosts": counts["kept_hidden"],
                "doubtful": counts["doubtful"],
                "lost": counts["rejected_visible"],
            },
            "trials": score["trials"] if score else 0,
            "map50": score and _measured(score["map50"]),
            "difference": difference
            and {
                **_measured(difference["map50"]),
                "shown": difference["map50"]["shown"],
            },
        }

    names = dict.fromkeys([*scores, *noise["arms"]])
    report = {
        "verdict": "" if comparison is None else comparison["verdict"],
        "truth": _truth_text(options),
        "baseline": next(iter(names)) if comparison is None else comparison["baseline"],
        "trainer": "" if comparison is None else options.trainer,
        "frames": noise["frames"],
        "objects": noise["objects"],
        "arms": {name: arm_of(name) for name in names},
    }
    with options.connect() as client:
        client.set_experiment(options.dataset, report)
    options.screen.note(f"the page Quality of {options.dataset} shows it")


def _measured(number: MeasuredObject) -> dict[str, float]:
    return {"value": number["value"], "low": number["low"], "high": number["high"]}


def _task(
    options: WorthOptions, description: RecordingDescription, default: str
) -> ArmsTask:
    from filter_core.errors import ConfigError
    from filter_core.evaluation.arms import ARMS, Arm
    from filter_core.local import ArmsTask

    asked = options.arms or default
    names = ARMS if asked == "all" else asked.split(",")
    try:
        arms = tuple(dict.fromkeys(Arm.named(name.strip()) for name in names))
    except ConfigError as error:
        raise typer.BadParameter(f"--{error.detail}") from error
    return ArmsTask(
        arms=arms,
        config=sources.read_config(
            options.config, options, description, options.screen
        ),
        truth=_truth(options),
        least_pixels=options.object_pixels,
    )


def _truth(options: WorthOptions) -> TruthSource | Mapping[str, Mapping[str, KnownBox]]:
    from filter_core.local import TruthSource, read_box_truth

    for source in get_args(TruthSource):
        if options.truth == source:
            told: TruthSource = source
            return told
    path = Path(options.truth)
    if not path.is_file():
        raise typer.BadParameter(
            "--truth: expected instances, reviews or a file with lines of JSON, found "
            f"{options.truth!r}"
        )
    return read_box_truth(path, options.object_pixels)


def _truth_text(options: WorthOptions) -> str:
    """What tells the truth, in words."""
    told = {
        "instances": "the pixels of each object in the instance images",
        "reviews": "people's answers",
    }.get(options.truth, options.truth)
    return (
        f"The truth is told by {told}. A box with {options.object_pixels} visible "
        "pixels or more is an object, one without any is a ghost, and the others are "
        "doubtful: they do not count."
        f"{_CEILING if options.truth == 'instances' else ''}"
    )


def _print_tables(tables: Iterable[Table], screen: Screen) -> None:
    for table in tables:
        screen.table(table.columns, table.rows, tag=table.tag)
