"""`unghost filter`: the same filter on this machine alone, without a server."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.command import command
from unghost.cli.exits import PARTLY, REFUSED
from unghost.cli.filter_work import FrameLine, decided_lines
from unghost.cli.options import OutputOptions
from unghost.cli.push_report import without_key
from unghost.cli.screen import Screen
from unghost.cli.source_options import LocalFilterOptions
from unghost.cli.sources import open_source, read_config

if TYPE_CHECKING:
    from filter_core.formats.reading import Unmatched

Write = Callable[[bytes], object]

_STDOUT: Final = Path("-")
_BUFFER_BYTES: Final = 1 << 20
"""A line is some twenty kilobytes: many of them in one write."""


@dataclass(frozen=True, kw_only=True)
class FilterOptions(OutputOptions, LocalFilterOptions):
    """Options of `unghost filter`."""

    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="The file to write, one line per frame; - is standard output.",
            dir_okay=False,
            allow_dash=True,
        ),
    ] = _STDOUT


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "filter")(filter_local)


def filter_local(options: FilterOptions) -> None:
    """Decide every box of a folder here, without a server, on all cores.

    Writes one line per frame, in the order of the frames. Exit code 3 if some frames
    could not be decided or matched; they are listed, and their lines say why.
    """
    _spare_source(options)
    config = read_config(options.config, options, options.screen)
    found = open_source(options.source, options)
    tally = _Tally(options.screen)
    with _output(options.output) as write:
        decided = decided_lines(found, config, options.workers)
        for line in tally.watch(decided, found.count):
            write(line.content)
    for file in found.unmatched:
        tally.screen.note(f"not matched: {file.path}: {file.why}")
    tally.print_summary(options.output, found.unmatched)
    if tally.failed or found.unmatched:
        raise typer.Exit(PARTLY if tally.decided else REFUSED)


def _spare_source(options: FilterOptions) -> None:
    """Decisions must not take the place of what they were made from."""
    source = options.source
    manifest = source / "manifest.jsonl" if source.is_dir() else source
    if options.output.resolve() == manifest.resolve():
        raise typer.BadParameter(f"--output {options.output} is the source itself")


@contextmanager
def _output(path: Path) -> Iterator[Write]:
    """Where lines go; a file appears when it is complete, not before."""
    if path == _STDOUT:
        yield sys.stdout.buffer.write
        sys.stdout.buffer.flush()
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.part")
    try:
        with partial.open("wb", buffering=_BUFFER_BYTES) as file:
            yield file.write
        partial.replace(path)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {path} was not written") from None
    finally:
        partial.unlink(missing_ok=True)


class _Tally:
    """Counts what came out, and says so."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.decided = 0
        self.failed = 0
        self._boxes: Counter[str] = Counter()

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
            said = without_key(line.fault, line.key)
            self.screen.note(f"refused: {line.key}: {said}")
            return
        self.decided += 1
        self._boxes.update(line.verdicts)

    def print_summary(self, output: Path, unmatched: Sequence[Unmatched]) -> None:
        """Frames and boxes by what became of them; with `--json` what fits no frame."""
        frames = {"decided": self.decided, "failed": self.failed}
        boxes = {name: self._boxes[name] for name in ("kept", "rejected", "unmeasured")}
        counts = {**frames, **boxes}
        text = "\t".join(f"{count} {name}" for name, count in counts.items())
        if output == _STDOUT:
            self.screen.note(text)
        else:
            left = [vars(file) for file in unmatched]
            record = {"output": str(output), **counts, "unmatched": left}
            self.screen.record(record, text)
