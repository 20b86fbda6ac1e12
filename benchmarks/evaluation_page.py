"""docs/evaluation.md and its picture, from one comparison."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

from unghost.cli.score_plot import f1_plot

DOCS = Path(__file__).resolve().parents[1] / "docs"
PICTURE = "pictures/evaluation.svg"
NAMES = {
    "semantic": "semantic (the paper's profile)",
    "ordered": "ordered",
    "depth": "depth",
    "depth_center": "depth at the centre (a rival)",
    "instance": "instance, assigned",
    "lidar": "LiDAR (a rival)",
}


def write_page(found: dict[str, Any]) -> None:
    """Write the page's tables between its words, and the picture."""
    template = Template(
        (Path(__file__).with_name("evaluation.md.in")).read_text("utf-8")
    )
    channels = found["solid"]["channels"]
    named = found["named"]["channels"]["instance"]
    rows = [
        (title, channels[name], found["cost"][name]) for name, title in NAMES.items()
    ]
    rows.append(("instance, ids recorded", named, found["cost"]["instance"]))
    page = template.substitute(
        frames=found["street"]["frames"],
        seed=found["street"]["seed"],
        solid_frames=found["solid"]["frames"],
        solid_boxes=f"{found['solid']['boxes']:,}",
        flat_frames=found["flat"]["frames"],
        main=_table(rows),
        bands=_bands(rows),
        flat=_table(
            [
                (title, found["flat"]["channels"][name], None)
                for name, title in NAMES.items()
            ]
        ),
        projection=_table(
            [
                ("clipped", channels["semantic"], None),
                ("naive", found["naive"]["channels"]["semantic"], None),
            ]
        ),
        one_pixel=_percent(found["one_pixel"]["channels"]["ordered"]["f1"]["value"]),
        near=_percent(_band(channels["ordered"], "0-50")),
    )
    (DOCS / "evaluation.md").write_text(page, "utf-8")
    (DOCS / PICTURE).parent.mkdir(exist_ok=True)
    (DOCS / PICTURE).write_text(
        f1_plot([(title, score) for title, score, _ in rows]), "utf-8"
    )


def _table(rows: list[tuple[str, dict[str, Any], float | None]]) -> str:
    with_cost = any(cost is not None for *_, cost in rows)
    head = "| channel | precision | recall | F1 (95 %) | ghosts kept | visible lost |"
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


def _bands(rows: list[tuple[str, dict[str, Any], float | None]]) -> str:
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
