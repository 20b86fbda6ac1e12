"""Shared by all formats of labels: choosing boxes, splitting frames, naming files.

`write_labels` takes frames one at a time, chooses and clips their boxes, splits them
into parts and distance bands and counts them; a format's `LabelWriter` writes the
result.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray, rows_of
from filter_core.formats.export import (
    IMAGE_SUFFIX,
    ExportError,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
    non_default_options,
)
from filter_core.formats.files import FileNames, Spool, json_bytes
from filter_core.formats.reading import KEYS_NAME
from filter_core.formats.same import (
    SOURCE_LABELS,
    OwnLabels,
    OwnReading,
    own_labels,
    stored_labels,
)
from filter_core.formats.splits import (
    completed_parts,
    next_part,
    part_by_shares,
    sequence_of,
    shares_of,
    without_part,
)
from filter_core.formats.tally import Change, Counts, ExportTally
from filter_core.geometry.boxes import FORMS
from filter_core.images.drawing import DrawnBox, Picture, as_png, decoded
from filter_core.images.sheet import MOST_TILES, figure_of, page_of, sheet_of, tile_of
from filter_core.verdicts import (
    KEPT,
    REJECTED,
    UNMEASURED,
    VERDICTS,
    DecidedBoxes,
    VerdictName,
)

_USUAL_SHARE: Final = 0.8
"""That of training, of frames that have no part."""

_NO_PARTS: Final = ("in", "without_boxes", "without_image", "left_out")
"""What else is counted beside the frames of each part."""

_AS_THEY_CAME: Final = "frames_as_they_came"

_NUMBER: Final = re.compile("[0-9]{6,12}")

_LEAST_SIDE: Final = 0.01
"""Pixels; a thinner box would vanish when a format rounds it."""

_LEAST_CUT: Final = 1e-9
"""The least share cut off a box that the border cuts; rounding could make it 0."""

_FRAME_LEFT_OUT: Final = "frame_left_out"
"""Why a box is dropped that would be written if its frame were."""


class LabelBox(NamedTuple):
    """One box of `LabelBoxes`, with the same attributes."""

    row: int
    class_number: int
    xyxy: list[float]
    cut: float
    ignored: bool

    @property
    def is_cut(self) -> bool:
        """Whether the image's border goes through it."""
        return self.cut > 0


@dataclass(frozen=True, eq=False)
class LabelBoxes:
    """The M boxes of a frame that are written, in the order of the frame.

    Attributes
    ----------
    row : (M,) int64
        The index of each box in its frame, for the frame's other columns.
    class_number : (M,) int64
        The index of its class in the list of classes that is exported.
    xyxy : (M, 4) float64, px
        Inside the image.
    cut : (M,) float64
        Share of the rectangle that lies beyond the image, 0..1.
    ignored : (M,) bool
        A region that training and scoring are to ignore, and no object.
    """

    row: IntArray
    class_number: IntArray
    xyxy: BoxesXYXY
    cut: FloatArray
    ignored: BoolArray

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, some: BoolArray) -> LabelBoxes:
        return rows_of(self, some)

    def __iter__(self) -> Iterator[LabelBox]:
        columns = (self.row, self.class_number, self.xyxy, self.cut, self.ignored)
        lists = (column.tolist() for column in columns)
        return map(LabelBox, *lists)


EVERY_KEY: Final = frozenset({"*"})
"""The `Traits.box_keys` of a format that can hold any."""

RECTANGLE_KEYS: Final = frozenset({"class", *FORMS})
"""Those of a format that holds classes and rectangles."""

_NOT_READ: Final = (
    "whatever is no class and no rectangle, such as 3D boxes, cameras and unknown "
    "keys; it was not counted"
)
"""What has no place in a format that reads no key of annotations."""


@dataclass(frozen=True)
class Traits:
    """What a format of labels can represent, and what programs that read it need.

    Attributes
    ----------
    image : str
        The path of a frame's image in the export, with ``{stem}``, ``{suffix}``,
        ``{numbered}`` and ``{part}`` in place of these attributes of its `OutFrame`.
    can_hold_crowds : bool
        It can say that a box stands for many objects at once. From other formats
        crowds are left out, since a model would learn each as one object.
    can_hold_unplaced : bool
        It can hold a box without a rectangle in the image.
    needs_key_list : bool
        Its own files do not hold the keys of frames, so ``frames.jsonl`` is written
        with them: it gives the key of each file.
    needs_flat_names : bool
        Its readers do not look into sub-folders, so the sub-folders in a frame's key
        become part of the file's name.
    names_images : bool
        Its labels name the image of each frame, so they are of no use without it.
    box_keys, frame_keys : frozenset of str, or None
        The keys of boxes and frames that it can hold; None: it does not read them, and
        holds no more than classes and rectangles. `EVERY_KEY`: all.
    own : OwnReading or None
        How labels that came in this format are written again.
    keeps_rectangles : bool
        Rectangles that came in this format are not cut to the image.
    bands : tuple of int, metres
        Its distance bands, unless others are asked for.
    """

    image: str
    can_hold_crowds: bool = False
    can_hold_unplaced: bool = False
    needs_key_list: bool = False
    needs_flat_names: bool = False
    names_images: bool = True
    box_keys: frozenset[str] | None = None
    frame_keys: frozenset[str] = frozenset({"boxes", "map", "split", SOURCE_LABELS})
    own: OwnReading | None = None
    keeps_rectangles: bool = False
    bands: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class OutFrame:
    """One frame as it is written.

    Attributes
    ----------
    number : int
        The frame's place in the export; the first is 0.
    part : str
        The name of its part, as a file's name: ``train``.
    stem : str
        A path without suffix, different for every frame of the export, or of its part
        where parts are folders.
    suffix : str
        The suffix of its image.
    image : str
        The path that its image has in the export, or would have if copied.
    numbered : str
        Where `Traits.image` has it, the frame's own number or a new one, as text.
    boxes : LabelBoxes
        The boxes to write: those of `frame.boxes` that were chosen.
    own : OwnLabels or None
        The label file that its boxes came from, if that is in the same format and
        still has these boxes.
    """

    frame: ExportFrame
    number: int
    part: str
    stem: str
    suffix: str
    image: str
    numbered: str
    boxes: LabelBoxes
    own: OwnLabels | None = None


@dataclass(frozen=True)
class ExportContext:
    """What the writer of one export is given.

    `sink` takes each file, and `stack` closes what the writer opens. `facts` are the
    writer's own keys in ``manifest.json``, `lists` the names of the frames of each
    part.
    """

    sink: Sink
    head: ExportHead
    options: ExportOptions
    stack: ExitStack
    facts: dict[str, object] = field(default_factory=dict)
    lists: dict[str, Spool] = field(default_factory=dict)

    def note_own(self, band: str) -> None:
        """Count a frame whose labels of all distances are written as they came."""
        if not band:
            count = self.facts.get(_AS_THEY_CAME, 0)
            assert isinstance(count, int), "counted here"
            self.facts[_AS_THEY_CAME] = count + 1

    def spool(self) -> Spool:
        """A place for pieces that are written at the end."""
        spool = Spool(self.head.temporary, self.head.buffer_bytes)
        return self.stack.enter_context(spool)

    def list_frame(self, part: str, name: str) -> None:
        """Put a frame into the list of its part, for `write_lists`."""
        if part not in self.lists:
            self.lists[part] = self.spool()
        self.lists[part].write(f"{name}\n".encode())

    def write_lists(self, folder: str) -> None:
        """Write a file for each part, with the name of a frame in each line."""
        for part in completed_parts(self.lists):
            spool = self.lists.get(part)
            self.sink(f"{folder}/{part}.txt", spool.pieces() if spool else [])


class LabelWriter(Protocol):
    """Writes chosen boxes in one format."""

    traits: ClassVar[Traits]

    def labels(self, band: str, out: OutFrame) -> None:
        """One frame's labels.

        Called with all boxes and an empty `band` for each frame. A format with the
        option `bands` is called again for each distance band, with its name and only
        the boxes that are near enough.
        """

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
    """Write frames in a label format, with the writer that `new_writer` makes.

    Parameters and result are those of `filter_core.formats.registry.write_export`.
    Raises `ExportError`: a class that is not in the list, or counts that do not add up.
    """
    with ExitStack() as stack:
        tally = stack.enter_context(ExportTally(head))
        context = ExportContext(sink, head, options, stack)
        writer = new_writer(context)
        export = _LabelExport(context, writer, tally)
        for frame in frames:
            export.write(frame)
        writer.finish()
        return export.finish()


def split_of(key: str, map_name: str | None, share: float) -> str:
    """``train`` or ``val``, from the names alone: adding frames reshuffles nothing.

    `share`, 0..1, is that of ``train``.

    Every map is split by a hash of its own, so that each gives about the same share;
    exact shares per map would need all frames at once, and would move frames later.
    """
    name = f"{map_name or ''}\0{key}".encode("utf-8", "surrogatepass")
    place = int.from_bytes(hashlib.sha256(name).digest()[:8], "big") / 2**64
    return "train" if place < share else "val"


def band_name(band: int) -> str:
    """The folder of a distance band, as carlasimu calls it."""
    return f"label{band}"


def clipped(xyxy: BoxesXYXY, wh: tuple[int, int]) -> BoxesXYXY:
    """(N, 4) float64, px: rectangles (N, 4) cut to the image of `wh` (width, height).

    A side may be left without extent.
    """
    # Not np.clip: whether a zero has a sign must not depend on the processor.
    size = np.array([*wh, *wh], np.float64)
    above = np.where(xyxy < 0.0, 0.0, xyxy)
    inside: BoxesXYXY = np.where(above > size, size, above)
    return inside


class _LabelExport:
    """The state of one export while its frames are written."""

    def __init__(
        self, context: ExportContext, writer: LabelWriter, tally: ExportTally
    ) -> None:
        self.context, self.writer, self.tally = context, writer, tally
        self.chooser = _BoxChooser(context.options, tally, writer.traits)
        # Where parts are folders, they tell frames of one name apart.
        self.has_folders = "{part}" in writer.traits.image
        self.names: dict[str, FileNames] = {}
        self.parts = Parts(context.options)
        self.key_list = context.spool()
        self.pictures = ExportPictures(context.sink, int(context.options.pictures))
        self.count = 0
        self.is_numbered = "{numbered}" in writer.traits.image
        self.next_number = 0
        self.numbers: set[str] = set()  # of frames that have their own
        self.box_keys: Counter[tuple[str, ...]] = Counter()
        self.frame_keys: Counter[str] = Counter()

    def write(self, frame: ExportFrame) -> None:
        # Whether the frame's labels would name an image that is not there
        options, traits = self.context.options, self.writer.traits
        is_missing = frame.read_image is None and options.images == "copy"
        if is_missing and traits.names_images and not options.allow_missing_images:
            self.tally.frame(frame)
            self.tally.image_missing(left_out=True)
            number = self.tally.count_boxes(frame).tolist()
            changes = [Change(row, "dropped", "no_image") for row in range(len(number))]
            self.tally.changed(frame, number, changes)
            return
        if self.chooser.leaves_out(frame):
            return
        part = self.parts.of(frame)
        self.tally.frame(frame, part)
        name = frame.key
        if self.has_folders and part == frame.split:
            name = without_part(frame.key, part)
        stem, suffix = self._names(part).stem(name), IMAGE_SUFFIX[frame.media_type]
        own = self._own(frame)
        numbered = self._numbered(own) if self.is_numbered else ""
        image = self.writer.traits.image.format(
            numbered=numbered, part=part, stem=stem, suffix=suffix
        )
        is_whole = own is not None or self._keeps_rectangles(frame)
        boxes = self.chooser.choose(frame, is_whole=is_whole)
        out = OutFrame(
            frame, self.count, part, stem, suffix, image, numbered, boxes, own
        )
        self.count += 1
        self._note_name(out, name)
        if self.writer.traits.box_keys not in (None, EVERY_KEY):
            annotation = frame.given.frame
            # A camera of which only the size is known is the size of the image.
            size = dict(zip(("width", "height"), frame.wh, strict=True))
            self.frame_keys.update(key for key in annotation if annotation[key] != size)
            # Mostly the same for all boxes, so that this is faster than key by key.
            self.box_keys.update(map(tuple, frame.given.boxes))
        self.writer.labels("", out)
        for band in self.context.options.bands or self.writer.traits.bands:
            self._write_band(band, out)
        if self.context.options.images != "none":
            read = out.frame.read_image
            if read is None:
                self.tally.image_missing()
            else:
                self.context.sink(out.image, [read()])
        self.pictures.add(frame, stem, set(boxes.row.tolist()))

    def _own(self, frame: ExportFrame) -> OwnLabels | None:
        """The label file that the frame came from, if it can be written again."""
        reading, options = self.writer.traits.own, self.context.options
        if reading is None or options.boxes != "visible":
            return None
        return own_labels(frame.given, self.context.head.format, reading)

    def _keeps_rectangles(self, frame: ExportFrame) -> bool:
        if not self.writer.traits.keeps_rectangles:
            return False
        is_given = self.context.options.boxes == "visible"
        return is_given and bool(stored_labels(frame.given, self.context.head.format))

    def _numbered(self, own: OwnLabels | None) -> str:
        """The frame's own number, or the next that no other has had."""
        name = "" if own is None else own.file.rpartition(".")[0]
        is_number = _NUMBER.fullmatch(name) is not None
        if is_number and name not in self.numbers and int(name) >= self.next_number:
            self.numbers.add(name)
            return name
        while (name := f"{self.next_number:06}") in self.numbers:
            self.next_number += 1
        self.next_number += 1
        return name

    def finish(self) -> Counts:
        self.parts.require_maps()
        self.pictures.finish(str(self.context.head.facts.get("dataset", "export")))
        self.tally.split(self.parts.told, self.parts.sequences)
        if self.writer.traits.needs_key_list:
            self.context.sink(KEYS_NAME, self.key_list.pieces())
        options = self.context.options
        chosen = {
            name: getattr(options, name)
            for name in sorted(non_default_options(options))
        }
        facts = {"options": chosen, **self.context.facts, **self._without_place()}
        self.context.sink("manifest.json", self.tally.manifest(facts))
        return self.tally.counts()

    def _without_place(self) -> Mapping[str, object]:
        """The keys of annotations that the format cannot hold, with their number."""
        traits = self.writer.traits
        if traits.box_keys is None:
            return {"without_place": _NOT_READ}
        of_boxes: Counter[str] = Counter()
        for keys, count in self.box_keys.items():
            of_boxes.update(dict.fromkeys(keys, count))
        left = {
            "boxes": {
                key: count
                for key, count in sorted(of_boxes.items())
                if key not in traits.box_keys
            },
            "frames": {
                key: count
                for key, count in sorted(self.frame_keys.items())
                if key not in traits.frame_keys
            },
        }
        there = {name: keys for name, keys in left.items() if keys}
        return {"without_place": there} if there else {}

    def _names(self, part: str) -> FileNames:
        """The names of files in a part, or in all parts where these are no folders."""
        folder = part if self.has_folders else ""
        if folder not in self.names:
            flat = self.writer.traits.needs_flat_names
            self.names[folder] = FileNames(flat=flat)
        return self.names[folder]

    def _note_name(self, out: OutFrame, name: str) -> None:
        frame, file = out.frame, out.image
        if out.stem != name:
            self.tally.renamed(frame.key, file)
        if self.writer.traits.needs_key_list:
            line = {"file": file, "key": frame.key, "map": frame.map, "part": out.part}
            self.key_list.write(json_bytes(line) + b"\n")

    def _write_band(self, band: int, out: OutFrame) -> None:
        """Write the labels of boxes that are at most `band` metres away."""
        name = band_name(band)
        boxes, rows = out.frame.boxes, out.boxes.row
        distance, high = boxes.distance[rows], boxes.distance_range[rows, 1]
        farthest = np.where(np.isnan(distance), high, distance)
        # One of which nothing is known is in every band.
        near = out.boxes[~(farthest > band)]
        self.tally.banded(name, len(near))
        self.writer.labels(name, replace(out, boxes=near))


class PartOfFrame(Protocol):
    """What tells the part of a frame, with the attributes of `ExportFrame`."""

    @property
    def key(self) -> str: ...
    @property
    def map(self) -> str | None: ...
    @property
    def sequence(self) -> str | None: ...
    @property
    def split(self) -> str | None: ...


class Parts:
    """Gives each frame its part, and counts how it was found.

    Attributes
    ----------
    frames : Counter of str
        Those in each part.
    told : Counter of str
        Frames by what told their part: ``as_it_came``, ``by_sequence``, by the key of
        the frame (``without_sequence``), ``by_map``, or ``by_frame``, where no shares
        were asked.
    sequences : mapping of str to set of str
        Those that were put into each part.
    """

    def __init__(self, options: ExportOptions) -> None:
        self.frames: Counter[str] = Counter()
        self.told: Counter[str] = Counter()
        self.sequences: dict[str, set[str]] = {}
        self._shares = shares_of(options.split)
        self._by_map = options.split_by == "map"
        names = (name.strip() for name in options.val_maps.split(","))
        self._val_maps = list(filter(None, names))
        self._maps: dict[str, list[int]] = {}
        self._names = FileNames(flat=True)
        for name in _NO_PARTS:
            self._names.stem(name)
        self._by_name: dict[str, str] = {}

    def of(self, frame: PartOfFrame) -> str:
        """The part of a frame, as the name of a folder."""
        if self._val_maps:
            self._maps[frame.map or ""] = []
            name = "val" if frame.map in self._val_maps else "train"
        elif self._by_map:
            counts = self._maps.setdefault(frame.map or "", [0] * len(self._shares))
            name = next_part(self._shares, counts)
        elif self._shares:
            name = part_by_shares(frame.key, frame.map, frame.sequence, self._shares)
        else:
            name = frame.split or split_of(frame.key, frame.map, _USUAL_SHARE)
        if name not in self._by_name:
            self._by_name[name] = self._names.stem(name)
        part = self._by_name[name]
        self.frames[part] += 1
        self._count(frame, part)
        return part

    def require_maps(self) -> None:
        """Raise `ExportError` if no frame was of one of the maps that are asked for."""
        for name in self._val_maps:
            if name not in self._maps:
                there = ", ".join(sorted(filter(None, self._maps))) or "none"
                raise ExportError(
                    f"val_maps: no frame is of the map {name[:40]!r}; there are "
                    f"{there}",
                    pointer="/options/val_maps",
                )

    def _count(self, frame: PartOfFrame, part: str) -> None:
        if self._val_maps or self._by_map:
            self.told["by_map"] += 1
            return
        if not self._shares:
            self.told["as_it_came" if frame.split else "by_frame"] += 1
            return
        sequence = sequence_of(frame.key, frame.sequence)
        if sequence is not None:
            self.sequences.setdefault(part, set()).add(f"{frame.map}\0{sequence}")
        self.told["without_sequence" if sequence is None else "by_sequence"] += 1


class _BoxChooser:
    """Chooses the boxes of each frame and counts the outcomes of all boxes."""

    def __init__(
        self, options: ExportOptions, tally: ExportTally, traits: Traits
    ) -> None:
        self._options = options
        self._tally = tally
        self._traits = traits

    def leaves_out(self, frame: ExportFrame) -> bool:
        """Whether a frame is left out; its boxes are then counted as dropped."""
        boxes, options = frame.boxes, self._options
        if options.include_unmeasured or options.include == "all":
            return False
        unmeasured = int((self._verdict(boxes) == UNMEASURED).sum())
        if not unmeasured:
            return False
        self._tally.left_out(frame, unmeasured)
        class_number = self._tally.count_boxes(frame)
        crowd = self._crowd(frame)
        objects, _ = self._wanted(boxes, crowd)
        reasons = [
            _FRAME_LEFT_OUT
            if objects[row]
            else self._reason(boxes, row, is_object=False, crowd=crowd[row])
            for row in range(len(boxes))
        ]
        changes = [Change(row, "dropped", reason) for row, reason in enumerate(reasons)]
        self._tally.changed(frame, class_number.tolist(), changes)
        return True

    def choose(self, frame: ExportFrame, *, is_whole: bool = False) -> LabelBoxes:
        """The boxes of one frame that are written, in the order of the frame.

        `is_whole`: they are not cut to the image.
        """
        boxes, options = frame.boxes, self._options
        class_number = self._tally.count_boxes(frame)
        crowd = self._crowd(frame)
        objects, ignorable = self._wanted(boxes, crowd)
        whole, used = _rectangles(boxes, options.boxes)
        inside = clipped(np.where(np.isnan(whole), 0.0, whole), frame.wh)
        shorter_side = (inside[:, 2:] - inside[:, :2]).min(axis=1)
        placed = shorter_side >= _LEAST_SIDE
        written = objects & (placed | self._traits.can_hold_unplaced)
        ignored = ignorable & placed & (options.rejected == "dontcare")
        row = np.flatnonzero(written | ignored)
        chosen = LabelBoxes(
            row=row,
            class_number=class_number[row],
            xyxy=inside[row],
            cut=np.zeros(len(row)) if is_whole else _cut(frame, row),
            ignored=ignored[row],
        )
        self._tally.written(class_number[written], used[written].tolist())
        if options.include != "all":
            unmeasured = self._verdict(boxes)[written] == UNMEASURED
            self._tally.unmeasured_written(int(unmeasured.sum()))
        is_cut = np.zeros(len(boxes), np.bool_)
        is_cut[row] = chosen.cut > 0
        # Boxes that are cut, written as regions to ignore, or dropped.
        changed = np.flatnonzero(is_cut | ~written)

        def change_of(box: int) -> Change:
            if written[box]:
                return Change(box, "clipped", "beyond_image")
            reason = self._reason(boxes, box, is_object=objects[box], crowd=crowd[box])
            return Change(box, "dontcare" if ignored[box] else "dropped", reason)

        self._tally.changed(
            frame,
            class_number[changed].tolist(),
            [change_of(each) for each in changed.tolist()],
        )
        return chosen

    def _crowd(self, frame: ExportFrame) -> BoolArray:
        """(N,): boxes for many objects, if the format cannot represent them."""
        if self._traits.can_hold_crowds:
            return np.zeros(len(frame.boxes), np.bool_)
        return frame.given.is_crowd(len(frame.boxes))

    def _wanted(
        self, boxes: DecidedBoxes, crowd: BoolArray
    ) -> tuple[BoolArray, BoolArray]:
        """(N,) each: objects of the export, and boxes that can be regions to ignore."""
        if self._options.include == "all":
            return ~crowd, crowd
        verdict = self._verdict(boxes)
        objects = verdict == KEPT
        if self._options.include_unmeasured:
            objects |= verdict == UNMEASURED
        return objects & ~crowd, crowd | (verdict == REJECTED)

    def _verdict(self, boxes: DecidedBoxes) -> NDArray[np.uint8]:
        effective = self._options.include == "effective"
        return boxes.effective if effective else boxes.verdict

    def _reason(
        self, boxes: DecidedBoxes, row: int, *, is_object: bool, crowd: bool
    ) -> str:
        """Why a box is no object of the export."""
        if crowd:
            return "crowd"
        if is_object:
            rectangle, _ = _rectangles(boxes[row : row + 1], self._options.boxes)
            if np.isnan(rectangle).any():  # it has none; its reason says why
                return boxes.reason_label(row)
            return "degenerate"  # it has one without extent
        by_person = self._options.include == "effective" and boxes.is_reviewed(row)
        return "rejected_by_person" if by_person else boxes.reason_label(row)


def _rectangles(boxes: DecidedBoxes, kind: str) -> tuple[BoxesXYXY, NDArray[np.str_]]:
    """(N, 4): the rectangle of this kind of each box; and (N,): the kind that it is.

    A box without one of this kind has its visible rectangle instead. One without any
    has a row of NaN and the kind "".
    """
    columns = {
        "visible": (boxes.xyxy,),
        "amodal": (boxes.amodal_xyxy, boxes.xyxy),
        "tight": (boxes.tight_xyxy, boxes.visible_xyxy, boxes.xyxy),
    }[kind]
    xyxy, *others = columns
    has_rectangle = ~np.isnan(xyxy[:, 0])
    used = np.where(has_rectangle, kind, "")
    for other in others:
        filled = ~has_rectangle & ~np.isnan(other[:, 0])
        xyxy = np.where(filled[:, None], other, xyxy)
        used = np.where(filled, "visible", used)
        has_rectangle |= filled
    return xyxy, used


def _cut(frame: ExportFrame, row: IntArray) -> FloatArray:
    """(M,): the share of each whole rectangle that is beyond the image.

    Above 0 if any part of it is, however small.

    The whole rectangle of a 3D box is its projection. That of a 2D box is in the
    annotation, which is only read for boxes that end at the border of the image: a box
    that was clamped to the image ends there.
    """
    boxes, (width, height) = frame.boxes, frame.wh
    whole, corrected = boxes.amodal_xyxy[row], boxes.xyxy[row]
    is_2d = np.isnan(whole[:, 0])
    x_min, y_min, x_max, y_max = corrected.T
    is_within = (x_min > 0) & (y_min > 0) & (x_max < width) & (y_max < height)
    cut = np.zeros(len(row))
    annotated = np.flatnonzero(is_2d & ~is_within)
    if len(annotated):
        whole[annotated] = frame.given.rectangles(row[annotated].tolist())
    beyond = np.flatnonzero(~is_2d | ~is_within)
    if not len(beyond):
        return cut
    whole = whole[beyond]
    inside = clipped(whole, frame.wh)
    area = _area(whole)
    left = np.divide(_area(inside), area, out=np.zeros(len(area)), where=area > 0)
    share = np.minimum(np.maximum(1.0 - left, _LEAST_CUT), 1.0)
    cut[beyond] = np.where((inside == whole).all(axis=1), 0.0, share)
    return cut


def _area(xyxy: BoxesXYXY) -> FloatArray:
    sides = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 0.0)
    area: FloatArray = sides[:, 0] * sides[:, 1]
    return area


PICTURES: Final = "pictures"
"""The folder in an export."""


def drawn_boxes(
    boxes: DecidedBoxes,
    verdict: VerdictName | None = None,
    only: Collection[int] | None = None,
    *,
    metres: bool = False,
) -> Iterator[DrawnBox]:
    """The boxes in the image; with their distance in whole metres, if asked.

    `verdict` is drawn in place of their own; `only` are the rows that are drawn.
    """
    columns = (boxes.distance.tolist(), boxes.xyxy.tolist(), boxes.effective.tolist())
    for row, (away, xyxy, own) in enumerate(zip(*columns, strict=True)):
        if math.isnan(xyxy[0]) or (only is not None and row not in only):
            continue
        text = str(int(away)) if metres and not math.isnan(away) else ""
        yield DrawnBox(verdict or VERDICTS[own].value, xyxy, None, text)


class ExportPictures:
    """Draws the first frames of an export that have an image, at most `most`."""

    def __init__(self, sink: Sink, most: int) -> None:
        self._sink, self._most = sink, most
        self._figures: list[str] = []
        self._tiles: list[Picture] = []
        self._reasons: Counter[str] = Counter()

    def add(self, frame: ExportFrame, stem: str, written: Collection[int]) -> None:
        """Draw a frame, of whose boxes those in the rows `written` are written."""
        if len(self._figures) >= self._most or frame.draw is None:
            return
        name, boxes = f"{stem.replace('/', '__')}.png", frame.boxes
        before = frame.draw(list(drawn_boxes(boxes, "kept")))
        after = frame.draw(list(drawn_boxes(boxes, "kept", written)))
        for folder, content in (("before", before), ("after", after)):
            self._sink(f"{PICTURES}/{folder}/{name}", [content])
        if len(self._tiles) < MOST_TILES:
            count = f"{len(written)} of {len(boxes)} boxes"
            caption = f"{frame.key}: {count}"
            # Both were drawn here, and are no files of other people.
            self._tiles.append(tile_of(decoded(before), decoded(after), caption))
        gone = [row for row, code in enumerate(boxes.effective) if code != KEPT]
        rows = [
            (f"{boxes.class_name(row)} {boxes.ids[row]}", boxes.reason_label(row))
            for row in gone
        ]
        self._reasons.update(reason for _, reason in rows)
        words = f"{len(written)} of {len(boxes)} boxes are written."
        self._figures.append(figure_of(frame.key, name, words, rows))

    def finish(self, name: str) -> None:
        """The contact sheet and the page."""
        sheet = sheet_of(self._tiles)
        if sheet is None:
            return
        self._sink(f"{PICTURES}/sheet.png", [as_png(sheet)])
        page = page_of(name, self._figures, self._reasons)
        self._sink(f"{PICTURES}/index.html", [page.encode("utf-8", "replace")])
