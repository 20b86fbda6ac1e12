"""The input of a format's writer: frames with decisions, a head, options and a sink.

Frames are passed one at a time, and the sink takes each file in pieces, so an export
never has a whole dataset in memory. All formats share one set of options; each format
declares those that it uses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.camera import read_camera
from filter_core.annotation.frame import FORMS_3D, frame_vertices, given_rectangles
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS, parse_annotation
from filter_core.arrays import BoolArray, BoxesXYXY, Dataclass, FloatArray
from filter_core.errors import FilterError
from filter_core.geometry.camera import Camera
from filter_core.images.drawing import DrawnBox
from filter_core.values import Faults, JsonObject
from filter_core.verdicts import DecidedBoxes, DecisionColumns

IMAGE_SUFFIX: Final = {"image/png": ".png", "image/jpeg": ".jpg"}

Include = Literal["effective", "kept", "all"]

Rejected = Literal["drop", "dontcare"]

Boxes = Literal["visible", "amodal", "tight"]

Images = Literal["copy", "none"]

SplitBy = Literal["sequence", "map"]

_CHOICES: Final = {
    "include": get_args(Include),
    "rejected": get_args(Rejected),
    "boxes": get_args(Boxes),
    "images": get_args(Images),
    "split_by": get_args(SplitBy),
}

PARTS: Final = ("train", "val", "test")
"""How the parts are called that shares are for."""

_SUM_TOLERANCE: Final = 1e-6

MAX_BANDS: Final = 16

MAX_PICTURES: Final = 1000
"""Frames that an export has pictures of, at most."""

MAX_BAND: Final = 100_000
"""The largest distance that a band can have, metres."""

Sink: TypeAlias = Callable[[str, Iterable[bytes]], None]
"""Takes a file's name inside the export and its content, piece by piece."""


@dataclass(frozen=True, eq=False)
class ExportFrame:
    """One frame to be exported.

    Data that a format does not need (`filter_core.formats.format.Need`) may be missing.

    Attributes
    ----------
    wh : (width, height) of the image, px
    given : GivenAnnotation
        Of the same boxes in the same order.
    map, sequence, split : str or None
        As its annotation says; `split` is the part that it has by itself.
    media_type : str
        Of the image: ``image/png`` or ``image/jpeg``.
    read_image : callable or None
        Gives the image's bytes; called only if images are copied.
    read_files : mapping of str to callable
        Likewise, of ``segmentation``, ``depth``, ``radar`` and ``lidar``, where given;
        tags of a known family come in its colours.
    draw : callable or None
        Gives the image with boxes drawn on it, as PNG.
    decisions : sequence of mapping
        The dictionary of each decision, as made by
        `filter_core.decisions.record.decision_dicts`; a server adds its own keys.
        Empty for formats that do not write them.
    columns : DecisionColumns or None
        The further columns of tables, of the same boxes; None for other formats.
    """

    key: str
    wh: tuple[int, int]
    boxes: DecidedBoxes
    given: GivenAnnotation
    map: str | None = None
    sequence: str | None = None
    split: str | None = None
    media_type: str = "image/png"
    read_image: Callable[[], bytes] | None = None
    read_files: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)
    draw: Callable[[Sequence[DrawnBox]], bytes] | None = None
    palette: str | None = None
    decisions: Sequence[Mapping[str, object]] = ()
    columns: DecisionColumns | None = None


@dataclass(frozen=True)
class ExportHead:
    """The data of an export as a whole.

    Attributes
    ----------
    classes : tuple of str
        The dataset's classes in their frozen order; a class's number is its place.
    facts : mapping
        The first keys of ``manifest.json``: dataset, run, config digest, last review.
    expected_boxes : int or None
        The number of boxes in all; with any other number the export fails.
    temporary : Path or None
        The folder for temporary files. Default: the system's.
    buffer_bytes : int
        How much of each temporary file is held in memory.
    group_rows : int
        Rows of a table that are written together, at most: a row group of a Parquet
        file.
    format : str
        The format's name; `filter_core.formats.registry.write_export` fills it in.
    """

    classes: tuple[str, ...]
    facts: Mapping[str, object] = field(default_factory=dict)
    expected_boxes: int | None = None
    temporary: Path | None = None
    buffer_bytes: int = 1024 * 1024
    group_rows: int = 20_000
    format: str = ""


@dataclass(frozen=True)
class ExportOptions:
    """Choices of an export.

    Attributes
    ----------
    include : ``effective`` (boxes whose effective verdict is kept), ``kept`` (boxes
        that the filter keeps, regardless of people's answers) or ``all``
    include_unmeasured : bool
        Also boxes that could not be measured and that nobody has answered, as they
        came. False: every frame with such a box is left out as a whole, since an image
        without some of its labels would teach a model that nothing is there. No effect
        with `include` ``all``.
    rejected : ``drop``, or ``dontcare``: as regions that training and scoring ignore,
        where the format has such a thing
    boxes : ``visible``, ``amodal`` or ``tight`` rectangles, where a box has several
    images : ``copy`` or ``none``
    allow_missing_images : bool
        Also frames without an image. They are left out otherwise, if images are copied,
        since programs refuse labels whose image is missing, and all others with them.
    split : tuple of float
        Shares of the parts train, val and test, 0..1, made by whole sequences
        (`part_by_shares`); of one number the rest is that of val. Empty: every frame
        keeps the part that it has, and those without one are split by `split_of`.
    split_by : ``sequence``, or ``map``: exactly the shares of `split` of each map,
        frame by frame, whatever the sequences
    val_maps : str
        Names of maps, separated by commas: all their frames are the part val, all
        others the part train.
    bands : tuple of int, metres
        Labels once more for each, with the boxes up to that distance.
    pictures : int
        The first frames of which pictures are written, before and after the filter.
    drawn : bool
        Also pictures of each frame with its boxes, before and after the filter.
    """

    include: Include = "effective"
    include_unmeasured: bool = True
    rejected: Rejected = "drop"
    boxes: Boxes = "visible"
    images: Images = "copy"
    allow_missing_images: bool = False
    split: tuple[float, ...] = ()
    split_by: SplitBy = "sequence"
    val_maps: str = ""
    bands: tuple[int, ...] = ()
    pictures: int = 0
    drawn: bool = False

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                text = repr(getattr(self, name))[:40]
                raise _bad(name, f"one of {', '.join(choices)}", text)
        self._check_types()
        if not 0 <= self.pictures <= MAX_PICTURES:
            raise _bad("pictures", f"0 to {MAX_PICTURES} frames", f"{self.pictures}")
        self._check_split()
        if len(self.bands) > MAX_BANDS:
            raise _bad("bands", f"at most {MAX_BANDS} distances", f"{len(self.bands)}")
        for band in self.bands:
            if not 0 < band <= MAX_BAND or band != int(band):
                raise _bad("bands", f"whole metres from 1 to {MAX_BAND}", f"{band}")

    def _check_split(self) -> None:
        shares = self.split
        for share in shares:
            if not 0 <= share <= 1:
                raise _bad("split", "a share from 0 to 1", f"{share}")
        if not isinstance(self.val_maps, str):
            raise _bad("val_maps", "names of maps", repr(self.val_maps)[:40])
        if self.val_maps and (shares or self.split_by != "sequence"):
            raise _bad("val_maps", "neither split nor split_by beside it", "one")
        if self.split_by == "map" and not shares:
            raise _bad("split_by", "split, the shares of each map", "none")
        if len(shares) > len(PARTS):
            raise _bad("split", f"shares of {', '.join(PARTS)}", f"{len(shares)}")
        if len(shares) > 1 and abs(sum(shares) - 1) > _SUM_TOLERANCE:
            raise _bad("split", "shares whose sum is 1", f"{round(sum(shares), 6)}")

    def _check_types(self) -> None:
        for name in ("include_unmeasured", "allow_missing_images", "drawn"):
            if not isinstance(getattr(self, name), bool):
                text = repr(getattr(self, name))[:40]
                raise _bad(name, "true or false", text)
        pictures = (self.pictures,)
        numbers = {"split": self.split, "bands": self.bands, "pictures": pictures}
        for name, values in numbers.items():
            for value in values:
                if isinstance(value, bool) or not isinstance(value, Real):
                    raise _bad(name, "a number", repr(value)[:40])

    @classmethod
    def from_mapping(cls, options: JsonObject) -> ExportOptions:
        """Options by name, as JSON or a command line gives them.

        Raises `ExportError`: an unknown option, or a value that is not allowed.
        """
        names = [field.name for field in fields(cls)]
        for name in options.keys() - set(names):
            raise _bad("options", f"only {', '.join(names)}", repr(name)[:40])
        several = {name: options.get(name, ()) for name in ("split", "bands")}
        lists = {
            name: tuple(value) if isinstance(value, list | tuple) else (value,)
            for name, value in several.items()
        }
        made = cls(**{**options, **lists})
        return replace(made, bands=tuple(sorted(set(made.bands))))


def non_default_options(options: Dataclass) -> frozenset[str]:
    """Names of the options of an export that differ from their defaults.

    A format refuses those that it does not have; manifest.json lists the others.
    """
    return frozenset(
        field.name
        for field in fields(options)
        if getattr(options, field.name) != field.default
    )


class ExportError(FilterError):
    """An export whose counts do not add up, or whose input is incomplete."""

    code = "bad_export"


class GivenAnnotation:
    """One frame's annotation as it was sent; it is parsed on first use.

    It was checked when it was uploaded, and is not checked again.

    Parameters
    ----------
    read : callable
        Gives the annotation; called at most once, and only if a part of it is used.
    wh : (width, height) of the image, px
    crowds : bool
        Whether boxes of it may be crowds. If False, it need not be read to find out.
    may_be_of : callable
        Whether its labels may have come in the format of this name; likewise.
    """

    def __init__(
        self,
        read: Callable[[], JsonObject],
        wh: tuple[int, int],
        *,
        crowds: bool = True,
        may_be_of: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self._read = read
        self._wh = wh
        self.may_have_crowds = crowds
        self.may_be_of = may_be_of

    @cached_property
    def frame(self) -> JsonObject:
        """The whole annotation."""
        return self._read()

    @property
    def boxes(self) -> Sequence[Mapping[str, object]]:
        """Each box with all its keys as given, unknown keys included."""
        boxes: Sequence[Mapping[str, object]] = self.frame.get("boxes", ())
        return boxes

    @cached_property
    def camera(self) -> Camera | None:
        """The camera, if all of it is known."""
        return read_camera(self.frame.get("camera"), Faults())[0]

    @cached_property
    def vertices(self) -> FloatArray:
        """(N, 8, 3) metres: world corners of 3D boxes; NaN rows for 2D boxes."""
        if not any(box.keys() & FORMS_3D for box in self.boxes):
            return np.broadcast_to(np.nan, (len(self.boxes), 8, 3))
        return frame_vertices(parse_annotation(self.frame))

    def rectangles(self, rows: Sequence[int]) -> BoxesXYXY:
        """The rectangles of some boxes as given; see `given_rectangles`."""
        boxes = self.boxes
        return given_rectangles([boxes[row] for row in rows], self._wh)

    def is_crowd(self, count: int) -> BoolArray:
        """(count,): whether COCO says that a box stands for many objects at once."""
        crowd = np.zeros(count, np.bool_)
        if self.may_have_crowds:
            crowd[:] = [box.get("iscrowd") in (1, True) for box in self.boxes]
        return crowd

    def frame_extra(self) -> dict[str, object]:
        """The unknown keys of the frame."""
        return _extra(self.frame, KNOWN_FRAME_KEYS)

    def box_extra(self, row: int) -> dict[str, object]:
        """The unknown keys of one box."""
        return _extra(self.boxes[row], KNOWN_BOX_KEYS)


def _bad(name: str, expected: str, found: str) -> ExportError:
    return ExportError(
        f"{name}: expected {expected}, found {found}", pointer=f"/options/{name}"
    )


def _extra(raw: Mapping[str, object], known_keys: frozenset[str]) -> dict[str, object]:
    nested = raw.get("extra")
    unknown = {key: value for key, value in raw.items() if key not in known_keys}
    return {**(nested if isinstance(nested, Mapping) else {}), **unknown}
