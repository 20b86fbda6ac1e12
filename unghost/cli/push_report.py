"""What became of the frames of a push, counted and told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

from unghost.cli.screen import Screen
from unghost.errors import ApiError, Conflict
from unghost.outgoing import NotSent, Outcome, Sent

if TYPE_CHECKING:
    from filter_core.formats.reading import Unmatched

_LISTED: Final = 20
_WORDS: Final = ("stored", "already_there", "refused")
_VERDICTS: Final = ("kept", "rejected", "unmeasured")


class PushReport:
    """Counts outcomes; tells each one as a JSON line, or all of them at the end.

    Of the problems it keeps as many as it will list: there may be one per frame.
    """

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._verdicts: Counter[str] = Counter()
        self._outcomes: Counter[str] = Counter()
        self._problems: list[str] = []
        self._changed = 0

    @property
    def seen(self) -> int:
        """Frames that are done with, one way or the other."""
        return self._outcomes.total()

    @property
    def refused(self) -> int:
        """Frames that were not taken."""
        return self._outcomes["refused"]

    @property
    def stored(self) -> int:
        """Frames that are new."""
        return self._outcomes["stored"]

    @property
    def succeeded(self) -> int:
        """Frames that the server has."""
        return self.seen - self.refused

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self._outcomes[outcome.word] += 1
        if isinstance(outcome, Sent):
            for verdict in _VERDICTS:
                self._verdicts[verdict] += getattr(outcome.counts, verdict)
        elif isinstance(outcome, NotSent):
            self._changed += isinstance(outcome.error, Conflict)
            if len(self._problems) < _LISTED:
                self._problems.append(_line(outcome))
        self._screen.record(_record(outcome))

    def print_problems(self) -> None:
        """The frames that were refused, one by one."""
        self._print_some(self._problems, self.refused)
        if self._changed:
            # The server's words name a parameter that is no option here.
            have = (
                "1 frame has" if self._changed == 1 else f"{self._changed} frames have"
            )
            self._screen.note(f"{have} other content there; --replace stores it")

    def print_summary(self, unmatched: Sequence[Unmatched], dataset: str) -> None:
        """Say what happened; the problems one by one."""
        self.print_problems()
        lines = (f"not matched: {file.path}: {file.why}" for file in unmatched)
        self._print_some(lines, len(unmatched))
        self._screen.record(
            {
                "dataset": dataset,
                **self.counts(),
                "unmatched": [vars(file) for file in unmatched],
            },
            "\t".join(f"{count} {name}" for name, count in self.counts().items()),
        )

    def counts(self) -> dict[str, int]:
        """Frames by outcome, then boxes by verdict."""
        frames = {word: self._outcomes[word] for word in _WORDS}
        boxes = {verdict: self._verdicts[verdict] for verdict in _VERDICTS}
        return frames | boxes

    def _print_some(self, lines: Iterable[str], count: int) -> None:
        for _, line in zip(range(_LISTED), lines, strict=False):
            self._screen.note(line)
        if count > _LISTED:
            self._screen.note(f"... and {count - _LISTED} more (--json has all)")


def without_key(said: str, key: str) -> str:
    """What is said of a frame, for a line that begins with its key."""
    rest = said.removeprefix("frame ").removeprefix(key)
    return rest.lstrip(":, ") if rest[:1] in (":", ",") else said


def _record(outcome: Outcome) -> dict[str, Any]:
    record: dict[str, Any] = {"key": outcome.key, "outcome": outcome.word}
    if isinstance(outcome, NotSent):
        record["error"] = _problem(outcome)
    else:
        record["frame_id"] = outcome.frame_id
    return record


def _problem(outcome: NotSent) -> dict[str, Any]:
    error = outcome.error
    if isinstance(error, ApiError):
        return error.problem
    return {"code": "unreadable", "detail": _said(error)}


def _said(error: Exception) -> str:
    """The error's text, without the number of the system's own."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _line(problem: NotSent) -> str:
    error = problem.error
    faults = error.errors if isinstance(error, ApiError) else ()
    # A single fault is what the error itself says.
    more = "".join(f"\n    {fault}" for fault in faults if len(faults) > 1)
    if isinstance(error, ApiError) and error.more_errors:
        more += f"\n    and {error.more_errors} more"
    said = without_key(_said(error), problem.key)
    return f"refused: {problem.key}: {said}{more}"
