"""Declares keys of a configuration, and the kinds of evidence that it can select.

A key is a field of a dataclass whose metadata hold a `Key`: its allowed values, default
and description. `declared` makes such a field; `PERCENT`, `METRES`, `counted`, `limit`
and `AllowedWords` are allowed values. `keys_of` lists the keys of a class, for the
checks, the JSON schema, the documentation and the reader of carlasimu's files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import Field, field, fields
from typing import (
    Any,
    ClassVar,
    Final,
    Literal,
    NamedTuple,
    Protocol,
    TypeAlias,
    get_args,
)

from filter_core.errors import ConfigError
from filter_core.values import place_of, pointer_token, shown, similar

Number: TypeAlias = float | int


class Allowed(Protocol):
    """The allowed values of a key. ``str()`` describes them for people."""

    def checked(self, name: str, value: object, at: str = "") -> object:
        """The value in its one canonical form.

        Parameters
        ----------
        name : str
            The key.
        value : object
            As a file or a request has it.
        at : str
            JSON pointer of the mapping that the key is in.

        Raises
        ------
        ConfigError
            The value is not allowed; the message names key, value and what is allowed.
        """

    def schema(self) -> dict[str, object]:
        """The same as JSON schema."""


class NumberRange(NamedTuple):
    """Numbers from `low` to `high`, both included; perhaps null as well.

    Attributes
    ----------
    low, high : float or int
    unit : str
        In the plural, such as ``metres``.
    whole : bool
        Whether fractions are refused.
    null : float or None
        Null (no limit) is allowed if this is a number: the one that stands for it in
        arrays, such as ``inf``. None: null is refused.
    """

    low: Number
    high: Number
    unit: str
    whole: bool = False
    null: float | None = None

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        null = "" if self.null is None else " or null"
        return f"{kind} from {self.low} to {self.high} {self.unit}{null}"

    def checked(self, name: str, value: object, at: str = "") -> Number | None:
        """See `Allowed.checked`.

        Whole numbers become ``int`` and others ``float``, so that 10 and 10.0 are the
        same configuration with the same digest.
        """
        if value is None and self.null is not None:
            return None
        # YAML's yes and no are booleans, which Python would take for 1 and 0.
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _refused(name, value, str(self), at)
        inside = self.low <= value <= self.high  # False for NaN
        if not inside or (self.whole and value != int(value)):
            raise _refused(name, value, str(self), at)
        return int(value) if value == int(value) else value

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`."""
        kind = "integer" if self.whole else "number"
        return {
            "type": kind if self.null is None else [kind, "null"],
            "minimum": self.low,
            "maximum": self.high,
            "x-unit": self.unit,
        }


class AllowedWords(NamedTuple):
    """One of a few words."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"one of {', '.join(self.words)}"

    def checked(self, name: str, value: object, at: str = "") -> str:
        """See `Allowed.checked`; the message suggests the nearest word."""
        if not isinstance(value, str) or value not in self.words:
            close = similar(value, self.words)
            hint = f"; did you mean {close!r}?" if close else ""
            raise _refused(name, value, str(self), at, hint)
        return value

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`."""
        return {"type": "string", "enum": list(self.words)}


class Key(NamedTuple):
    """The declaration of one key of a configuration.

    Attributes
    ----------
    allowed : Allowed
    default : object
    sentence : str
        What it means, for people.
    evidence : tuple of str
        The kinds of evidence (`EVIDENCE`) whose rules use the key; empty: all.
    needs_pixels : bool
        Whether images may have to be read again after it has changed.
    carlasimu : str or None
        Where the authors' boundingBox.yaml has it, as ``sitting.cam_rgb.max_distance``.
    shown_before : str or None
        The key before which it is listed; None: in the order of declaration.
    later : bool
        The key was added after configurations without it had been stored. While it has
        its default, the digest of a configuration leaves it out, so that the digests of
        those do not change; therefore its default must never change either.
    """

    allowed: Allowed
    default: object
    sentence: str
    evidence: tuple[str, ...] = ()
    needs_pixels: bool = False
    carlasimu: str | None = None
    shown_before: str | None = None
    later: bool = False

    def is_left_out(self, value: object) -> bool:
        """Whether a digest leaves the key out, as it does later ones by default."""
        return self.later and value == self.default

    def schema(self) -> dict[str, object]:
        """Its JSON schema, without the default."""
        schema = {**self.allowed.schema(), "description": self.sentence}
        if self.evidence:
            tried = any(name in STRONGEST_FIRST for name in self.evidence)
            schema["x-evidence"] = [*self.evidence, *([AUTO] if tried else [])]
        return schema | {"x-needs-pixels": self.needs_pixels}


_KEY: Final = "key"

_MAX_METRES: Final = 1_000_000

# The largest signed 32-bit integer, so that every count can be stored anywhere.
_MAX_COUNT: Final = 2**31 - 1

PERCENT: Final = NumberRange(0, 100, "percent")

METRES: Final = NumberRange(0, _MAX_METRES, "metres")


def counted(unit: str) -> NumberRange:
    """Whole numbers of something, such as ``pixels``."""
    return NumberRange(0, _MAX_COUNT, unit, whole=True)


def limit(null: float) -> NumberRange:
    """Distances in metres that boxes are compared with.

    In files, null means no limit. In arrays, the number `null` (-inf or inf) stands
    for it.
    """
    return METRES._replace(null=null)


_Field: TypeAlias = Any
"""`dataclasses.field`, typed so that it fits every annotation."""


def declared(key: Key) -> _Field:
    """A dataclass field that declares this key."""
    return field(default=key.default, metadata={_KEY: key})


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


def keys_of(config_class: type[_Dataclass]) -> dict[str, Key]:
    """The keys that a dataclass declares, by name, in the order of listings."""
    found: dict[str, Key] = {
        spec.name: spec.metadata[_KEY]
        for spec in fields(config_class)
        if _KEY in spec.metadata
    }
    names: list[str] = []
    for name, key in found.items():
        before = key.shown_before
        names.insert(names.index(before) if before else len(names), name)
    return {name: found[name] for name in names}


def refuse_unknown_keys(
    keys: Iterable[object], valid: Iterable[str], *, at: str = ""
) -> None:
    """Raise `ConfigError` for the first key that is not valid."""
    known = tuple(valid)
    for key in keys:
        if key not in known:
            close = similar(key, known)
            hint = (
                f"the nearest valid key is {close!r}"
                if close
                else f"expected one of {', '.join(known)}"
            )
            raise ConfigError(
                f"{place_of(at)}unknown key {_quoted(key)}; {hint}",
                pointer=f"{at}/{pointer_token(key)}",
                code="unknown_key",
            )


def _refused(
    name: str, value: object, expected: str, at: str, hint: str = ""
) -> ConfigError:
    return ConfigError(
        f"{place_of(at)}{name}: expected {expected}, found {shown(value)}{hint}",
        pointer=f"{at}/{name}",
    )


def _quoted(key: object) -> str:
    text = repr(key)
    return text if len(text) <= 60 else f"{text[:57]}..."


ChannelName: TypeAlias = Literal[
    "ordered", "depth", "depth_center", "instance", "lidar"
]
"""The channels: the kinds of evidence besides the segmentation."""

EvidenceName: TypeAlias = Literal["semantic", ChannelName]
"""The kinds of evidence: what a box can be judged by."""

EvidenceChoice: TypeAlias = Literal[EvidenceName, "auto"]
"""The values of the key ``evidence``."""


class EvidenceKind(NamedTuple):
    """One value of the key ``evidence``: what boxes can be judged by.

    Attributes
    ----------
    name : EvidenceChoice
        The value itself.
    needs : str
        What a frame must have, as text for people.
    keeps : str
        When a box is kept, as text for people.
    file : str or None
        The kind of file that is read for it besides the segmentation.
    strength : int
        ``auto`` tries the strongest first; 0: ``auto`` does not try it.
    """

    name: EvidenceChoice
    needs: str
    keeps: str
    file: str | None = None
    strength: int = 0


SEMANTIC: Final = "semantic"

AUTO: Final = "auto"

EVIDENCE: Final = (
    EvidenceKind(
        SEMANTIC,
        "segmentation",
        "enough of its pixels carry an accepted tag (the thresholds above)",
    ),
    EvidenceKind(
        "ordered",
        "segmentation, distances or 3D boxes",
        "`ordered_min_pixels` of them are not explained by nearer boxes; "
        "`min_visible_pixels` where nothing nearer explains any",
        strength=1,
    ),
    EvidenceKind(
        "depth",
        "segmentation, raw depth, camera, 3D boxes",
        "`min_visible_pixels` of them lie within the box's own depth, give or take "
        "`depth_tolerance`",
        file="depth",
        strength=2,
    ),
    EvidenceKind(
        "depth_center",
        "raw depth, camera, 3D boxes",
        "nothing nearer is seen at its centre: another method, for comparison",
        file="depth",
    ),
    EvidenceKind(
        "instance",
        "instance image",
        "`min_visible_pixels` of its own instance are seen",
        file="instances",
        strength=3,
    ),
    EvidenceKind(
        "lidar",
        "semantic LiDAR with its transform, 3D boxes",
        "`lidar_min_points` of an accepted tag lie inside it",
        file="lidar",
    ),
    EvidenceKind(
        AUTO,
        "the data of instance, depth or ordered",
        "the strongest of instance, depth and ordered that has a number",
    ),
)
"""The values of the key ``evidence``.

They are the segmentation alone, the channels besides it, and ``auto``.
"""

CHANNELS: Final[tuple[ChannelName, ...]] = get_args(ChannelName)
"""The names of the channels besides the segmentation, in the order of listings."""

_KINDS: Final = {one.name: one for one in EVIDENCE}

STRONGEST_FIRST: Final[tuple[ChannelName, ...]] = tuple(
    sorted(
        (name for name in CHANNELS if _KINDS[name].strength),
        key=lambda name: -_KINDS[name].strength,
    )
)
"""The channels that ``auto`` tries, in this order."""

FILE_OF: Final[Mapping[str, str]] = {
    one.name: one.file for one in EVIDENCE if one.file is not None
}
"""The kind of file that a channel reads besides the segmentation, if it reads one."""


def files_for(channels: Iterable[str]) -> tuple[str, ...]:
    """The kinds of files that channels read, besides the segmentation."""
    return tuple(sorted({FILE_OF[name] for name in channels if name in FILE_OF}))
