"""`unghost push`: uploads a folder of frames, and prints the outcome of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, get_args

import typer

from unghost.cli import sources
from unghost.cli.gates import GateOptions
from unghost.cli.options import (
    ServerOptions,
    dataset_names,
    note_unknown_classes,
    read_file,
    read_folder,
)
from unghost.cli.remote.datasets import gate_counts
from unghost.cli.remote.target import (
    GivenConfig,
    NewDataset,
    coming_config,
    ensure_dataset,
)
from unghost.cli.screen import (
    MOST_OF_A_KIND,
    ImageNotes,
    Kinds,
    Screen,
    one_line,
    partly_done,
    refusal,
)
from unghost.cli.summary import LOOKED_AT, UnmappedOptions, note_boxes, summary_of
from unghost.wire.boxes import MOST_IMPORTED
from unghost.wire.frames import MOST_BOXES_SET_ASIDE
from unghost.wire.words import UploadWord, Verdict

if TYPE_CHECKING:
    from filter_core.formats.reading import FrameSet, FrameSource, Unmatched
    from filter_core.formats.recording import RecordingDescription
    from unghost.client.client import Client
    from unghost.client.outgoing import NotSent, Outcome, Sent


@dataclass(frozen=True, kw_only=True)
class PushOptions(ServerOptions, sources.SourceOptions, UnmappedOptions, GateOptions):
    source: sources.SourceFolder
    dataset: Annotated[
        str,
        typer.Option(
            help="Name of the dataset to upload to; created if it does not exist.",
            autocompletion=dataset_names,
        ),
    ]
    workers: Annotated[
        int,
        typer.Option(min=1, max=16, help="Number of frames to send at the same time."),
    ] = 2
    root: Annotated[
        list[Path] | None,
        read_folder(
            metavar="DIR",
            help="Folder whose files may be uploaded, too, if a manifest, labels or a "
            "symbolic link name them; may be repeated.",
        ),
    ] = None
    outside_files: Annotated[
        bool,
        typer.Option(
            "--outside-files",
            help="Upload any file that a manifest, labels or a symbolic link name, "
            "wherever it lies; only for folders whose origin you trust.",
        ),
    ] = False
    config: Annotated[
        Path | None,
        read_file(
            help="A filter configuration (YAML) for a dataset without frames; default: "
            "that of the server. `unghost config set` changes that of a dataset with "
            "frames."
        ),
    ] = None
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Replace stored frames whose content differs, instead of refusing. "
            "Answers on boxes that changed are set aside.",
        ),
    ] = False

    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Store nothing: read the folder, and say what would be sent.",
        ),
    ] = False

    edited: Annotated[
        Path | None,
        read_file(
            metavar="FILE",
            help="The file that CVAT or Label Studio saved after people edited SOURCE, "
            "an export of the dataset: boxes that they kept and deleted become their "
            "answers, and no frame is sent. Needs the role admin.",
        ),
    ] = None

    @property
    def outside(self) -> dict[str, object]:
        """Which files outside the folder may be read: those that were allowed."""
        return {"outside_files": self.outside_files, "roots": tuple(self.root or ())}


@sources.reads_archives
def push(options: PushOptions) -> None:
    """Upload a folder of frames, and have every box decided.

    Can be interrupted and repeated: frames that the server has are not sent again.
    Exit code 3 if some frames were refused or could not be matched; they are listed.
    Also if the dataset has boxes of unknown classes, or a class whose boxes are all
    rejected. Exit code 4 if a condition of --fail-if holds for the whole dataset.
    """
    from filter_core.formats.same import companions
    from filter_core.inspection.remarks import RecordingAdvice
    from filter_core.local import boxes_by_class

    if options.edited is not None:
        import_edited(options, options.edited)
        return
    report = PushReport(options.screen)
    check = sources.FrameCheck()
    answers: list[dict[str, object]] = []
    description = options.description_of(options.source)
    # How segmentations are read are settings of a dataset, not of its configuration.
    settings = description.segmentation_settings()
    described = {
        name: value
        for name, value in description.config_keys().items()
        if name not in settings
    }
    config = GivenConfig.of(options.config, described)
    if config.loaded:
        sources.note_unused_keys(config.loaded.unused_keys, options.screen)
    frames = sources.open_source(options.source, options.layout, description)
    watched = check.watch(frames)
    settings = {**settings, **options.reading}
    default_class = sources.default_class_of(watched, description)
    with options.connect() as client:
        coming, renamed = coming_config(client, options.dataset, config, settings)
        first = list(islice(frames, LOOKED_AT))
        boxes: Counter[str] = Counter()
        looked_at = frames if options.strict_classes else first
        for name, count in boxes_by_class(looked_at).items():
            boxes[renamed.get(name, name)] += count
        options.require_known(boxes, coming, RecordingAdvice(default_class))
        shown = sources.shown_by(first, coming, (), options.screen).keys
        read_with = told_recording(options.source, description, watched.layout)
        if options.dry_run:
            _print_coming(client, options, watched)
            check.note(options.screen, watched)
            if watched.unmatched:
                raise partly_done(0)
            return
        new = NewDataset(settings, watched.classes or (), config, shown, read_with)
        ensure_dataset(client, options.dataset, new, options.screen)
        used: Counter[str] = Counter()
        noting = _noting(watched, answers, used)
        send(client, options, replace(watched, frames=noting), report)
        import_answers(client, options.dataset, answers, options.screen)
        left = companions(options.source, watched, used)
        _keep_companions(client, options.dataset, read_with, left, options.screen)
        summary = summary_of(client, options.dataset, default_class)
        numbers = client.stats(options.dataset)
    note_unknown_classes(options.screen, config.whole or config.keys, summary.boxes)
    is_doubtful = report.succeeded > 0 and note_boxes(options.screen, summary)
    check.note(options.screen, watched)
    report.print_summary(watched.unmatched, options.dataset)
    counts = gate_counts(numbers, report.refused)
    options.check(counts, options.screen, f"unghost push {options.dataset}")
    if report.refused or watched.unmatched or is_doubtful:
        raise partly_done(report.succeeded)


def _print_coming(
    client: Client, options: PushOptions, source_frames: FrameSet
) -> None:
    """Say how many frames would be sent, and which cannot be; nothing is stored."""
    from unghost.client.api import dataset_path, known_frames
    from unghost.client.errors import NotFound
    from unghost.client.outgoing import NotSent

    screen, counts = options.screen, Counter[str]()
    frames, path = sources.outgoing(source_frames), dataset_path(options.dataset)
    with suppress(NotFound):
        client.dataset(options.dataset)
        counts["exists"] = 1
    while some := list(islice(frames, _COMPARED)):
        whole = [frame for frame in some if not isinstance(frame, NotSent)]
        stored = {}
        if counts["exists"] and whole:
            stored = client._send(known_frames(path, [frame.key for frame in whole]))
        for frame in some:
            if isinstance(frame, NotSent):
                counts["unreadable"] += 1
                screen.note(_line(frame))
            elif frame.key not in stored:
                counts["new"] += 1
            else:
                same = stored[frame.key].digest == frame.digest()
                counts["there" if same else "different"] += 1
    record = {
        name: counts[name] for name in ("new", "there", "different", "unreadable")
    }
    fate = "replaced" if options.replace else "refused, without --replace"
    text = (
        f"{options.dataset}{'' if counts['exists'] else ' (would be created)'}: "
        f"{counts['new']:,} frames would be sent, {counts['there']:,} are there, "
        f"{counts['different']:,} have another content there and would be {fate}, "
        f"{counts['unreadable']:,} cannot be read; nothing was stored"
    )
    screen.record({"dataset": options.dataset, **record}, text)


_COMPARED: Final = 250
"""Frames whose digests are compared in one request."""


def import_edited(options: PushOptions, edited: Path) -> None:
    """Send what people did with the boxes of an export as their answers."""
    from filter_core.errors import LayoutError
    from filter_core.evaluation.edited import edited_answers
    from filter_core.formats.registry import read_source

    description = options.description_of(options.source)
    exported = sources.open_source(options.source, options.layout, description)
    if exported.layout not in _EDITABLE:
        raise LayoutError(
            f"--edited: expected an export in {' or '.join(_EDITABLE)}, found "
            f"{exported.layout}"
        )
    again = replace(description, labels=edited)
    on_frames, counts = edited_answers(
        exported,
        read_source(options.source, exported.layout, again),
        by=exported.layout,
        at=datetime.fromtimestamp(edited.stat().st_mtime, timezone.utc),
    )
    answers = [{"frame": key, **answer._asdict()} for key, answer in on_frames]
    for word, text in _OF_EDITED.items():
        if count := counts[word]:
            options.screen.note(f"{count:,} {text}")
    with options.connect() as client:
        import_answers(client, options.dataset, answers, options.screen)


_EDITABLE: Final = ("cvat", "label-studio")

_OF_EDITED: Final = {
    "frames": "frames were labelled by people",
    "untouched": "frames were not: no answers",
    "elsewhere": "frames are not in the export; they were left out",
    "faulty": "frames cannot be read; they were left out",
    "new": "boxes are new, and were left out",
    "changed": "boxes have another class or rectangle, which was not taken over",
}


def told_recording(
    source: Path, description: RecordingDescription, layout: str
) -> dict[str, object]:
    """How a folder is read, as its dataset keeps it.

    Without folders elsewhere, and without a layout that only a plug-in here reads.
    """
    from filter_core.formats.recording import LAYOUTS, description_document

    folder = source if source.is_dir() else source.parent

    def inside(place: Path | None) -> Path | None:
        below = folder.absolute()
        return place if place and place.absolute().is_relative_to(below) else None

    told = replace(
        description,
        layout=layout if layout in LAYOUTS else "auto",
        segmentation=inside(description.segmentation),
        labels=inside(description.labels),
    )
    return description_document(told, folder)


def _noting(
    source_frames: FrameSet, answers: list[dict[str, object]], used: Counter[str]
) -> Callable[[], Iterator[FrameSource]]:
    """The frames; adds the answers of people that they come with.

    `used` counts their files by folder, but for those of labels.
    """
    from filter_core.formats.same import folder_of

    def frames() -> Iterator[FrameSource]:
        for frame in source_frames:
            files = (frame.image, frame.segmentation, *frame.others.values())
            used.update(map(folder_of, filter(None, files)))
            answers.extend(
                {"frame": frame.key, **answer._asdict()} for answer in frame.answers
            )
            yield frame

    return frames


def _keep_companions(
    client: Client,
    dataset: str,
    read_with: dict[str, object],
    left: Mapping[str, int],
    screen: Screen,
) -> None:
    """Say which files of the recording the server does not have, and let it keep that.

    Its exports say it again. Of a recording that is sent again, the counts are new.
    """
    from filter_core.formats.recording import COMPANIONS

    kept = client.dataset(dataset).recording or read_with
    before = kept.get(COMPANIONS)
    joined = {**(before if isinstance(before, dict) else {}), **left}
    if joined and joined != before:
        client.change_dataset(dataset, recording={**kept, COMPANIONS: joined})
    of_folders = [f"{name} {count:,}" for name, count in left.items()]
    more = len(of_folders) - MOST_OF_A_KIND
    listed = ", ".join(of_folders[:MOST_OF_A_KIND])
    also = f" and {more:,} more folders" if more > 0 else ""
    count = sum(left.values())
    total = f"{count:,} files belong to no frame and were not sent"
    if count == 1:
        total = "1 file belongs to no frame and was not sent"
    if left:
        screen.note(f"{total}, by folder: {listed}{also}")


def import_answers(
    client: Client,
    dataset: str,
    answers: Sequence[Mapping[str, object]],
    screen: Screen,
) -> None:
    """Send the answers of people that came with frames, and say what became of them.

    Without the role admin they are left out, which is said.
    """
    from unghost.client.errors import Forbidden

    if not answers:
        return
    outcomes: Counter[str] = Counter()
    try:
        for start in range(0, len(answers), MOST_IMPORTED):
            some = answers[start : start + MOST_IMPORTED]
            outcome = client.import_answers(dataset, some)
            for word in _OF_ANSWERS:
                outcomes[word] += getattr(outcome, word)
    except Forbidden:
        screen.note(
            f"{len(answers):,} answers of people were not imported: that needs a token "
            "with the role admin"
        )
        return
    counts = (f"{outcomes[word]:,} {text}" for word, text in _OF_ANSWERS.items())
    screen.note(f"answers of people: {', '.join(counts)}")


_OF_ANSWERS: Final = {
    "imported": "imported",
    "already": "there already",
    "newer": "left out, since the box has a newer one",
    "unknown": "on boxes that are not there",
}


def send(
    client: Client, options: PushOptions, frames: FrameSet, report: PushReport
) -> None:
    """Send every frame, with a progress bar; if interrupted, print the number sent."""
    sent = client.push(
        options.dataset,
        sources.outgoing(frames),
        replace=options.replace,
        connections=options.workers,
    )
    with (
        options.screen.progress(f"push to {options.dataset}", "frames") as advance,
        closing(sent) as outcomes,
    ):
        try:
            for outcome in outcomes:
                report.add(outcome)
                advance(report.seen, frames.count)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {report.seen} frames; the same command continues"
            ) from None


class PushReport:
    """Counts outcomes; prints each as a JSON line, or a summary at the end.

    Keeps only as many problems as it will list, since there may be one per frame.
    """

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._verdicts: Counter[str] = Counter()
        self._outcomes: Counter[str] = Counter()
        self._problems: list[str] = []
        self._kinds = Kinds()
        self._changed = 0
        self._notes = ImageNotes()
        self._set_aside: list[str] = []
        self._with_set_aside = self._answers_set_aside = 0

    @property
    def seen(self) -> int:
        """Number of frames with any outcome."""
        return self._outcomes.total()

    @property
    def refused(self) -> int:
        """Number of frames that were refused."""
        return self._outcomes["refused"]

    @property
    def succeeded(self) -> int:
        """Number of frames that the server has."""
        return self.seen - self.refused

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        from unghost.client.errors import Conflict
        from unghost.client.outgoing import NotSent, Sent

        self._outcomes[outcome.word] += 1
        if isinstance(outcome, Sent):
            for verdict in get_args(Verdict):
                self._verdicts[verdict] += getattr(outcome.counts, verdict)
            self._notes.add(outcome.notes)
            if outcome.answers_set_aside:
                self._answers_set_aside += outcome.answers_set_aside
                self._with_set_aside += 1
                if len(self._set_aside) < MOST_OF_A_KIND:
                    self._set_aside.append(_set_aside_line(outcome))
        elif isinstance(outcome, NotSent):
            self._changed += isinstance(outcome.error, Conflict)
            if self._kinds.is_listed(_kind(outcome.error)):
                self._problems.append(_line(outcome))
        self._screen.record(_record(outcome))

    def print_problems(self) -> None:
        """The frames that were refused, one by one."""
        for line in (*self._problems, *self._kinds.more()):
            self._screen.note(line)
        if self._changed:
            # The server's message names a parameter of the API, not the option.
            have = (
                "1 frame has" if self._changed == 1 else f"{self._changed} frames have"
            )
            self._screen.note(
                f"{have} other content on the server; --replace replaces it"
            )

    def print_summary(self, unmatched: Sequence[Unmatched], dataset: str) -> None:
        """Print the summary, and the problems one by one."""
        self.print_problems()
        self._notes.print(self._screen, " (--json has all)")
        for line in self._set_aside:
            self._screen.note(line)
        if self._with_set_aside > len(self._set_aside):
            more = self._with_set_aside - len(self._set_aside)
            self._screen.note(f"and {more:,} more like this (--json has all)")
        for line in sources.unmatched_lines(unmatched):
            self._screen.note(line)
        counts = self.counts()
        if self._answers_set_aside:
            counts["answers_set_aside"] = self._answers_set_aside
        self._screen.record(
            {
                "dataset": dataset,
                **self.counts(),
                "answers_set_aside": self._answers_set_aside,
                "unmatched": [vars(file) for file in unmatched],
            },
            "\t".join(f"{count} {name}" for name, count in counts.items()),
        )

    def counts(self) -> dict[str, int]:
        """Frames by outcome, then boxes by verdict."""
        frames = {word: self._outcomes[word] for word in get_args(UploadWord)}
        boxes = {verdict: self._verdicts[verdict] for verdict in get_args(Verdict)}
        return frames | boxes


def _record(outcome: Outcome) -> dict[str, object]:
    from unghost.client.errors import ApiError
    from unghost.client.outgoing import NotSent, Sent

    record: dict[str, object] = {"key": outcome.key, "outcome": outcome.word}
    if isinstance(outcome, NotSent):
        if isinstance(outcome.error, ApiError):
            return {**record, "error": outcome.error.problem}
        detail = _detail(outcome.error)
        return {**record, "error": {"code": "unreadable", "detail": detail}}
    record["frame_id"] = outcome.frame_id
    if isinstance(outcome, Sent) and outcome.answers_set_aside:
        record["answers_set_aside"] = outcome.answers_set_aside
        record["boxes_set_aside"] = list(outcome.boxes_set_aside)
    if isinstance(outcome, Sent) and outcome.notes:
        record["notes"] = list(outcome.notes)
    return record


def _set_aside_line(outcome: Sent) -> str:
    number, boxes = outcome.answers_set_aside, outcome.boxes_set_aside
    answers = "1 answer was" if number == 1 else f"{number} answers were"
    more = " and others" if number > len(boxes) == MOST_BOXES_SET_ASIDE else ""
    return one_line(
        f"{outcome.key}: {answers} set aside, on boxes that changed or are gone: "
        f"{', '.join(boxes)}{more}"
    )


def _line(outcome: NotSent) -> str:
    from unghost.client.errors import ApiError

    error = outcome.error
    why = sources.naming_reading(_detail(error), of_dataset=True)
    why = why.replace("?replace=true", "--replace")  # the parameter of the API
    line = refusal(outcome.key, why)
    if not isinstance(error, ApiError):
        return line
    # The message of the error already contains a single fault.
    faults = error.errors if len(error.errors) > 1 else ()
    more = [f"and {error.more_errors} more"] if error.more_errors else []
    return "\n    ".join([line, *(one_line(str(fault)) for fault in faults), *more])


def _kind(error: Exception) -> str:
    """Which errors are alike when they are listed."""
    from filter_core.errors import FilterError
    from unghost.client.errors import ApiError

    if isinstance(error, FilterError):
        return sources.kind_of(error)
    if isinstance(error, ApiError):
        return f"refused ({error.errors[0].code if error.errors else error.code})"
    return f"refused ({type(error).__name__})"


def _detail(error: Exception) -> str:
    """The error's text, without the system's own number of it."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)
