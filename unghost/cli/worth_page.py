"""The tables of `unghost worth-it`: as plain text, and as a page without script."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from unghost.cli.inspect_page import document, section

if TYPE_CHECKING:
    from filter_core.evaluation.arms import ArmObject, NoiseObject
    from filter_core.evaluation.scores import ConfusionObject
    from filter_core.evaluation.trials import ArmScore, ComparisonObject, SeededObject

_WIDTH, _ROW, _TITLES = 900, 30, 110

_LABELS: Final = (
    ("objects", "var(--kept-strong)"),
    ("doubtful", "var(--unmeasured-strong)"),
    ("ghosts", "var(--rejected-strong)"),
)

_LOST: Final = "fill:none;stroke:var(--rejected-strong);stroke-dasharray:3 3"

_LINE: Final = "stroke:var(--accent);stroke-width:3;vector-effect:none"


class Table(NamedTuple):
    """A table with what it shows; `tag` names it in plain output."""

    tag: str
    title: str
    hint: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


def noise_tables(noise: NoiseObject) -> list[Table]:
    """What the labels of each arm say: in all, by class, distance and pixels."""
    arms = noise["arms"]
    by_class = {name: arm["by_class"] for name, arm in arms.items()}
    by_band = {
        name: {part["band"]: part for part in arm["by_distance"]}
        for name, arm in arms.items()
    }
    by_pixels = zip(*(arm["by_pixels"] for arm in arms.values()), strict=True)
    labelled = [
        (
            of_arms[0]["pixels"],
            of_arms[0]["boxes"],
            *(part["labelled"] for part in of_arms),
        )
        for of_arms in by_pixels
    ]
    columns = ("labels", "ghosts", "doubtful", "misplaced", "objects lost")
    return [
        Table(
            "arm",
            "What a detector is told",
            f"{noise['frames']:,} frames have {noise['boxes']:,} boxes: "
            f"{noise['objects']:,} objects, {noise['ghosts']:,} ghosts, "
            f"{noise['doubtful']:,} doubtful.",
            ("arm", *columns, "precision", "recall", "F1"),
            [(name, *_noise_row(arm)) for name, arm in arms.items()],
        ),
        _wrong_labels("class", "Labels by class", by_class),
        _wrong_labels("metres", "Labels by distance", by_band),
        Table(
            "pixels",
            "Labels by visible pixels",
            "How many boxes with so many visible pixels are labelled.",
            ("visible pixels", "boxes", *arms),
            labelled,
        ),
    ]


def _noise_row(arm: ArmObject) -> Iterator[object]:
    yield from (arm["labels"], arm["kept_hidden"], arm["doubtful"], arm["misplaced"])
    yield arm["rejected_visible"]
    for score in (arm["precision"], arm["recall"], arm["f1"]):
        yield None if score is None else round(score["value"], 3)


def _wrong_labels(
    tag: str, title: str, parts: Mapping[str, Mapping[str, ConfusionObject]]
) -> Table:
    """What is wrong in each part, such as a class; `parts` are by arm, then by name."""
    rows = []
    for part, score in next(iter(parts.values())).items():
        cells = (arm[part] for arm in parts.values())
        wrong = (
            f"{cell['kept_hidden']} + {cell['rejected_visible']}" for cell in cells
        )
        rows.append((part, score["kept_visible"] + score["rejected_visible"], *wrong))
    hint = "Ghosts among the labels + objects without a label."
    return Table(tag, title, hint, (tag, "objects", *parts), rows)


def score_tables(comparison: ComparisonObject) -> list[Table]:
    """How good the detectors of each arm are: in all, by class and by distance."""
    arms, baseline = comparison["arms"], comparison["baseline"]
    scores = ("mAP50", "low", "high", "mAP50-95", "precision", "recall")
    return [
        Table(
            "detector",
            "Detectors",
            "Means over seeds and test sets, with 95 % intervals of mAP50. Tight: "
            "against rectangles around visible pixels. Own: against the arm's own "
            "labels, which flatters. False positives and those on ghosts: per frame.",
            ("arm", "trials", *scores, "tight", "own", "false", "on ghosts"),
            [(name, *_score_row(arm)) for name, arm in arms.items()],
        ),
        Table(
            "difference",
            f"mAP50 against {baseline}",
            "Paired: the same frames, seeds and steps. A difference is shown if its "
            "interval does not contain 0 and all of several seeds agree.",
            ("arm", "difference", "low", "high", "by seed", "shown"),
            [
                (
                    name,
                    *(
                        round(delta["map50"][key], 4)
                        for key in ("value", "low", "high")
                    ),
                    ", ".join(f"{v:+.4f}" for v in delta["map50"]["by_seed"].values()),
                    "yes" if delta["map50"]["shown"] else "no",
                )
                for name, delta in comparison["differences"].items()
            ],
        ),
        _by_part("AP50", "AP50 by class", "class", "ap50", arms),
        _by_part("recall", "Recall by distance", "metres", "recall", arms),
    ]


def _score_row(arm: ArmScore) -> Iterator[object]:
    yield arm["trials"]
    map50 = arm["map50"]
    yield from (
        round(number, 4) for number in (map50["value"], map50["low"], map50["high"])
    )
    yield round(arm["map50_95"]["value"], 4)
    yield from (round(number, 3) for number in arm["means"].values())


def _by_part(
    tag: str, title: str, part: str, number: str, arms: Mapping[str, ArmScore]
) -> Table:
    """One number of each class, or of each band of distance, by arm."""
    each = [
        arm["by_class" if part == "class" else "by_distance"] for arm in arms.values()
    ]
    rows = [
        (
            name,
            round(score["objects"]),
            *(
                round(scores[name][number], 3) if name in scores else None
                for scores in each
            ),
        )
        for name, score in each[0].items()
    ]
    return Table(tag, title, "", (part, "objects", *arms), rows)


def text_of(tables: Sequence[Table]) -> str:
    """Tables as plain text, with aligned columns."""
    lines = []
    for table in tables:
        rows = [
            ["" if cell is None else str(cell) for cell in row]
            for row in (table.columns, *table.rows)
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines += [table.title, *([table.hint] if table.hint else []), ""]
        lines += ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        lines.append("")
    return "\n".join(lines)


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
    parts = [header]
    if comparison is not None:
        arms, differences = comparison["arms"], comparison["differences"]
        of_arms, of_differences, *others = score_tables(comparison)
        map50 = {name: arm["map50"] for name, arm in arms.items()}
        parts.append(table_section(of_arms, _intervals(map50)))
        map50 = {name: difference["map50"] for name, difference in differences.items()}
        parts.append(table_section(of_differences, _intervals(map50)))
        parts += map(table_section, others)
    told, *others = noise_tables(noise)
    parts.append(table_section(told, _bars(noise["arms"])))
    parts += map(table_section, others)
    return document(html.escape(title), parts)


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
    marks = [
        *((name, f"background:{color}") for name, color in _LABELS),
        ("objects lost", "border:1px dashed var(--rejected-strong)"),
    ]
    spans = "".join(
        f'<span><i style="{style}"></i>{name}</span>' for name, style in marks
    )
    bars = _svg(_ROW * len(arms) + 8, "The labels of each arm", parts)
    return f'{bars}<p class="legend">{spans}</p>'


def _intervals(scores: Mapping[str, SeededObject]) -> str:
    """The value of each arm with its interval, and a small mark for each seed."""
    if not scores:
        return ""
    low = min(0.0, *(score["low"] for score in scores.values()))
    high = max(0.0, *(score["high"] for score in scores.values()))
    scale = (_WIDTH - _TITLES - 90) / max(high - low, 1e-9)

    def x(value: float) -> float:
        return _TITLES + (value - low) * scale

    height = _ROW * len(scores) + 8
    parts = [_path(f"M{x(0):.1f} 0V{height}", "stroke:var(--line-strong)")]
    for number, (name, score) in enumerate(scores.items()):
        y = _ROW * number + 18
        parts.append(_text(_TITLES - 10, y + 5, name, anchor="end"))
        parts.append(_path(f"M{x(score['low']):.1f} {y}H{x(score['high']):.1f}", _LINE))
        for value in score["by_seed"].values():
            parts.append(
                _path(f"M{x(value):.1f} {y - 8}v16", "stroke:var(--text-soft)")
            )
        parts.append(
            f'<circle cx="{x(score["value"]):.1f}" cy="{y}" r="5" '
            'style="fill:var(--accent)"/>'
        )
        end = x(max(score["high"], *score["by_seed"].values(), score["value"]))
        parts.append(_text(end + 10, y + 5, f"{score['value']:.3f}"))
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
