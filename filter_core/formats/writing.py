"""What all label formats have in common: choosing, clipping, splitting, naming."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Protocol, TypeAlias

from filter_core.formats.export import IMAGE_SUFFIX, ExportFrame, ExportHead, Sink
from filter_core.formats.export_boxes import BoxChooser, OutBox, Traits
from filter_core.formats.export_options import ExportOptions
from filter_core.formats.files import FileNames
from filter_core.formats.spool import Spool, json_bytes
from filter_core.formats.tally import Counts, ExportTally

KEYS_NAME: Final = "frames.jsonl"
"""Says which frame each file belongs to, so that reading it back gives its key."""

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
class Desk:
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


NewWriter: TypeAlias = Callable[[Desk], LabelWriter]


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
        desk = Desk(sink, head, options, stack)
        writer = new_writer(desk)
        run = _Run(desk, writer, tally)
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

    def __init__(self, desk: Desk, writer: LabelWriter, tally: ExportTally) -> None:
        self.desk, self.writer, self.tally = desk, writer, tally
        classes, options = desk.head.classes, desk.options
        self.chooser = BoxChooser(classes, options, tally, writer.traits)
        self.names = FileNames(flat=writer.traits.flat)
        self.keys = desk.spool()
        self.count = 0

    def write(self, frame: ExportFrame) -> None:
        part = split_of(frame.key, frame.map, self.desk.options.split)
        self.tally.frame(frame, part)
        stem = self.names.stem(frame.key)
        out = OutFrame(frame, self.count, part, stem, self.chooser.choose(frame))
        self.count += 1
        self._note_name(out)
        self.writer.labels("", out)
        for band in self.desk.options.bands:
            self._write_band(band, out)
        self._copy_image(out)

    def finish(self) -> Counts:
        if self.writer.traits.keys:
            self.desk.sink(KEYS_NAME, self.keys.pieces())
        manifest = self.tally.manifest(self.writer.traits.name, self._facts())
        self.desk.sink("manifest.json", manifest)
        return self.tally.counts()

    def _facts(self) -> Mapping[str, object]:
        options = self.desk.options
        chosen = {name: getattr(options, name) for name in sorted(options.changed())}
        return {"options": chosen, **self.desk.facts}

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
        if self.desk.options.images == "none":
            return
        read = out.frame.read_image
        if read is None:
            self.tally.image_missing()
        else:
            self.desk.sink(self.writer.image(out), [read()])


def band_name(band: int) -> str:
    """The folder of a distance band, as carlasimu calls it."""
    return f"label{band}"


def is_within(out: OutBox, band: int) -> bool:
    """Whether a box is in a band; one of unknown distance is in every band."""
    distance = out.box.distance
    return distance is None or distance <= band
