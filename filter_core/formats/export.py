"""What a writer of a format is given: frames with decisions, a head, options, a sink.

Frames come one at a time, and the sink takes each file in pieces, so that an export
never has a whole dataset in memory. The options are the same for every format; each
says which it heeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.frame import FrameAnnotation
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from filter_core.errors import FilterError
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import BoxGeometry
from filter_core.types import FloatArray

Sink: TypeAlias = Callable[[str, Iterable[bytes]], None]
"""Takes a file's name inside the export and its content, piece by piece."""

Rectangle: TypeAlias = Sequence[float]

IMAGE_SUFFIX: Final = {"image/png": ".png", "image/jpeg": ".jpg"}


@dataclass(frozen=True)
class ExportBox:
    """One box as a writer needs it.

    Attributes
    ----------
    decision : mapping
        As `filter_core.decisions.record.label_dicts` makes it, or `decision_dicts` for
        a format that needs whole decisions; a server's ``effective_verdict`` in it
        counts before ``verdict``, and its ``review`` says who decided.
    given_xyxy : (4,) px or None
        The rectangle as it came, to tell what was clipped.
    given : mapping
        The box's annotation as it came, with the keys that only its own format knows.
    vertices : (8, 3) float64, metres, or None
        World corners of a 3D box.
    """

    decision: Mapping[str, object]
    given_xyxy: Rectangle | None = None
    given: Mapping[str, Any] = field(default_factory=dict)
    vertices: FloatArray | None = None

    @property
    def id(self) -> str:
        """The box's id in its frame."""
        return str(self.decision["id"])

    @property
    def class_name(self) -> str:
        """The box's class."""
        return str(self.decision["class"])

    @property
    def verdict(self) -> str:
        """What counts: a person's answer, else the filter's."""
        return str(self.decision.get("effective_verdict") or self.decision["verdict"])

    @property
    def is_reviewed(self) -> bool:
        """Whether a person has decided, and not only looked."""
        review = self.decision.get("review")
        answer = review.get("verdict") if isinstance(review, Mapping) else None
        return answer in ("keep", "reject")

    @property
    def is_unsure(self) -> bool:
        """Whether a person has looked and could not say."""
        review = self.decision.get("review")
        return isinstance(review, Mapping) and review.get("verdict") == "unsure"

    @property
    def is_lossy(self) -> bool:
        """Whether it was measured on a segmentation that lost colours."""
        return bool(self.decision.get("lossy"))

    @property
    def is_crowd(self) -> bool:
        """Whether COCO says that it stands for many objects at once."""
        return self.given.get("iscrowd") in (1, True)

    @property
    def extra(self) -> dict[str, Any]:
        """What its annotation says beyond what the product knows."""
        return _extra(self.given, KNOWN_BOX_KEYS)

    @property
    def distance(self) -> float | None:
        """Metres, where it is known."""
        value = self.decision.get("distance")
        return float(value) if isinstance(value, (int, float)) else None

    def rectangle(self, name: str) -> Rectangle | None:
        """One of the decision's rectangles; None where it has none."""
        value = self.decision.get(name)
        return value if isinstance(value, Sequence) else None


@dataclass(frozen=True)
class ExportFrame:
    """One frame to be exported.

    Attributes
    ----------
    key : str
    wh : (width, height) of the image, px
    boxes : sequence of ExportBox
    map : str or None
    media_type : str
        Of the image: ``image/png`` or ``image/jpeg``.
    read_image : callable or None
        Gives the image's bytes; called only if images are copied.
    palette : str or None
    annotation : mapping
        The frame's annotation as it came.
    camera : Camera or None
    """

    key: str
    wh: tuple[int, int]
    boxes: Sequence[ExportBox]
    map: str | None = None
    media_type: str = "image/png"
    read_image: Callable[[], bytes] | None = None
    palette: str | None = None
    annotation: Mapping[str, Any] = field(default_factory=dict)
    camera: Camera | None = None

    @property
    def extra(self) -> dict[str, Any]:
        """What its annotation says beyond what the product knows."""
        return _extra(self.annotation, KNOWN_FRAME_KEYS)


@dataclass(frozen=True)
class ExportHead:
    """What an export says of itself.

    Attributes
    ----------
    classes : tuple of str
        The dataset's classes in their frozen order; a class's number is its place.
    facts : mapping
        The first keys of ``manifest.json``: dataset, run, config digest, last review.
    expected_boxes : int or None
        As many boxes must come, or the export fails.
    temporary : Path or None
        Where parts wait that do not fit into memory; else the system's own place.
    """

    classes: tuple[str, ...]
    facts: Mapping[str, object] = field(default_factory=dict)
    expected_boxes: int | None = None
    temporary: Path | None = None


def _extra(given: Mapping[str, Any], known: frozenset[str]) -> dict[str, Any]:
    nested = given.get("extra")
    unknown = {key: value for key, value in given.items() if key not in known}
    return {**(nested if isinstance(nested, Mapping) else {}), **unknown}


def export_boxes(
    annotation: FrameAnnotation,
    decisions: Iterable[Mapping[str, object]],
    geometry: BoxGeometry,
) -> list[ExportBox]:
    """The boxes of a frame from its annotation, decisions and rectangles, in order."""
    given = geometry.xyxy.tolist()
    return [
        ExportBox(
            decision,
            given_xyxy=given[row],
            given=box.raw,
            vertices=geometry.vertices[row] if box.is_3d else None,
        )
        for row, (box, decision) in enumerate(
            zip(annotation.boxes, decisions, strict=True)
        )
    ]


Include = Literal["effective", "kept", "all"]

Rejected = Literal["drop", "dontcare"]

Boxes = Literal["visible", "amodal", "tight"]

Images = Literal["copy", "none"]

_CHOICES: Final = {
    "include": get_args(Include),
    "rejected": get_args(Rejected),
    "boxes": get_args(Boxes),
    "images": get_args(Images),
}

MAX_BANDS: Final = 16

MAX_BAND: Final = 100_000
"""Metres; a label folder is named after its band."""


class ExportError(FilterError):
    """An export whose numbers do not add up, or that lacks what it needs."""

    code = "bad_export"


@dataclass(frozen=True)
class ExportOptions:
    """Choices of an export.

    Attributes
    ----------
    include : ``effective`` (what a person or else the filter keeps), ``kept`` (what the
        filter keeps, whatever people say) or ``all``
    include_unmeasured : bool
        Also boxes that nothing could be measured of and nobody has decided.
    rejected : ``drop``, or ``dontcare``: as regions that training and scoring ignore,
        where the format has such a thing
    boxes : ``visible``, ``amodal`` or ``tight`` rectangles, where a box has several
    images : ``copy`` or ``none``
    split : share of the frames that are for training, 0..1
    bands : tuple of int, metres
        Labels once more for each, with the boxes up to that distance.
    """

    include: Include = "effective"
    include_unmeasured: bool = False
    rejected: Rejected = "drop"
    boxes: Boxes = "visible"
    images: Images = "copy"
    split: float = 0.8
    bands: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                found = repr(getattr(self, name))[:40]
                raise _bad(name, f"one of {', '.join(choices)}", found)
        if not 0 <= self.split <= 1:
            raise _bad("split", "a share from 0 to 1", f"{self.split}")
        if len(self.bands) > MAX_BANDS:
            raise _bad("bands", f"at most {MAX_BANDS} distances", f"{len(self.bands)}")
        for band in self.bands:
            if not 0 < band <= MAX_BAND or band != int(band):
                raise _bad("bands", f"whole metres from 1 to {MAX_BAND}", f"{band}")

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> ExportOptions:
        """Options by name, as JSON or a command line gives them.

        Raises
        ------
        ExportError
            An option that there is not, or a value that it cannot have.
        """
        names = [field.name for field in fields(cls)]
        for name in given.keys() - set(names):
            raise _bad("options", f"only {', '.join(names)}", repr(name)[:40])
        bands = given.get("bands", ())
        distances = (bands,) if isinstance(bands, (int, float)) else tuple(bands)
        return cls(**{**given, "bands": tuple(sorted(set(distances)))})

    def changed(self) -> frozenset[str]:
        """Names of the options that are not as they are by default."""
        usual = ExportOptions()
        return frozenset(
            field.name
            for field in fields(self)
            if getattr(self, field.name) != getattr(usual, field.name)
        )


def _bad(name: str, expected: str, found: str) -> ExportError:
    return ExportError(
        f"{name}: expected {expected}, found {found}", pointer=f"/options/{name}"
    )
