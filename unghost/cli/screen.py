"""The output of commands, and their exit codes.

Data goes to stdout, everything else to stderr. On a terminal there are bars and tables;
elsewhere plain lines, one TAB between columns.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final, Literal, Protocol, TypeAlias, TypeVar

import typer

# Steps done so far, out of how many (None: not known).
Advance: TypeAlias = Callable[[int, "int | None"], None]

DONE: Final = 0
REFUSED: Final = 1
USAGE: Final = 2
PARTLY: Final = 3
GATE: Final = 4
UNAVAILABLE: Final = 69
INTERRUPTED: Final = 130
EXIT_CODES: Final = {
    DONE: "done",
    REFUSED: "refused, because of the input, the server or the current state; the "
    "message says why",
    USAGE: "the command line itself was wrong",
    PARTLY: "partly done: the frames that failed are listed, or classes, pixels or "
    "boxes that were probably not understood; `doctor`: something should be done",
    GATE: "a condition of `--fail-if` holds",
    UNAVAILABLE: "the server did not answer, or was busy for too long",
    INTERRUPTED: "interrupted",
}
"""What each exit code means."""

_SHOWN: Final = 60
"""Characters of a wrong value that are quoted."""
_LINE_EVERY_S: Final = 5.0
_CONTROL_OR_BREAK: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
_CONTROL: Final = re.compile(rf"(?![\t\n]){_CONTROL_OR_BREAK.pattern}")


class Refused(Exception):
    """The command cannot do what was asked; the text says why."""


@contextmanager
def refused_on(*errors: type[Exception], text: str = "") -> Iterator[None]:
    """Convert these errors to `Refused`, with their own text or this one."""
    try:
        yield
    except errors as exc:
        raise Refused(text or str(exc)) from exc


@contextmanager
def naming_options(
    option_of_field: Mapping[str, str], values: Mapping[str, object]
) -> Iterator[None]:
    """Name the command's options in a refusal, where the server names fields.

    `option_of_field` has the beginnings of fields' JSON pointers, and what replaces
    them. `values` are by option: the server quotes no text, which may be a
    secret in some requests; here it is what the user has just typed.

    Raises `typer.BadParameter` if the server refuses values of options only
    (`Invalid`), `Refused` if it refuses something else, too; each with all faults.
    """
    from unghost.client.errors import Invalid

    try:
        yield
    except Invalid as error:
        lines = [str(fault) for fault in error.errors] or [error.detail]
        for field, option in option_of_field.items():
            lines = [
                option + line.removeprefix(field) if line.startswith(field) else line
                for line in lines
            ]
        for row, (option, colon, why) in enumerate(
            line.partition(": ") for line in lines
        ):
            # The value, if the fault does not say it
            says_all = not why.startswith("expected ") or ", found " in why
            if colon and option in values and not says_all:
                lines[row] += f", found {str(values[option])[:_SHOWN]!r}"
        text = "\n  ".join(lines)
        if all(line.startswith("--") for line in lines):
            raise typer.BadParameter(text) from error
        raise Refused(text) from error


def partly_done(done: int) -> typer.Exit:
    """Exit of a command that was partly done: code 3, or 1 if nothing was done."""
    return typer.Exit(PARTLY if done else REFUSED)


class ServerObject(Protocol):
    """An object that came from the server."""

    @property
    def raw(self) -> Mapping[str, object]:
        """Its JSON."""


ObjectT = TypeVar("ObjectT", bound=ServerObject)
WordT = TypeVar("WordT", bound=str)


class Screen:
    """Where a command's output goes."""

    def __init__(self, *, as_json: bool = False) -> None:
        self.as_json = as_json

    def record(self, record: Mapping[str, object], text: str | None = None) -> None:
        """Print one record: a JSON line, or `text` for people (None: nothing)."""
        if self.as_json:
            # The same escapes as in JSON, which itself has them up to U+001F.
            _print(json.dumps(record, ensure_ascii=False))
        elif text is not None:
            self.text(text)

    def text(self, text: str) -> None:
        """Print data for people; nothing with `--json`, where records have the data."""
        if not self.as_json:
            _print(text)

    def table(
        self,
        columns: Sequence[str],
        rows: Iterable[Sequence[object]],
        *,
        tag: str | None = None,
        headed: bool = False,
    ) -> None:
        """Print a table for people; nothing with `--json`, where records have the data.

        In plain text each line begins with `tag`, which identifies the table. With
        `headed` the columns of a table with rows are named first, behind ``#``.
        """
        if self.as_json:
            return
        if not sys.stdout.isatty():
            rows = list(rows)
            if headed and rows:
                _print("\t".join((f"# {tag}", *columns)))
            for row in rows:
                cells = row if tag is None else (tag, *row)
                _print("\t".join(_cell(value) for value in cells))
            return
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        rows = list(rows)
        table = Table(
            box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold"
        )
        for number, column in enumerate(columns):
            numbers = any(isinstance(row[number], int | float) for row in rows)
            side: Literal["left", "right"] = "right" if numbers else "left"
            table.add_column(column, overflow="fold", justify=side)
        for row in rows:
            # Plain text, because names from users are not markup.
            table.add_row(*(Text(_cell(value)) for value in row))
        Console().print(table, "")

    def listing(
        self,
        columns: Sequence[str],
        answers: Iterable[ObjectT],
        row: Callable[[ObjectT], Sequence[object]],
    ) -> None:
        """Print a table with a row per object; with `--json`, a line per object."""
        listed = list(answers)
        for answer in listed:
            self.record(answer.raw)
        self.table(columns, map(row, listed))

    def note(self, text: str) -> None:
        """Print a status line for people, to standard error."""
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()

    @contextmanager
    def progress(self, title: str, unit: str) -> Iterator[Advance]:
        """A bar with rate and remaining time on a terminal, else occasional lines."""
        if not sys.stderr.isatty():
            yield self._lines(title, unit)
            return
        from rich import progress as rich
        from rich.console import Console

        columns = (
            rich.TextColumn("{task.description}"),
            rich.BarColumn(),
            rich.MofNCompleteColumn(),
            rich.TextColumn("{task.fields[rate]}"),
            rich.TimeRemainingColumn(),
        )
        # Drawing costs processor time, which a server on this machine needs as well.
        console = Console(stderr=True)
        with rich.Progress(*columns, console=console, refresh_per_second=4) as bar:
            task = bar.add_task(title, total=None, rate="")

            def advance(done: int, total: int | None) -> None:
                speed = bar.tasks[task].speed
                rate = f"{speed:.1f} {unit}/s" if speed else ""
                bar.update(task, completed=done, total=total, rate=rate)

            yield advance

    def _lines(self, title: str, unit: str) -> Advance:
        started = time.monotonic()
        printed = started

        def advance(done: int, total: int | None) -> None:
            nonlocal printed
            now = time.monotonic()
            if done != total and now - printed < _LINE_EVERY_S:
                return
            printed = now
            rate = done / max(now - started, 1e-9)
            of = "" if total is None else f" of {total}"
            self.note(f"{title}: {done}{of} {unit}, {rate:.1f} {unit}/s")

        return advance


def most_first(counts: Mapping[WordT, int]) -> list[tuple[WordT, int]]:
    """Names and how often they occur, the most frequent first."""
    return sorted(counts.items(), key=lambda item: -item[1])


def refusal(key: str, reason: str) -> str:
    """The line for a refused frame: its key, then the reason without the key."""
    rest = reason.removeprefix("frame ").removeprefix(key)
    if rest[:1] in (":", ","):
        reason = rest.lstrip(":, ")
    return one_line(f"refused: {key}: {reason}")


MOST_OF_A_KIND: Final = 10


class Kinds:
    """Which of many lines are printed: the first ten of each kind; then a number."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def is_listed(self, kind: str) -> bool:
        """Count one more line of this kind; whether it is among those to be printed."""
        self._counts[kind] += 1
        return self._counts[kind] <= MOST_OF_A_KIND

    def more(self) -> Iterator[str]:
        """A line for each kind of which some were not printed."""
        for kind, count in self._counts.items():
            if count > MOST_OF_A_KIND:
                yield one_line(f"and {count - MOST_OF_A_KIND:,} more like this: {kind}")


class ImageNotes:
    """How the depth and instance images of frames were read: notes and their frames."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def add(self, notes: Iterable[str]) -> None:
        """The notes of one frame."""
        self._counts.update(notes)

    def print(self, screen: Screen, all_notes: str = "") -> None:
        """Print the ten commonest, then a number; `all_notes` says where all are."""
        for note, count in self._counts.most_common(MOST_OF_A_KIND):
            frames = "1 frame" if count == 1 else f"{count:,} frames"
            screen.note(one_line(f"{frames}: {note}"))
        if len(self._counts) > MOST_OF_A_KIND:
            more = len(self._counts) - MOST_OF_A_KIND
            screen.note(f"and {more:,} more such notes{all_notes}")


def printable(text: str) -> str:
    """The text with control characters escaped, except line breaks and tabs.

    Names of files and texts of a server could otherwise clear the terminal, or write
    over what it shows.
    """
    return _CONTROL.sub(_escaped, text)


def one_line(text: str) -> str:
    """The text with all control characters escaped: it cannot look like two lines."""
    return _CONTROL_OR_BREAK.sub(_escaped, text)


def _escaped(match: re.Match[str]) -> str:
    return f"\\u{ord(match.group()):04x}"


def _print(text: str) -> None:
    sys.stdout.write(f"{printable(text)}\n")
    sys.stdout.flush()


def _cell(value: object) -> str:
    # A name with a tab or a line break must not look like two cells or two rows.
    return "" if value is None else one_line(" ".join(str(value).split()))
