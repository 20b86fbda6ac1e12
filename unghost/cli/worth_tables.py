"""The tables of `unghost worth-it`, for the terminal, for its text and for its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from filter_core.evaluation.arms import ArmObject, NoiseObject
    from filter_core.evaluation.scores import ConfusionObject
    from filter_core.evaluation.trials import ArmScore, ComparisonObject


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
        name: {one["band"]: one for one in arm["by_distance"]}
        for name, arm in arms.items()
    }
    wrong = "Ghosts among the labels + objects without a label."
    groups = next(iter(arms.values()))["by_pixels"]
    labelled = [
        (one["pixels"], one["boxes"], *(_labelled(arm, row) for arm in arms.values()))
        for row, one in enumerate(groups)
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
        Table(
            "class",
            "Labels by class",
            wrong,
            ("class", "objects", *arms),
            list(_parts(by_class)),
        ),
        Table(
            "metres",
            "Labels by distance",
            wrong,
            ("metres", "objects", *arms),
            list(_parts(by_band)),
        ),
        Table(
            "pixels",
            "Labels by visible pixels",
            "How many boxes with so many visible pixels are labelled.",
            ("visible pixels", "boxes", *arms),
            labelled,
        ),
    ]


def _labelled(arm: ArmObject, row: int) -> int:
    return arm["by_pixels"][row]["labelled"]


def _noise_row(arm: ArmObject) -> Iterator[object]:
    yield from (arm["labels"], arm["kept_hidden"], arm["doubtful"], arm["misplaced"])
    yield arm["rejected_visible"]
    for one in (arm["precision"], arm["recall"], arm["f1"]):
        yield None if one is None else round(one["value"], 3)


def _parts(
    parts: Mapping[str, Mapping[str, ConfusionObject]],
) -> Iterator[tuple[object, ...]]:
    first = next(iter(parts.values()))
    for part, score in first.items():
        cells = (arm[part] for arm in parts.values())
        wrong = (f"{one['kept_hidden']} + {one['rejected_visible']}" for one in cells)
        yield part, score["kept_visible"] + score["rejected_visible"], *wrong


def score_tables(comparison: ComparisonObject) -> list[Table]:
    """How good the detectors of each arm are: in all, by class and by distance."""
    arms, baseline = comparison["arms"], comparison["baseline"]
    return [
        Table(
            "detector",
            "Detectors",
            "Means over seeds and test sets, with 95 % intervals of mAP50. Tight: "
            "against rectangles around visible pixels. Own: against the arm's own "
            "labels, which flatters. False positives and those on ghosts: per frame.",
            (
                *("arm", "trials", "mAP50", "low", "high", "mAP50-95"),
                *("precision", "recall", "tight", "own", "false", "on ghosts"),
            ),
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
                    *(round(one["map50"][key], 4) for key in ("value", "low", "high")),
                    ", ".join(f"{v:+.4f}" for v in one["map50"]["by_seed"].values()),
                    "yes" if one["map50"]["shown"] else "no",
                )
                for name, one in comparison["differences"].items()
            ],
        ),
        _by_part("AP50", "AP50 by class", "class", "ap50", arms),
        _by_part("recall", "Recall by distance", "metres", "recall", arms),
    ]


def _score_row(arm: ArmScore) -> Iterator[object]:
    yield arm["trials"]
    map50 = arm["map50"]
    yield from (round(one, 4) for one in (map50["value"], map50["low"], map50["high"]))
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
            *(round(one[name][number], 3) if name in one else None for one in each),
        )
        for name, score in each[0].items()
    ]
    return Table(tag, title, "", (part, "objects", *arms), rows)


def text_of(tables: Sequence[Table]) -> str:
    """Tables as plain text, with aligned columns."""
    return "\n".join(_text_table(one) for one in tables)


def _text_table(table: Table) -> str:
    rows = [[*map(_cell, table.columns)], *([*map(_cell, row)] for row in table.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    )
    title = [table.title, table.hint] if table.hint else [table.title]
    return "\n".join([*title, "", *(line.rstrip() for line in lines), ""])


def _cell(value: object) -> str:
    return "" if value is None else str(value)
