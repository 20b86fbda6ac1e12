"""`unghost replay`: what the paper's filter, its code and the best evidence decide.

The paper's text and its published code are the same filter with different rules of
equality and of sizes. Both are compared with the best evidence that the frames have.
"""

from __future__ import annotations

import heapq
import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Final

import typer

from unghost.cli import sources
from unghost.cli.local.draw import Judge, Judged, draw_frames
from unghost.cli.local.filter import line_output
from unghost.cli.options import OutputOptions, written_file
from unghost.cli.screen import Screen, partly_done
from unghost.cli.summary import LOOKED_AT

_PAPER: Final = "the paper"
_CODE: Final = "its code"
"""What both are called on pictures."""

_THREE: Final = ("paper", "code", "best")
"""The filters whose verdicts, with their reasons, are a kind of difference."""
_SAID: Final = ("verdict", "reason", "evidence", "match_percent", "explanation")


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(OutputOptions, sources.LocalFilterOptions):
    output: Annotated[
        Path | None,
        written_file(
            "--output",
            "-o",
            metavar="FILE",
            help="A line of JSON for each box: its three verdicts with their reasons.",
        ),
    ] = None
    pictures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A new folder for pictures of the worst frames, as `draw` makes them.",
            file_okay=False,
        ),
    ] = None
    worst: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="How many frames are drawn: those in which most boxes differ.",
        ),
    ] = 50


@sources.reads_archives
def replay(options: ReplayOptions) -> None:
    """Compare the paper's filter, its published code and the best evidence, by box.

    Needs no server. Prints how many boxes each kind of difference has; thresholds and
    classes of --config are those of all three. Exit code 3 if some frames could not be
    read.
    """
    from filter_core.evaluation.arms import Arm
    from filter_core.formats.files import new_folder
    from filter_core.local import in_order

    description = options.description_of(options.source)
    base = sources.read_config(options.config, options, description, options.screen)
    arms = [Arm(kind) for kind in ("auto", "paper", "carlasimu")]
    # Arms without a configuration leave the labels as they are: these three have one.
    best, paper, code = (config for arm in arms if (config := arm.config(base)))
    frames = sources.open_source(options.source, options.layout, description)
    first = list(islice(frames, LOOKED_AT))
    shown = sources.shown_by(first, best, set(best.channels), options.screen)
    judge = Judge(best, {_PAPER: paper, _CODE: code})
    comparison = _Comparison(options.worst if options.pictures else 0)
    with ExitStack() as stack:
        write: Callable[[bytes], object] | None = None
        if options.output:
            write = stack.enter_context(line_output(options.output))
        folder = None
        if options.pictures:
            folder = stack.enter_context(new_folder(options.pictures))
        coming = in_order(judge.frame, shown.of(frames), options.workers)
        for judged in judge.watch(coming, options.screen, "replay"):
            records = comparison.add(judged)
            if write:
                write("".join(f"{json.dumps(record)}\n" for record in records).encode())
        if folder:
            draw_frames(folder, comparison.worst(), options)
    comparison.report(options.screen, judge.failed)
    if judge.failed:
        raise partly_done(comparison.frames)


class _Comparison:
    """Counts kinds of differences, and keeps the frames with most of them."""

    def __init__(self, worst: int) -> None:
        self.frames = 0
        self._boxes = 0
        self._wrong: Counter[tuple[str, str]] = Counter()
        self._kinds: Counter[tuple[str, ...]] = Counter()
        self._by: Counter[str] = Counter()
        self._worst: list[tuple[int, int, Judged]] = []
        self._most = worst

    def add(self, judged: Judged) -> list[dict[str, object]]:
        """Count a frame; returns a record of each box."""
        self.frames += 1
        self._boxes += len(judged.decisions)
        rivals = (judged.rivals[_PAPER], judged.rivals[_CODE])
        records = []
        for best, paper, code in zip(judged.decisions, *rivals, strict=True):
            three = {"paper": paper, "code": code, "best": best}
            record: dict[str, object] = {
                name: {key: decision[key] for key in _SAID}
                for name, decision in three.items()
            }
            whose = {"key": judged.source.key, "id": best["id"], "class": best["class"]}
            records.append(whose | record)
            self._by[best["evidence"] or "none"] += 1
            if len({decision["verdict"] for decision in three.values()}) > 1:
                words = (
                    f"{decision['verdict']}: {decision['reason'].replace('_', ' ')}"
                    for decision in three.values()
                )
                self._kinds[tuple(words)] += 1
                for name, decision in (("paper", paper), ("code", code)):
                    if decision["verdict"] != best["verdict"]:
                        self._wrong[name, best["verdict"]] += 1
        if self._most and judged.flips:
            # The earlier of two frames that are as bad stays.
            heapq.heappush(self._worst, (judged.flips, -self.frames, judged))
            if len(self._worst) > self._most:
                heapq.heappop(self._worst)
        return records

    def worst(self) -> Iterator[Judged]:
        """The frames with most differences, the worst first."""
        return (judged for _, _, judged in sorted(self._worst, reverse=True))

    def report(self, screen: Screen, failed: int) -> None:
        """Print the kinds of differences, and what each of both gets wrong."""
        kinds = self._kinds.most_common()
        wrong = {
            name: {
                "ghosts_kept": self._wrong[name, "rejected"],
                "objects_lost": self._wrong[name, "kept"],
            }
            for name in ("paper", "code")
        }
        counts = {"frames": self.frames, "boxes": self._boxes, "failed": failed}
        differing = self._kinds.total()
        rows = [
            {**dict(zip(_THREE, kind, strict=True)), "boxes": count}
            for kind, count in kinds
        ]
        screen.record(
            {
                **counts,
                "differ": differing,
                **wrong,
                "best_evidence": dict(self._by),
                "kinds": rows,
            },
            "\t".join(f"{count} {name}" for name, count in counts.items())
            + f"\t{differing} differ",
        )
        columns = ("boxes", *_THREE)
        screen.table(
            columns, [(count, *kind) for kind, count in kinds], tag="kind", headed=True
        )
        for name, of in (("paper", "the paper"), ("code", "its code")):
            screen.note(
                f"{of}: keeps {wrong[name]['ghosts_kept']} boxes that the best "
                f"evidence rejects, loses {wrong[name]['objects_lost']} that it keeps"
            )
        used = ", ".join(f"{name} {count}" for name, count in self._by.most_common())
        screen.note(f"the best evidence, by boxes: {used or 'none'}")
