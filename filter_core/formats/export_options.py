"""What of a dataset is exported, and how: one set of options for every format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, get_args

from filter_core.errors import FilterError

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
