"""`--fail-if`: conditions under which `filter`, `push` and `stats` end with code 4."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import eq, ge, gt, le, lt
from pathlib import Path
from typing import Annotated, Final, TypeAlias
from xml.sax.saxutils import quoteattr

import typer

from unghost.cli.options import written_file
from unghost.cli.screen import GATE, Screen

_OPERATORS: Final = {">": gt, ">=": ge, "<": lt, "<=": le, "=": eq}
_CONDITION: Final = re.compile(
    r"\s*(?P<name>[a-z_]+)\s*(?P<operator>>=|<=|=|>|<)"
    r"\s*(?P<limit>[0-9]+(?:\.[0-9]+)?)\s*(?P<percent>%?)\s*"
)
OF_FRAMES: Final = ("frames", "refused")
NAMES: Final = (*OF_FRAMES, "boxes", "kept", "rejected", "unmeasured", "unmapped")
"""What every condition may be about; percent are of all frames or of all boxes."""
_REPORTS: Final = (".xml", ".md")


_Checked: TypeAlias = tuple[str, str, bool]
"""A condition, its figure, and whether it holds, which it must not."""


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """Conditions under which a command ends with exit code 4."""

    fail_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONDITION",
            help="End with exit code 4 if this holds, such as 'rejected > 5%' or "
            f"'unmapped > 0': one of {', '.join(NAMES)}, then >, >=, <, <= or =, then "
            "a number, or a share of all frames or boxes in percent. May be repeated.",
        ),
    ] = None
    gate_report: Annotated[
        Path | None,
        written_file(
            metavar="FILE",
            help="Write the conditions and their figures: as JUnit's XML (.xml) or as "
            "Markdown (.md).",
        ),
    ] = None

    def __post_init__(self) -> None:
        """Refuse a condition that cannot be read, before any work is done."""
        report = self.gate_report
        if report is not None and report.suffix not in _REPORTS:
            raise typer.BadParameter(
                f"--gate-report {report}: expected a name that ends in "
                f"{' or '.join(_REPORTS)}"
            )
        for text in self.fail_if or ():
            _condition(text)

    def check(self, counts: Mapping[str, int], screen: Screen, title: str) -> None:
        """Print each condition with its figure, and write the report.

        `counts` are how many there are of each of `NAMES`, and `title` says in the
        report what was looked at. Ends the command with code 4 if a condition holds.
        """
        checked = []
        for text in self.fail_if or ():
            condition = _condition(text)
            name, gate = condition["name"], text.strip()
            count = counts[name]
            whole_name = "frames" if name in OF_FRAMES else "boxes"
            whole = counts[whole_name]
            percent = 100 * count / whole if whole else 0.0
            value, figure = float(count), f"{count:,}"
            if condition["percent"]:
                value = percent
                figure = f"{percent:.2f}% ({count:,} of {whole:,} {whole_name})"
            holds = _OPERATORS[condition["operator"]]
            has_failed = holds(value, float(condition["limit"]))
            checked.append((gate, figure, has_failed))
            result = "failed" if has_failed else "passed"
            screen.note(f"gate {result}: {gate}, it is {figure}")
        if self.gate_report is not None:
            as_text = _junit if self.gate_report.suffix == ".xml" else _markdown
            self.gate_report.write_text(as_text(title, checked), "utf-8")
        if any(has_failed for _, _, has_failed in checked):
            raise typer.Exit(GATE)


def _condition(text: str) -> re.Match[str]:
    """The parts of a condition, by the names of its groups: ``rejected > 5%``."""
    condition = _CONDITION.fullmatch(text)
    if condition is None:
        raise typer.BadParameter(
            f"--fail-if: expected a condition such as 'rejected > 5%', found {text!r}"
        )
    name = condition["name"]
    if name not in NAMES:
        from filter_core.values import similar

        meant = similar(name, NAMES)
        hint = f"; did you mean {meant!r}?" if meant else ""
        raise typer.BadParameter(
            f"--fail-if: expected one of {', '.join(NAMES)}, found {name!r}{hint}"
        )
    return condition


def _junit(title: str, checked: Sequence[_Checked]) -> str:
    failures = sum(has_failed for _, _, has_failed in checked)
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<testsuite name={quoteattr(title)} tests={quoteattr(str(len(checked)))} "
        f"failures={quoteattr(str(failures))}>",
    ]
    for gate, figure, has_failed in checked:
        message = quoteattr(f"{gate}: it is {figure}")
        inner = f"<failure message={message}/>" if has_failed else ""
        name = quoteattr(f"not {gate}")
        lines.append(f'  <testcase classname="unghost" name={name}>{inner}</testcase>')
    return "\n".join([*lines, "</testsuite>", ""])


def _markdown(title: str, checked: Sequence[_Checked]) -> str:
    rows = [
        f"| `{gate}` | {figure} | {'failed' if has_failed else 'passed'} |"
        for gate, figure, has_failed in checked
    ]
    head = [f"### {title}", "", "| must not hold | it is | gate |", "|---|---|---|"]
    return "\n".join([*head, *rows, ""])
