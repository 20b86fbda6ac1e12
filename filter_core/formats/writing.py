"""What all formats of labels share: which boxes go out, where, and under which names.

`write_labels` takes frames one at a time, chooses and clips their boxes, splits them
into parts and distance bands and keeps the books; a format's `LabelWriter` is given
what is left to write.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Protocol, TypeAlias

from filter_core.formats.export import (
    IMAGE_SUFFIX,
    ExportBox,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Rectangle,
    Sink,
)
from filter_core.formats.files import FileNames, Spool, json_bytes
from filter_core.formats.reading import KEYS_NAME
from filter_core.formats.tally import Counts, ExportTally

_RECTANGLES: Final = {
    "visible": ("xyxy",),
    "amodal": ("amodal_xyxy", "xyxy"),
    "tight": ("tight_xyxy", "visible_xyxy", "xyxy"),
}
"""The keys of a decision in which a rectangle is looked for."""

_NOWHERE: Final = (0.0, 0.0, 0.0, 0.0)

_LEAST_SIDE: Final = 0.01
"""Pixels; what is thinner would vanish when a format rounds it."""


@dataclass(frozen=True)
class OutBox:
    """One box as it is written.

    Attributes
    ----------
    box : ExportBox
    number : int
        The place of its class in the frozen list.
    xyxy : (4,) px
        Inside the image.
    cut : float
        Share of the rectangle that lies beyond the image, 0..1.
    ignored : bool
        A region that training and scoring are to ignore, and no object.
    """

    box: ExportBox
    number: int
    xyxy: tuple[float, float, float, float]
    cut: float = 0.0
    ignored: bool = False

    @property
    def is_cut(self) -> bool:
        """Whether the image's border goes through it."""
        return self.cut > 0


@dataclass(frozen=True)
class Traits:
    """What sets a format apart from others.

    Attributes
    ----------
    name : str
    crowds : bool
        It can say that a box stands for many objects at once. In other formats a crowd
        is no object to learn from, and is left out.
    unplaced : bool
        It can hold a box without a rectangle in the image.
    keys : bool
        Its files do not tell the keys of frames: ``frames.jsonl`` does.
    flat : bool
        Its readers do not look into sub-folders.
    """

    name: str
    crowds: bool = False
    unplaced: bool = False
    keys: bool = False
    flat: bool = False


class BoxChooser:
    """Chooses the boxes of each frame and keeps the books on all of them.

    Parameters
    ----------
    classes : sequence of str
        In their frozen order.
    options : ExportOptions
    tally : ExportTally
    traits : Traits
        Of the format.
    """

    def __init__(
        self,
        classes: Sequence[str],
        options: ExportOptions,
        tally: ExportTally,
        traits: Traits,
    ) -> None:
        self._number = {name: index for index, name in enumerate(classes)}
        self._options = options
        self._tally = tally
        self._traits = traits

    def choose(self, frame: ExportFrame) -> list[OutBox]:
        """The boxes of one frame that are written, in the order they came."""
        chosen = (self._choose(frame, box) for box in frame.boxes)
        return [one for one in chosen if one is not None]

    def _choose(self, frame: ExportFrame, box: ExportBox) -> OutBox | None:
        self._tally.box(box)
        reason, ignorable = self._reason_to_drop(box)
        key, xyxy = self._rectangle(box)
        inside = clipped(xyxy or _NOWHERE, frame.wh)
        if reason is None and not (_has_extent(inside) or self._traits.unplaced):
            reason = str(box.decision["reason"]) if xyxy is None else "degenerate"
            ignorable = False
        if reason is not None and not (
            ignorable and self._options.rejected == "dontcare" and _has_extent(inside)
        ):
            self._tally.dropped(frame, box, reason)
            return None
        out = OutBox(
            box=box,
            number=self._number[box.class_name],
            xyxy=inside,
            cut=_cut(box, xyxy or _NOWHERE, frame.wh),
            ignored=reason is not None,
        )
        if reason is not None:
            self._tally.dont_care(frame, box, reason)
        else:
            self._tally.written(frame, box, clipped=out.is_cut, rectangle=key)
        return out

    def _rectangle(self, box: ExportBox) -> tuple[str, Rectangle | None]:
        for key in _RECTANGLES[self._options.boxes]:
            xyxy = box.rectangle(key)
            if xyxy is not None:
                used = "visible" if key == "xyxy" else key.removesuffix("_xyxy")
                return used, xyxy
        return "", None

    def _reason_to_drop(self, box: ExportBox) -> tuple[str | None, bool]:
        """Why a box is no object of the export, and whether it is one to ignore."""
        if box.is_crowd and not self._traits.crowds:
            return "crowd", True
        include = self._options.include
        if include == "all":
            return None, False
        verdict = box.verdict if include == "effective" else box.decision["verdict"]
        if verdict == "kept":
            return None, False
        if verdict == "unmeasured" and self._options.include_unmeasured:
            return None, False
        by_person = include == "effective" and box.is_reviewed
        reason = "rejected_by_person" if by_person else str(box.decision["reason"])
        return reason, verdict == "rejected"


def clipped(xyxy: Rectangle, wh: tuple[int, int]) -> tuple[float, float, float, float]:
    """A rectangle cut to the image; a side may be left without extent."""
    width, height = wh
    x_min, x_max = (min(max(float(xyxy[i]), 0.0), float(width)) for i in (0, 2))
    y_min, y_max = (min(max(float(xyxy[i]), 0.0), float(height)) for i in (1, 3))
    return x_min, y_min, x_max, y_max


def _cut(box: ExportBox, xyxy: Rectangle, wh: tuple[int, int]) -> float:
    """Share of the whole rectangle beyond the image; above 0 if anything is."""
    whole = box.rectangle("amodal_xyxy") or box.given_xyxy or xyxy
    inside = clipped(whole, wh)
    if list(inside) == list(whole):
        return 0.0
    area = _area(whole)
    left = _area(inside) / area if area > 0 else 0.0
    return min(max(1.0 - left, 1e-9), 1.0)


def _has_extent(xyxy: Rectangle) -> bool:
    return min(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1]) >= _LEAST_SIDE


def _area(xyxy: Rectangle) -> float:
    return float(max(xyxy[2] - xyxy[0], 0.0) * max(xyxy[3] - xyxy[1], 0.0))


PARTS: Final = ("train", "val")


@dataclass(frozen=True)
class OutFrame:
    """One frame as it is written.

    Attributes
    ----------
    frame : ExportFrame
    number : int
        Counts the frames of the export from 0.
    part : ``train`` or ``val``
    stem : str
        A path without suffix, different for every frame of the export.
    boxes : sequence of OutBox
    """

    frame: ExportFrame
    number: int
    part: str
    stem: str
    boxes: Sequence[OutBox]

    @property
    def suffix(self) -> str:
        """The suffix of its image."""
        return IMAGE_SUFFIX[self.frame.media_type]


@dataclass(frozen=True)
class ExportContext:
    """What a writer writes with.

    Attributes
    ----------
    sink : Sink
    head : ExportHead
    options : ExportOptions
    stack : ExitStack
        Closes what the writer opens.
    facts : dict
        What the writer has to say of itself in ``manifest.json``.
    """

    sink: Sink
    head: ExportHead
    options: ExportOptions
    stack: ExitStack
    facts: dict[str, object] = field(default_factory=dict)

    def spool(self) -> Spool:
        """A place for pieces that are written at the end."""
        return self.stack.enter_context(Spool(self.head.temporary))


class LabelWriter(Protocol):
    """Writes chosen boxes in one format."""

    traits: ClassVar[Traits]

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""

    def labels(self, band: str, out: OutFrame) -> None:
        """One frame's labels; `band` is empty, or the name of a distance band."""

    def finish(self) -> None:
        """Everything that comes after the last frame."""


NewWriter: TypeAlias = Callable[[ExportContext], LabelWriter]


def write_labels(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    options: ExportOptions,
    new_writer: NewWriter,
) -> Counts:
    """Write frames in a label format.

    Parameters
    ----------
    frames : iterable of ExportFrame
        Read once, one at a time, and written in the same order.
    sink : callable
        Gets the files, each whole before the next begins; ``manifest.json`` last.
    head : ExportHead
    options : ExportOptions
    new_writer : callable
        Makes the format's writer.

    Returns
    -------
    dict
        The counts, as ``manifest.json`` has them.

    Raises
    ------
    ExportError
        A class that is not in the list, or counts that do not add up.
    """
    with ExitStack() as stack:
        tally = stack.enter_context(ExportTally(head))
        context = ExportContext(sink, head, options, stack)
        writer = new_writer(context)
        run = _Run(context, writer, tally)
        for frame in frames:
            run.write(frame)
        writer.finish()
        return run.finish()


def split_of(key: str, map_name: str | None, share: float) -> str:
    """``train`` or ``val``, from the names alone: adding frames reshuffles nothing.

    Every map is split by a hash of its own, so that each gives about the same share;
    exact shares per map would need all frames at once, and would move frames later.
    """
    name = f"{map_name or ''}\0{key}".encode("utf-8", "surrogatepass")
    place = int.from_bytes(hashlib.sha256(name).digest()[:8], "big") / 2**64
    return "train" if place < share else "val"


class _Run:
    """One export on its way from frame to frame."""

    def __init__(
        self, context: ExportContext, writer: LabelWriter, tally: ExportTally
    ) -> None:
        self.context, self.writer, self.tally = context, writer, tally
        classes, options = context.head.classes, context.options
        self.chooser = BoxChooser(classes, options, tally, writer.traits)
        self.names = FileNames(flat=writer.traits.flat)
        self.keys = context.spool()
        self.count = 0

    def write(self, frame: ExportFrame) -> None:
        part = split_of(frame.key, frame.map, self.context.options.split)
        self.tally.frame(frame, part)
        stem = self.names.stem(frame.key)
        out = OutFrame(frame, self.count, part, stem, self.chooser.choose(frame))
        self.count += 1
        self._note_name(out)
        self.writer.labels("", out)
        for band in self.context.options.bands:
            self._write_band(band, out)
        self._copy_image(out)

    def finish(self) -> Counts:
        if self.writer.traits.keys:
            self.context.sink(KEYS_NAME, self.keys.pieces())
        manifest = self.tally.manifest(self.writer.traits.name, self._facts())
        self.context.sink("manifest.json", manifest)
        return self.tally.counts()

    def _facts(self) -> Mapping[str, object]:
        options = self.context.options
        chosen = {name: getattr(options, name) for name in sorted(options.changed())}
        return {"options": chosen, **self.context.facts}

    def _note_name(self, out: OutFrame) -> None:
        frame, file = out.frame, self.writer.image(out)
        if out.stem != frame.key:
            self.tally.renamed(frame.key, file)
        if self.writer.traits.keys:
            line = {"file": file, "key": frame.key, "map": frame.map, "part": out.part}
            self.keys.write(json_bytes(line) + b"\n")

    def _write_band(self, band: int, out: OutFrame) -> None:
        name = band_name(band)
        near = [one for one in out.boxes if is_within(one, band)]
        self.tally.banded(name, len(near))
        self.writer.labels(name, replace(out, boxes=near))

    def _copy_image(self, out: OutFrame) -> None:
        if self.context.options.images == "none":
            return
        read = out.frame.read_image
        if read is None:
            self.tally.image_missing()
        else:
            self.context.sink(self.writer.image(out), [read()])


def band_name(band: int) -> str:
    """The folder of a distance band, as carlasimu calls it."""
    return f"label{band}"


def is_within(out: OutBox, band: int) -> bool:
    """Whether a box is in a band; one of unknown distance is in every band."""
    distance = out.box.distance
    return distance is None or distance <= band
