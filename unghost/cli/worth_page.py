"""The page of `unghost worth-it`: one file that opens from the disk, without script."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from unghost.cli.inspect_page import document, section
from unghost.cli.worth_tables import Table, noise_tables, score_tables

if TYPE_CHECKING:
    from filter_core.evaluation.arms import ArmObject, NoiseObject
    from filter_core.evaluation.trials import ComparisonObject, SeededObject

_WIDTH, _ROW, _TITLES = 900, 30, 110

_LABELS: Final = (
    ("objects", "var(--kept-strong)"),
    ("doubtful", "var(--unmeasured-strong)"),
    ("ghosts", "var(--rejected-strong)"),
)

_LOST: Final = "fill:none;stroke:var(--rejected-strong);stroke-dasharray:3 3"

_LINE: Final = "stroke:var(--accent);stroke-width:3;vector-effect:none"


def worth_page(
    title: str,
    texts: Sequence[str],
    noise: NoiseObject,
    comparison: ComparisonObject | None = None,
) -> str:
    """Label noise, and the comparison of detectors if there is one, as HTML.

    `texts` are sentences below the title.
    """
    said = "".join(f"<p>{html.escape(text)}</p>" for text in texts)
    header = f"<header>\n<h1>{html.escape(title)}</h1>\n{said}</header>"
    scores = [] if comparison is None else _score_sections(comparison)
    return document(html.escape(title), [header, *scores, *_noise_sections(noise)])


def _noise_sections(noise: NoiseObject) -> Iterator[str]:
    first, *others = noise_tables(noise)
    yield table_section(first, _bars(noise["arms"]) + _legend())
    yield from map(table_section, others)


def _score_sections(comparison: ComparisonObject) -> Iterator[str]:
    scores, differences, *others = score_tables(comparison)
    map50 = {name: arm["map50"] for name, arm in comparison["arms"].items()}
    yield table_section(scores, _intervals(map50))
    against = {name: one["map50"] for name, one in comparison["differences"].items()}
    yield table_section(differences, _intervals(against))
    yield from map(table_section, others)


def table_section(table: Table, drawing: str = "") -> str:
    """A table as a section of a page, below its drawing."""
    hint = f'<p class="hint">{html.escape(table.hint)}</p>' if table.hint else ""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in table.columns)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in table.rows)
    cells = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return section(html.escape(table.title), hint + drawing + cells)


def _cell(value: object) -> str:
    text = "" if value is None else f"{value:,}" if isinstance(value, int) else value
    return f"<td>{html.escape(str(text))}</td>"


def _bars(arms: Mapping[str, ArmObject]) -> str:
    """The labels of each arm: objects, doubtful ones and ghosts; and objects lost."""
    most = max(arm["labels"] + arm["rejected_visible"] for arm in arms.values())
    scale = (_WIDTH - _TITLES - 90) / max(most, 1)
    parts = []
    for number, (name, arm) in enumerate(arms.items()):
        y, x = _ROW * number + 4, float(_TITLES)
        parts.append(_text(_TITLES - 10, y + 15, name, anchor="end"))
        counts = (arm["kept_visible"], arm["doubtful"], arm["kept_hidden"])
        for count, (_, color) in zip(counts, _LABELS, strict=True):
            style = f"fill:{color};stroke:none"
            parts.append(_rectangle(x, y, count * scale, style))
            x += count * scale
        lost = arm["rejected_visible"]
        parts.append(_rectangle(x, y, lost * scale, _LOST))
        said = f"{arm['kept_hidden']:,} + {lost:,}"
        parts.append(_text(x + lost * scale + 8, y + 15, said))
    return _svg(_ROW * len(arms) + 8, "The labels of each arm", parts)


def _legend() -> str:
    marks = [
        *((name, f"background:{color}") for name, color in _LABELS),
        ("objects lost", "border:1px dashed var(--rejected-strong)"),
    ]
    spans = "".join(
        f'<span><i style="{style}"></i>{name}</span>' for name, style in marks
    )
    return f'<p class="legend">{spans}</p>'


def _intervals(scores: Mapping[str, SeededObject]) -> str:
    """The value of each arm with its interval, and a small mark for each seed."""
    if not scores:
        return ""
    low = min(0.0, *(one["low"] for one in scores.values()))
    high = max(0.0, *(one["high"] for one in scores.values()))
    scale = (_WIDTH - _TITLES - 90) / max(high - low, 1e-9)

    def x(value: float) -> float:
        return _TITLES + (value - low) * scale

    height = _ROW * len(scores) + 8
    parts = [_path(f"M{x(0):.1f} 0V{height}", "stroke:var(--line-strong)")]
    for number, (name, one) in enumerate(scores.items()):
        y = _ROW * number + 18
        parts.append(_text(_TITLES - 10, y + 5, name, anchor="end"))
        parts.append(_path(f"M{x(one['low']):.1f} {y}H{x(one['high']):.1f}", _LINE))
        for value in one["by_seed"].values():
            parts.append(
                _path(f"M{x(value):.1f} {y - 8}v16", "stroke:var(--text-soft)")
            )
        parts.append(
            f'<circle cx="{x(one["value"]):.1f}" cy="{y}" r="5" '
            'style="fill:var(--accent)"/>'
        )
        end = x(max(one["high"], *one["by_seed"].values(), one["value"]))
        parts.append(_text(end + 10, y + 5, f"{one['value']:.3f}"))
    return _svg(height, "Values with their intervals", parts)


def _svg(height: float, label: str, parts: Iterable[str]) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height:.0f}" role="img" '
        f'style="background:none" aria-label="{html.escape(label)}">'
        f"{''.join(parts)}</svg>"
    )


def _path(line: str, style: str) -> str:
    return f'<path d="{line}" style="fill:none;{style}"/>'


def _rectangle(x: float, y: float, width: float, style: str) -> str:
    return (
        f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="20" style="{style}"/>'
    )


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" '
        'style="fill:var(--text);stroke:none;font-size:13px;font-weight:400">'
        f"{html.escape(text)}</text>"
    )
