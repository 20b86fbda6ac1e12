"""What became of the frames of a push, counted and told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from unghost.cli.screen import Screen
from unghost.errors import ApiError
from unghost.upload import NotSent, Outcome, Sent

if TYPE_CHECKING:
    from filter_core.formats.frame_source import Unmatched

_LISTED: Final = 20
_WORDS: Final = ("stored", "already_there", "refused")
_VERDICTS: Final = ("kept", "rejected", "unmeasured")


class PushReport:
    """Counts outcomes; tells each one as a JSON line, or all of them at the end."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._verdicts: Counter[str] = Counter()
        self._outcomes: Counter[str] = Counter()
        self._unmapped: Counter[str] = Counter()
        self.problems: list[NotSent] = []

    @property
    def seen(self) -> int:
        """Frames that are done with, one way or the other."""
        return self._outcomes.total()

    @property
    def succeeded(self) -> int:
        """Frames that the server has."""
        return self.seen - len(self.problems)

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self._outcomes[outcome.word] += 1
        if isinstance(outcome, Sent):
            decisions = outcome.stored.decisions
            self._verdicts.update(each.verdict for each in decisions)
            self._unmapped.update(
                each.class_name or "none"
                for each in decisions
                if each.reason == "unmapped_class"
            )
        if isinstance(outcome, NotSent):
            self.problems.append(outcome)
        self._screen.record(_record(outcome))

    def print_summary(self, unmatched: Sequence[Unmatched], dataset: str) -> None:
        """Say what happened; the problems one by one."""
        note = self._screen.note
        for text in _shortened([_line(problem) for problem in self.problems]):
            note(text)
        for class_name, count in self._unmapped.most_common(_LISTED):
            note(f"rejected: {count} boxes, since class {class_name!r} has no tags")
        for text in _shortened(
            [f"not matched: {file.path}: {file.why}" for file in unmatched]
        ):
            note(text)
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


def _record(outcome: Outcome) -> dict[str, Any]:
    record: dict[str, Any] = {"key": outcome.key, "outcome": outcome.word}
    if isinstance(outcome, NotSent):
        record["error"] = _problem(outcome)
    return record


def _problem(outcome: NotSent) -> dict[str, Any]:
    error = outcome.error
    if isinstance(error, ApiError):
        return error.problem
    return {"code": "unreadable", "detail": str(error)}


def _line(problem: NotSent) -> str:
    error = problem.error
    faults = error.errors if isinstance(error, ApiError) else ()
    # A single fault is what the error itself says.
    more = "".join(f"\n    {fault}" for fault in faults if len(faults) > 1)
    said = str(error).removeprefix(f"frame {problem.key}").lstrip(":, ")
    return f"refused: {problem.key}: {said}{more}"


def _shortened(lines: list[str]) -> list[str]:
    if len(lines) <= _LISTED:
        return lines
    return [*lines[:_LISTED], f"... and {len(lines) - _LISTED} more (--json has all)"]
