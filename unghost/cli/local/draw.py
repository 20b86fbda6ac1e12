"""`unghost draw`: pictures of a folder's boxes before and after the filter, and a page.

Each frame gets a picture of all its boxes, one of those that are kept, and one with
these beside each other, the reasons, a rival's verdicts and the segmentation. A contact
sheet and a page that opens from the disk show all of them.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from unghost.cli import sources
from unghost.cli.options import OutputOptions, read_file
from unghost.cli.screen import Kinds, Screen, partly_done, refusal
from unghost.cli.summary import LOOKED_AT

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.decisions.record import Decision
    from filter_core.formats.reading import FrameSource
    from filter_core.images.drawing import DrawnBox, Picture
    from filter_core.pipeline import SegmentationReport


@dataclass(frozen=True, kw_only=True)
class DrawOptions(OutputOptions, sources.LocalFilterOptions):
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="DIR", help="A new folder.", file_okay=False
        ),
    ]
    against: Annotated[
        Path | None,
        read_file(
            metavar="FILE",
            help="A rival's configuration (YAML), whose verdicts are drawn beside; "
            "with --only flips, default: the paper's filter.",
        ),
    ] = None
    only: Annotated[
        Literal["flips"] | None,
        typer.Option(help="flips: only frames in which the two verdicts differ."),
    ] = None
    worst: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Only the N frames with most flips, or without a rival most rejected "
            "boxes; these come first.",
        ),
    ] = None
    edges: Annotated[
        bool,
        typer.Option(
            "--edges", help="Draw the edges of 3D boxes in place of rectangles."
        ),
    ] = False


@sources.reads_archives
def draw(options: DrawOptions) -> None:
    """Draw the boxes of a folder's frames before and after the filter.

    Needs no server. Writes before/, after/ and side/ (PNG), the contact sheet
    sheet.png, and the page index.html, which opens from the disk. Exit code 3 if some
    frames could not be drawn.
    """
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig
    from filter_core.formats.files import new_folder
    from filter_core.local import in_order

    description = options.description_of(options.source)
    config = sources.read_config(options.config, options, description, options.screen)
    rival = None
    if options.against is not None:
        rival = sources.read_config(
            options.against, options, description, options.screen
        )
    elif options.only == "flips":
        keys = {"profile": "paper", **description.config_keys(), **options.reading}
        rival = load_config(keys).config
        if rival == config:
            rival = FilterConfig.from_mapping({**keys, "evidence": "auto"})
    frames = sources.open_source(options.source, options.layout, description)
    first = list(islice(frames, LOOKED_AT))
    channels = {*config.channels, *(rival.channels if rival else ())}
    shown = sources.shown_by(first, config, channels, options.screen)
    judge = Judge(config, {"the rival": rival} if rival else {})
    with new_folder(options.output) as folder:
        judged = judge.watch(
            in_order(judge.frame, shown.of(frames), options.workers), options.screen
        )
        chosen: Iterable[Judged] = judged
        if options.only == "flips":
            chosen = (frame for frame in judged if frame.flips)
        if options.worst is not None:
            chosen = heapq.nlargest(
                options.worst,
                chosen,
                key=lambda frame: (frame.flips, frame.count("rejected")),
            )
        drawn = draw_frames(folder, chosen, options, edges=options.edges)
    counts = {"drawn": drawn, "failed": judge.failed}
    options.screen.record(
        {"output": str(options.output), **counts},
        "\t".join(f"{count} {name}" for name, count in counts.items()),
    )
    if judge.failed:
        raise partly_done(drawn)


def draw_frames(
    folder: Path,
    frames: Iterable[Judged],
    options: sources.LocalFilterOptions,
    *,
    edges: bool = False,
) -> int:
    """Write the pictures of frames, a contact sheet and a page; returns how many.

    `edges` draws those of 3D boxes in place of rectangles. The pictures are in the
    folders ``before``, ``after`` and ``side``.
    """
    from filter_core.formats.files import FileNames
    from filter_core.images.drawing import as_png
    from filter_core.images.sheet import MOST_TILES, page_of, sheet_of
    from filter_core.local import in_order

    names = FileNames(flat=True)
    painter = _Painter(folder, edges)
    stems = ((names.stem(frame.source.key), frame) for frame in frames)
    figures: list[str] = []
    tiles: list[Picture] = []
    reasons: Counter[str] = Counter()
    for figure, reasons_of_frame, tile in in_order(
        painter.frame, stems, options.workers
    ):
        figures.append(figure)
        reasons.update(reasons_of_frame)
        # Only some tiles are shown, and there may be a million frames.
        if len(tiles) < MOST_TILES:
            tiles.append(tile)
    sheet = sheet_of(tiles)
    if sheet is not None:
        (folder / "sheet.png").write_bytes(as_png(sheet))
    page = page_of(options.source.name, figures, reasons)
    (folder / "index.html").write_text(page, "utf-8")
    return len(figures)


class Judged(NamedTuple):
    """A frame with its decisions and those of rivals, or what is wrong with it."""

    source: FrameSource
    decisions: Sequence[Decision] = ()
    rivals: Mapping[str, Sequence[Decision]] = MappingProxyType({})
    report: SegmentationReport | None = None
    config: FilterConfig | None = None
    fault: str = ""

    @property
    def flips(self) -> int:
        """How many boxes are not decided alike by all."""
        everyone = zip(self.decisions, *self.rivals.values(), strict=True)
        return sum(
            len({decision["verdict"] for decision in box}) > 1 for box in everyone
        )

    def count(self, verdict: str) -> int:
        """The number of boxes of a verdict."""
        return sum(decision["verdict"] == verdict for decision in self.decisions)


class Judge:
    """Decides frames by a configuration and by those of named rivals."""

    def __init__(
        self, config: FilterConfig, rivals: Mapping[str, FilterConfig]
    ) -> None:
        self._config, self._rivals = config, rivals
        self.failed = 0
        self._refusals = Kinds()

    def frame(self, source: FrameSource) -> Judged:
        """The decisions on one frame; `fault` says what is wrong with it."""
        from filter_core.decisions.rules import decide
        from filter_core.errors import FilterError
        from filter_core.local import measure_source
        from filter_core.pipeline import FrameResult

        decisions = []
        try:
            for config in (self._config, *self._rivals.values()):
                measured = measure_source(source, config, config.channels)
                verdicts = decide(measured.evidence, config)
                decisions.append(FrameResult(measured, verdicts, config).decisions)
        except FilterError as error:
            return Judged(source, fault=str(error))
        report = measured.segmentation
        rivals = dict(zip(self._rivals, decisions[1:], strict=True))
        return Judged(source, decisions[0], rivals, report, self._config)

    def watch(
        self, frames: Iterable[Judged], screen: Screen, task: str = "draw"
    ) -> Iterator[Judged]:
        """The frames that could be decided; the others are noted."""
        with screen.progress(task, "frames") as advance:
            for number, frame in enumerate(frames, 1):
                if not frame.fault:
                    yield frame
                else:
                    self.failed += 1
                    if self._refusals.is_listed("refused"):
                        screen.note(
                            refusal(
                                frame.source.key, sources.naming_reading(frame.fault)
                            )
                        )
                advance(number, None)
        for line in self._refusals.more():
            screen.note(line)


class _Painter:
    """Writes the pictures of frames."""

    def __init__(self, folder: Path, edges: bool) -> None:
        self._folder, self._edges = folder, edges
        for name in ("before", "after", "side"):
            (folder / name).mkdir()

    def frame(self, named: tuple[str, Judged]) -> tuple[str, Counter[str], Picture]:
        """Its part of the page, why boxes are not kept, and its part of the sheet."""
        from filter_core.images.drawing import as_png
        from filter_core.images.sheet import tile_of

        stem, judged = named
        background, painted = _backgrounds(judged)
        before = self._on(
            background,
            (
                _boxed(decision)._replace(verdict="kept")
                for decision in judged.decisions
            ),
        )
        after = self._on(
            background,
            (box for box in map(_boxed, judged.decisions) if box.verdict == "kept"),
        )
        reasoned = (
            _boxed(
                decision, f"{decision['class']}: {decision['reason'].replace('_', ' ')}"
            )
            for decision in judged.decisions
            if decision["verdict"] != "kept"
        )
        why = self._on(background, reasoned)
        rejected, unmeasured = map(judged.count, ("rejected", "unmeasured"))
        panels = {f"before: {len(judged.decisions)} boxes": before}
        if painted is not None:
            panels["segmentation"] = self._on(painted, map(_boxed, judged.decisions))
        panels[f"after: {judged.count('kept')} kept"] = after
        for name, decisions in judged.rivals.items():
            pairs = list(zip(judged.decisions, decisions, strict=True))
            flips = sum(
                decision["verdict"] != other["verdict"] for decision, other in pairs
            )
            texts = (
                f"{other['class']}: {other['verdict']}"
                if decision["verdict"] != other["verdict"]
                else ""
                for decision, other in pairs
            )
            by_rival = map(_boxed, decisions, texts)
            panels[f"{name}: {flips} flips"] = self._on(background, by_rival)
        panels[f"why: {rejected} rejected, {unmeasured} unmeasured"] = why
        for name, picture in (
            ("before", before),
            ("after", after),
            ("side", _side_by_side(panels)),
        ):
            (self._folder / name / f"{stem}.png").write_bytes(as_png(picture))
        reasons: Counter[str] = Counter(
            box["reason"] for box in judged.decisions if box["verdict"] != "kept"
        )
        counts = f"{judged.count('kept')} of {len(judged.decisions)} boxes"
        tile = tile_of(before, after, f"{judged.source.key}: {counts}")
        return _figure(stem, judged), reasons, tile

    def _on(self, background: Picture, boxes: Iterable[DrawnBox]) -> Picture:
        from filter_core.images.drawing import draw_boxes

        canvas: Picture = background.copy()
        draw_boxes(canvas, list(boxes), edges=self._edges)
        return canvas


def _backgrounds(judged: Judged) -> tuple[Picture, Picture | None]:
    """The frame's image, grey without one, and its painted segmentation."""
    import numpy as np

    from filter_core.formats.reading import read_file
    from filter_core.images.drawing import GREY, decoded
    from filter_core.local import measuring_of
    from filter_core.segmentation.palettes import FAMILIES
    from filter_core.segmentation.reading import read_segmentation

    source, report, painted = judged.source, judged.report, None
    if source.segmentation and report and judged.config:
        reading = replace(
            measuring_of(source, judged.config).reading,
            palette=report["palette"],
            encoding=report["encoding"],
            channel_order=report["channel_order"],
        )
        content = read_file(source.segmentation, "segmentation")
        tags = read_segmentation(content, reading).tags
        painted = np.ascontiguousarray(
            FAMILIES[report["palette"]].paint(tags)[..., ::-1]
        )
    if source.image is not None:
        return decoded(read_file(source.image, "image")), painted
    if painted is not None:
        return np.full_like(painted, GREY), painted
    camera = (source.annotation or {}).get("camera")
    size = camera if isinstance(camera, Mapping) else {"width": 640, "height": 360}
    return np.full((size["height"], size["width"], 3), GREY, np.uint8), None


def _boxed(decision: Decision, text: str = "") -> DrawnBox:
    from filter_core.images.drawing import DrawnBox

    return DrawnBox(decision["verdict"], decision["xyxy"], decision["edges"], text)


def _side_by_side(panels: Mapping[str, Picture]) -> Picture:
    """Pictures in two columns, each below its caption."""
    import numpy as np

    from filter_core.images.sheet import captioned

    tiles = [captioned(caption, picture) for caption, picture in panels.items()]
    if len(tiles) % 2:
        tiles.append(np.full_like(tiles[0], 32))
    rows = [np.hstack(tiles[at : at + 2]) for at in range(0, len(tiles), 2)]
    return np.vstack(rows)


def _figure(stem: str, judged: Judged) -> str:
    from filter_core.images.sheet import figure_of

    flips = f", {judged.flips} flips" if judged.rivals else ""
    unmeasured = judged.count("unmeasured")
    unknown = f", {unmeasured} unmeasured" if unmeasured else ""
    rows = [
        (f"{box['class']} {box['id']}", box["explanation"])
        for box in judged.decisions
        if box["verdict"] != "kept"
    ]
    words = (
        f"{len(judged.decisions)} boxes, {judged.count('kept')} kept,\n"
        f"{judged.count('rejected')} rejected{unknown}{flips}."
    )
    return figure_of(judged.source.key, f"{stem}.png", words, rows, side="side")
