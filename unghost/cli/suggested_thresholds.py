"""`unghost evaluate --suggest`: thresholds from the truth, as a table and as a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import typer

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.evaluation.thresholds import ClassSuggestion, Goal, TruthCollector
    from filter_core.local import KnownBoxes
    from unghost.cli.screen import Screen

_COLUMNS: Final = ("class", "current", "suggested", "low", "high", "F1 now", "F1 then")
_TAG: Final = "threshold"


class _Options(Protocol):
    @property
    def suggest(self) -> bool: ...

    @property
    def recall(self) -> float | None: ...

    @property
    def config_out(self) -> Path | None: ...


@dataclass
class ThresholdsAsked:
    """What was asked for about thresholds; `collector` None: nothing."""

    collector: TruthCollector | None
    goal: Goal
    file: Path | None

    @classmethod
    def of(cls, options: _Options, config: FilterConfig) -> ThresholdsAsked:
        """From the command line; options that need `--suggest` are refused without."""
        from filter_core.evaluation.thresholds import Goal, TruthCollector

        if not options.suggest:
            if options.recall is not None or options.config_out is not None:
                raise typer.BadParameter(
                    "--recall and --config-out belong to --suggest"
                )
            return cls(None, Goal(), None)
        goal = Goal() if options.recall is None else Goal("recall", options.recall)
        return cls(TruthCollector(config), goal, options.config_out)

    def add(self, boxes: KnownBoxes) -> None:
        """Boxes of a frame."""
        if self.collector is not None:
            self.collector.add(boxes.evidence, boxes.visible)

    @cached_property
    def found(self) -> list[ClassSuggestion]:
        """A threshold for each class that has boxes of both kinds."""
        return [] if self.collector is None else self.collector.suggestions(self.goal)

    def as_dict(self) -> dict[str, Any]:
        """For JSON; nothing if nothing was asked for."""
        if self.collector is None:
            return {}
        return {"suggested": [one.as_dict() for one in self.found]}

    def finish(self, screen: Screen) -> None:
        """Print the table and write the file."""
        if self.collector is None:
            return
        screen.table(_COLUMNS, [_row(one) for one in self.found], tag=_TAG)
        if not self.found:
            screen.note("no class has both visible and hidden boxes to suggest from")
        if self.file is not None:
            self.file.write_text(_yaml(self.collector.config, self.found), "utf-8")
            screen.note(f"wrote {self.file}")


def _row(one: ClassSuggestion) -> tuple[object, ...]:
    found = one.found
    scores = (found.at_current.f1, found.at_suggested.f1)
    return (
        one.class_name,
        one.current,
        found.threshold,
        *(round(bound, 2) for bound in found.interval),
        *(None if score is None else round(score, 3) for score in scores),
    )


def _yaml(config: FilterConfig, found: list[ClassSuggestion]) -> str:
    """Everything that the evaluation used, with the new thresholds."""
    import yaml

    from filter_core.evaluation.thresholds import with_thresholds

    plain = with_thresholds(config, found).as_dict()
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)
