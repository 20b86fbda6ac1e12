"""Writes docs/evaluation.md and its plot from one comparison."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

from unghost.cli.local.evaluate import interval_plot

DOCS = Path(__file__).resolve().parents[1] / "docs"
PLOT = "pictures/evaluation.svg"
NAMES = {
    "semantic": "semantic (the paper's profile)",
    "ordered": "ordered",
    "depth": "depth",
    "depth_center": "depth at the centre (a rival)",
    "instance": "instance, assigned",
    "lidar": "LiDAR (a rival)",
}


def write_page(found: dict[str, Any]) -> None:
    """Fill the tables into the page's template, and draw the plot."""
    template = Template(
        (Path(__file__).with_name("evaluation.md.in")).read_text("utf-8")
    )
    recorded, crowded = found["recorded"], found["crowded"]
    channels = recorded["solid"]["channels"]
    rows = _rows(recorded)
    page = template.substitute(
        frames=found["frames"],
        seed=found["seed"],
        solid=_counts(recorded["solid"]),
        crowd=_counts(crowded["solid"]),
        per_frame=_per_frame(recorded["solid"]),
        crowd_per_frame=_per_frame(crowded["solid"]),
        flat_frames=recorded["flat"]["frames"],
        main=_table(rows),
        bands=_bands(rows),
        crowd_main=_table(_rows(crowded)),
        crowd_bands=_bands(_rows(crowded)),
        lost=_lost(recorded["lost"], crowded["lost"]),
        flat=_table(
            [
                (title, recorded["flat"]["channels"][name], None)
                for name, title in NAMES.items()
            ]
        ),
        projection=_table(
            [
                ("clipped", channels["semantic"], None),
                ("naive", recorded["naive"]["channels"]["semantic"], None),
            ]
        ),
        **_one_pixel(recorded, crowded),
    )
    (DOCS / "evaluation.md").write_text(page, "utf-8")
    (DOCS / PLOT).parent.mkdir(exist_ok=True)
    label = "F1 of each kind of evidence with its 95 % interval"
    scores = [(title, score["f1"]) for title, score, _ in rows]
    (DOCS / PLOT).write_text(interval_plot(label, scores), "utf-8")


_Row = tuple[str, dict[str, Any], float | None]


def _rows(street: dict[str, Any]) -> list[_Row]:
    """The kinds of evidence of one street with their costs."""
    channels, cost = street["solid"]["channels"], street["cost"]
    rows: list[_Row] = [
        (title, channels[name], cost[name]) for name, title in NAMES.items()
    ]
    named = street["named"]["channels"]["instance"]
    return [*rows, ("instance, ids recorded", named, cost["instance"])]


def _counts(evaluation: dict[str, Any]) -> str:
    return f"{evaluation['frames']} frames, {evaluation['boxes']:,} boxes"


def _per_frame(evaluation: dict[str, Any]) -> str:
    return f"{evaluation['boxes'] / evaluation['frames']:.0f}"


def _one_pixel(recorded: dict[str, Any], crowded: dict[str, Any]) -> dict[str, str]:
    found = {"one_pixel": recorded, "crowd_one_pixel": crowded}
    return {
        name: _percent(street["one_pixel"]["channels"]["ordered"]["f1"]["value"])
        for name, street in found.items()
    }


def _lost(recorded: list[dict[str, int]], crowded: list[dict[str, int]]) -> str:
    lines = [
        "| pixels seen | visible | lost | visible, crowded | lost, crowded |",
        "|---|--:|--:|--:|--:|",
    ]
    ends = [f"-{group['from'] - 1}" for group in recorded[1:]] + [" and more"]
    for end, here, there in zip(ends, recorded, crowded, strict=True):
        cells = (here["visible"], here["lost"], there["visible"], there["lost"])
        counts = " | ".join(f"{count:,}" for count in cells)
        lines.append(f"| {here['from']}{end} | {counts} |")
    return "\n".join(lines)


def _table(rows: list[_Row]) -> str:
    with_cost = any(cost is not None for *_, cost in rows)
    head = "| evidence | precision | recall | F1 (95 %) | ghosts kept | visible lost |"
    lines = [head + (" cost |" if with_cost else "")]
    lines.append("|---|--:|--:|--:|--:|--:|" + ("--:|" if with_cost else ""))
    for title, score, cost in rows:
        f1 = score["f1"]
        line = (
            f"| {title} | {_percent(_value(score, 'precision'))} | "
            f"{_percent(_value(score, 'recall'))} | {_percent(f1['value'])} "
            f"({_percent(f1['low'])}-{_percent(f1['high'])}) | "
            f"{score['kept_hidden']:,} | {score['rejected_visible']:,} |"
        )
        lines.append(line + (f" {cost:.1f}x |" if cost is not None else ""))
    return "\n".join(lines)


def _bands(rows: list[_Row]) -> str:
    names = [band["band"] for band in rows[0][1]["by_distance"]]
    lines = ["| F1 by distance | " + " | ".join(f"{name} m" for name in names) + " |"]
    lines.append("|---|" + "--:|" * len(names))
    for title, score, _ in rows:
        cells = [_percent(_band(score, name)) for name in names]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _band(score: dict[str, Any], name: str) -> float | None:
    for band in score["by_distance"]:
        if band["band"] == name and band["f1"] is not None:
            value: float = band["f1"]["value"]
            return value
    return None


def _value(score: dict[str, Any], name: str) -> float | None:
    return None if score[name] is None else score[name]["value"]


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
