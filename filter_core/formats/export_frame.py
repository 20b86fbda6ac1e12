"""What a writer is given: one frame at a time, with its decisions, and a sink."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias
from urllib.parse import quote

Sink: TypeAlias = Callable[[str, Iterable[bytes]], None]
"""Takes a file's name inside the export and its content, piece by piece."""

Rectangle: TypeAlias = Sequence[float]

IMAGE_SUFFIX: Final = {"image/png": ".png", "image/jpeg": ".jpg"}

_SAFE: Final = " ()[]{}+-=_.,;!@#$^&~'"
_RESERVED: Final = frozenset(
    {"con", "prn", "aux", "nul", "images", "labels"}
    | {f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10)}
)
"""Names that Windows gives to devices, and those by which YOLO finds its labels."""

_MAX_PART_BYTES: Final = 180
"""File systems allow 255 for one name; a suffix is still to come."""


@dataclass(frozen=True)
class ExportBox:
    """One box as a writer needs it.

    Attributes
    ----------
    decision : mapping
        As `filter_core.decision_record.decision_dict` makes it; a server's
        ``effective_verdict`` in it counts before ``verdict``.
    given_xyxy : (4,) px or None
        The rectangle as it came, to tell what was clipped.
    """

    decision: Mapping[str, object]
    given_xyxy: Rectangle | None = None

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
    """

    key: str
    wh: tuple[int, int]
    boxes: Sequence[ExportBox]
    map: str | None = None
    media_type: str = "image/png"
    read_image: Callable[[], bytes] | None = None
    palette: str | None = None


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
    """

    classes: tuple[str, ...]
    facts: Mapping[str, object] = field(default_factory=dict)
    expected_boxes: int | None = None


def file_stem(key: str) -> str:
    """A frame's key as a path inside an export, different for every key.

    Keys come from users: whatever a file system or an unpacking tool could take for
    something else is written as ``%`` and its code. Sub-folders stay.
    """
    return "/".join(_safe_part(part) for part in key.split("/"))


def _safe_part(part: str) -> str:
    letters = [
        letter if letter.isalnum() or letter in _SAFE else _escaped(letter)
        for letter in part
    ]
    # A leading dot hides a file; Windows drops a space or a dot at the end.
    for place in (0, -1):
        if letters and letters[place] in (" ", "."):
            letters[place] = f"%{ord(letters[place]):02X}"
    text = "".join(letters)
    if text.partition(".")[0].lower() in _RESERVED:
        return f"%{ord(text[0]):02X}{text[1:]}"
    if len(text.encode("utf-8", "surrogatepass")) > _MAX_PART_BYTES:
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
        text = f"{text[: _MAX_PART_BYTES // 6]}%~{digest[:32]}"
    return text or "%"


def _escaped(letter: str) -> str:
    return quote(letter, safe="", errors="surrogatepass")
