"""`unghost filter`: every box of a folder decided on this machine, without a server."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias, get_args

import typer

from unghost.cli import sources
from unghost.cli.gates import GateOptions
from unghost.cli.options import OutputOptions, note_unknown_classes
from unghost.cli.screen import (
    ImageNotes,
    Kinds,
    Refused,
    Screen,
    one_line,
    partly_done,
    printable,
    refusal,
)
from unghost.cli.summary import LOOKED_AT, UnmappedOptions, note_boxes
from unghost.wire.words import Verdict

if TYPE_CHECKING:
    from concurrent.futures import Future

    from filter_core.config.filter import FilterConfig
    from filter_core.formats.reading import FrameSet, FrameSource, Unmatched
    from filter_core.inspection.remarks import BoxSummary
    from filter_core.local import ClassCount, FrameOutcome


Write: TypeAlias = Callable[[bytes], object]

_STDOUT: Final = Path("-")
_BUFFER_BYTES: Final = 1 << 20
"""Bytes of lines that are written together; a line has some twenty kilobytes."""
FEWEST_FRAMES: Final = 1000
"""Frames from which on processes are used; fewer are decided before they start."""
FEWEST_PROCESSES: Final = 3
"""Two threads wait for each other less than two processes cost."""
_PART: Final = 8
"""Frames that are sent to a process together."""
_PARTS_AHEAD: Final = 4
"""Per process."""


@dataclass(frozen=True, kw_only=True)
class FilterOptions(
    OutputOptions, sources.LocalFilterOptions, UnmappedOptions, GateOptions
):
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="The file to write, one line per frame; - for standard output.",
            dir_okay=False,
            allow_dash=True,
        ),
    ] = _STDOUT

    def __post_init__(self) -> None:
        """Refuse outputs that decisions cannot have.

        They must not take the place of what they were made from, and are no table.
        """
        super().__post_init__()
        from filter_core.formats.reading import MANIFEST_NAME

        source = self.source
        manifest = source / MANIFEST_NAME if source.is_dir() else source
        if self.output.resolve() == manifest.resolve():
            raise typer.BadParameter(f"--output {self.output} is the source itself")
        if (suffix := self.output.suffix) in (".csv", ".parquet"):
            raise typer.BadParameter(
                f"--output {self.output}: expected a name such as decisions.jsonl: a "
                f"line of JSON per frame is written; `unghost convert {source} --to "
                f"decisions-{suffix[1:]} --filter --output FOLDER` writes a table"
            )


@sources.reads_archives
def filter_local(options: FilterOptions) -> None:
    """Decide every box of a folder on this machine, without a server.

    Writes one line per frame, in the order of the frames. Exit code 3 if some frames
    could not be decided or matched; they are listed, and their lines say why. Also if
    a class or pixels in boxes are unknown, or all boxes of a class are rejected.
    Exit code 4 if a condition of --fail-if holds.
    """
    from filter_core.inspection.remarks import BoxSummary, RecordingAdvice
    from filter_core.local import boxes_by_class

    description = options.description_of(options.source)
    config = sources.read_config(options.config, options, description, options.screen)
    check = sources.FrameCheck()
    frames = sources.open_source(options.source, options.layout, description)
    summary = BoxSummary(RecordingAdvice(sources.default_class_of(frames, description)))
    first = list(islice(frames, LOOKED_AT))
    options.require_known(boxes_by_class(first), config, summary.advice)
    shown = sources.shown_by(first, config, config.channels, options.screen)
    watched = check.watch(shown.of(frames))
    tally = _Tally(options.screen, summary)
    with line_output(options.output) as write:
        decided = decided_lines(watched, config, options.workers)
        for line in tally.watch(decided, watched.count):
            write(line.content)
    for problem in (
        *tally.refusals.more(),
        *sources.unmatched_lines(watched.unmatched),
    ):
        options.screen.note(problem)
    check.note(options.screen, watched)
    note_unknown_classes(options.screen, config.as_dict(), summary.boxes)
    is_doubtful = note_boxes(options.screen, summary)
    tally.print_summary(options.output, watched.unmatched)
    title = f"unghost filter {options.source}"
    options.check(tally.counts(), options.screen, title)
    if tally.failed or watched.unmatched or is_doubtful:
        raise partly_done(tally.decided)


@contextmanager
def line_output(path: Path) -> Iterator[Write]:
    """Where lines go; a file appears when it is complete, not before."""
    if path == _STDOUT:
        write = sys.stdout.buffer.write
        yield (
            (lambda lines: write(printable(lines.decode()).encode()))
            if sys.stdout.isatty()
            else write
        )
        sys.stdout.flush()
        return
    from filter_core.formats.files import whole_file

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with whole_file(path, _BUFFER_BYTES) as file:
            yield file.write
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {path} was not written") from None


class _Tally:
    """Counts what came out, and says so."""

    def __init__(self, screen: Screen, summary: BoxSummary) -> None:
        self.screen = screen
        self.decided = 0
        self.failed = 0
        self._summary = summary
        self._notes = ImageNotes()
        self.refusals = Kinds()
        self._boxes: Counter[str] = Counter()
        self._unmapped = 0
        self._unseen: list[str] = []
        self._of_other_color: Counter[str] = Counter()
        self._first_of_other_color = ""

    def watch(
        self, lines: Iterable[FrameLine], total: int | None
    ) -> Iterator[FrameLine]:
        """The lines, counted, under a bar."""
        with self.screen.progress("filter", "frames") as advance:
            for line in lines:
                self._add(line)
                yield line
                advance(self.decided + self.failed, total)

    def _add(self, line: FrameLine) -> None:
        if line.fault is not None:
            self.failed += 1
            if self.refusals.is_listed(f"refused ({line.code})"):
                self.screen.note(refusal(line.key, sources.naming_reading(line.fault)))
            return
        self.decided += 1
        if line.is_unseen:
            self._unseen.append(line.key)
        self._summary.add(line.classes)
        self._notes.add(line.notes)
        self._boxes.update(line.verdicts)
        if line.of_other_color and not self._of_other_color:
            self._first_of_other_color = line.key
        self._of_other_color.update(line.of_other_color)
        self._unmapped += sum(counts.unmapped for counts in line.classes.values())

    def counts(self) -> dict[str, int]:
        """Frames and boxes, for the conditions of `--fail-if`."""
        return {
            "frames": self.decided + self.failed,
            "refused": self.failed,
            "boxes": self._boxes.total(),
            "unmapped": self._unmapped,
            **{name: self._boxes[name] for name in get_args(Verdict)},
        }

    def print_summary(self, output: Path, unmatched: Sequence[Unmatched]) -> None:
        """Print notes, and counts of frames and boxes; with `--json`, unused files."""
        self._notes.print(self.screen, ", in the frames' lines")
        if self._unseen:
            count = f"{len(self._unseen)} of {self.decided} frames"
            such = f"such as {self._unseen[0]}"
            self.screen.note(
                one_line(f"unmeasured, without a segmentation: {count}, {such}")
            )
        if self._of_other_color:
            named = ", ".join(
                f"{name} ({count})"
                for name, count in sorted(self._of_other_color.items())
            )
            self.screen.note(
                one_line(
                    f"profile carlasimu rejects boxes that tags of their class fill, "
                    f"since it counts one colour for each class: {named}, such as in "
                    f"{self._first_of_other_color}"
                )
            )
        frames = {"decided": self.decided, "failed": self.failed}
        boxes = {name: self._boxes[name] for name in get_args(Verdict)}
        counts = {**frames, **boxes}
        text = "\t".join(f"{count} {name}" for name, count in counts.items())
        if output == _STDOUT:
            self.screen.note(text)
        else:
            left = [vars(file) for file in unmatched]
            record = {"output": str(output), **counts, "unmatched": left}
            self.screen.record(record, text)


@dataclass(frozen=True)
class FrameLine:
    """A frame's line, its boxes counted by verdict and by class, or what is wrong.

    It is unseen if it has boxes and no segmentation, and none of them was measured.
    `of_other_color` are the classes of the boxes that `other_colors` finds.
    """

    key: str
    content: bytes
    verdicts: Counter[str] = field(default_factory=Counter)
    classes: Mapping[str, ClassCount] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    is_unseen: bool = False
    of_other_color: Counter[str] = field(default_factory=Counter)
    fault: str | None = None
    code: str = ""


def decided_lines(
    frames: FrameSet,
    config: FilterConfig,
    workers: int | None,
    *,
    fewest_frames: int = FEWEST_FRAMES,
) -> Generator[FrameLine, None, None]:
    """The lines of all frames, in their order; a bounded number is decided ahead.

    Decoding releases Python's lock, describing decisions does not: threads wait for
    each other, the longer the more there are. Processes do not, but take a second to
    start and have to send lines, so threads do a few frames, or the work of two cores.
    From `fewest_frames` on there are processes, `workers` of them, or one for each
    core.

    Raises `Refused` if a process ended while it worked on frames, which are named.
    """
    count = workers or os.cpu_count() or 1
    is_short = frames.count is not None and frames.count < fewest_frames
    if count < FEWEST_PROCESSES or is_short:
        from filter_core.local import in_order

        return in_order(partial(_line_of, config), frames, workers)
    return _by_processes(frames, config, count)


def _by_processes(
    source_frames: FrameSet, config: FilterConfig, count: int
) -> Generator[FrameLine, None, None]:
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    from filter_core.errors import problem_of
    from filter_core.local import FrameOutcome
    from filter_core.processes import child_context

    # Of the frames that processes work on: the keys of the first and the last one.
    waiting: deque[tuple[str, str, Future[list[FrameLine]]]] = deque()
    context = child_context(["filter_core.local", "pydantic"])
    pool = ProcessPoolExecutor(count, context, _begin)
    # An error cannot be sent to another process, its description can.
    sendable: Iterator[FrameSource | FrameOutcome] = (
        FrameOutcome(source.key, error=problem_of(source.problem))
        if source.problem
        else source
        for source in source_frames
    )
    try:
        while frames := list(islice(sendable, _PART)):
            lines = pool.submit(_lines_of, config, frames)
            waiting.append((frames[0].key, frames[-1].key, lines))
            if len(waiting) >= count * _PARTS_AHEAD:
                yield from waiting[0][2].result()
                waiting.popleft()
        while waiting:
            yield from waiting[0][2].result()
            waiting.popleft()
    except BrokenProcessPool:
        first, last = waiting[0][0], waiting[-1][1]
        raise Refused(
            f"a process crashed while it worked on frames {first!r} to {last!r}: one "
            "of them crashes a library, or the memory is exhausted"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """In a process that has just started."""
    import multiprocessing
    from multiprocessing.connection import wait

    import cv2

    cv2.setNumThreads(1)  # the other cores have processes of their own
    # The main process handles Ctrl-C; this one finishes its current frames.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        """End when the command is killed, which cannot stop this process itself."""
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _lines_of(
    config: FilterConfig, frames: list[FrameSource | FrameOutcome]
) -> list[FrameLine]:
    return [_line_of(config, frame) for frame in frames]


def _line_of(config: FilterConfig, frame: FrameSource | FrameOutcome) -> FrameLine:
    from filter_core.local import FrameOutcome, filter_one

    outcome = frame
    if not isinstance(outcome, FrameOutcome):
        outcome = filter_one(outcome, config)
    content = _encoder()(outcome.as_dict()) + b"\n"
    if outcome.error is not None:
        code = outcome.error["errors"][0]["code"]
        fault = outcome.error["detail"]
        return FrameLine(outcome.key, content, fault=fault, code=code)
    decisions = outcome.decisions or ()
    verdicts = Counter(str(each["verdict"]) for each in decisions)
    is_unseen = outcome.palette is None and set(verdicts) == {"unmeasured"}
    return FrameLine(
        outcome.key,
        content,
        verdicts,
        outcome.classes,
        outcome.notes,
        is_unseen,
        other_colors(outcome, config),
    )


def other_colors(outcome: FrameOutcome, config: FilterConfig) -> Counter[str]:
    """Boxes by class that profile carlasimu rejects though tags of their class fill it.

    It counts one colour for each class, while CARLA has had several tags for some since
    0.9.14: the pixels of most trucks are Truck, and it looks for Car.
    """
    from filter_core.class_names import class_meant_by
    from filter_core.classes import accept_mask_of

    boxes: Counter[str] = Counter()
    if config.profile != "carlasimu" or outcome.palette is None:
        return boxes
    for decision in outcome.decisions or ():
        if decision["verdict"] != "rejected" or not decision["hidden_by"]:
            continue
        name = decision["class"]
        mask = accept_mask_of(class_meant_by(name) or name, outcome.palette)
        tags = (each for each in decision["hidden_by"] if mask >> each["tag"] & 1)
        filled = sum(each["percent"] for each in tags)
        boxes[name] += filled > config.limits_of(name).threshold_small_box
    return +boxes


@cache
def _encoder() -> Callable[[dict[str, object]], bytes]:
    """The JSON encoder of lines; a frame has some 700 values, so its speed matters."""
    from pydantic import TypeAdapter

    return TypeAdapter(dict[str, object]).dump_json
