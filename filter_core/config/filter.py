"""Configurations of the filter (`FilterConfig`), and how two of them differ.

`FilterConfig` extends `DecideConfig`, which has the keys that verdicts depend on once
everything is measured; `FilterConfig.measuring` returns the `MeasureConfig`, on which
measured numbers depend. Configurations are frozen and identified by their digest.

Each key is declared once, as a field of one of the classes here; checks, JSON schema
(`schema_of`), documentation and configuration files follow from the declaration.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Final, Generic, NamedTuple, TypedDict, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from filter_core.classes import MAX_ACCEPT, canonical_accept, canonical_class
from filter_core.config.keys import (
    AUTO,
    CHANNELS,
    METRES,
    PERCENT,
    SEMANTIC,
    STRONGEST_FIRST,
    AllowedWords,
    ChannelName,
    EvidenceChoice,
    Key,
    Number,
    NumberRange,
    counted,
    declared,
    keys_of,
    limit,
    refuse_unknown_keys,
)
from filter_core.config.measure import MeasureConfig
from filter_core.errors import ConfigError
from filter_core.segmentation.palettes import LAST_TAG
from filter_core.segmentation.reading import (
    PALETTES,
    Encoding,
    Lossy,
    OrderOfChannels,
    SegmentationOptions,
)
from filter_core.types import FloatArray, IntArray, Profile, ProjectionMode
from filter_core.values import JsonObject, place_of, pointer_token, shown


class Inherit(Enum):
    """The value of a key that a class does not override; None would mean no limit."""

    GLOBAL = "global"


INHERIT: Final = Inherit.GLOBAL


ShareT = TypeVar("ShareT")

CountT = TypeVar("CountT")

DistanceT = TypeVar("DistanceT")


@dataclass(frozen=True, kw_only=True, init=False, eq=False, repr=False)
class ClassKeys(Generic[ShareT, CountT, DistanceT]):
    """The keys that single object classes can override.

    Four subclasses have these keys, with values of different types: `DecideConfig` has
    the global values; `ClassConfig` those that one class overrides, or `INHERIT`;
    `ClassLimits` the values that apply to one class, taken from these two; `Thresholds`
    the values that apply to each of several classes, as arrays.
    """

    threshold_small_box: ShareT = declared(
        Key(
            PERCENT,
            10,
            "Share of a box's pixels that must carry a tag of its class.",
            evidence=(SEMANTIC,),
            carlasimu="sitting.threshold_small_box",
        )
    )
    size_big_box: ShareT = declared(
        Key(
            PERCENT,
            70,
            "A box is large if it covers more than this share of the image; in profile "
            "carlasimu, this share or more.",
            evidence=(SEMANTIC,),
            carlasimu="sitting.size_big_box",
        )
    )
    threshold_big_box: ShareT = declared(
        Key(
            PERCENT,
            50,
            "Share of a large box's pixels that must carry a tag of its class.",
            evidence=(SEMANTIC,),
            carlasimu="sitting.threshold_big_box",
        )
    )
    min_visible_pixels: CountT = declared(
        Key(
            counted("pixels"),
            1,
            "Fewest pixels that must be seen of a box: with a tag of its class, or of "
            "its instance.",
            evidence=(SEMANTIC, "ordered", "depth", "instance"),
        )
    )
    min_distance: DistanceT = declared(
        Key(
            limit(-np.inf),
            None,
            "Nearest distance at which boxes are kept; null: no limit.",
            carlasimu="sitting.cam_rgb.min_distance",
        )
    )
    max_distance: DistanceT = declared(
        Key(
            limit(np.inf),
            None,
            "Farthest distance at which boxes are kept; null: no limit.",
            carlasimu="sitting.cam_rgb.max_distance",
        )
    )


_NUMBER_RANGES: Final = {
    name: key.allowed
    for name, key in keys_of(ClassKeys).items()
    if isinstance(key.allowed, NumberRange)
}

_Class = TypeVar("_Class", bound=type)


def _inheriting(cls: _Class) -> _Class:
    """Class decorator: make `INHERIT` the default of every key of `ClassKeys`.

    To be written below ``@dataclass``, which then finds the defaults.
    """
    for spec in fields(ClassKeys):
        cls.__annotations__[spec.name] = spec.type
        setattr(cls, spec.name, field(default=INHERIT, metadata=spec.metadata))
    return cls


class _TagSet:
    """The values that the key ``accept`` may have: lists of tags. See `Allowed`."""

    def __str__(self) -> str:
        return f"a list of 1 to {MAX_ACCEPT} tag names or numbers"

    def checked(self, name: str, value: object, at: str = "") -> tuple[str | int, ...]:
        return canonical_accept(value, at=f"{at}/{name}")

    def schema(self) -> dict[str, object]:
        number = {"type": "integer", "minimum": 0, "maximum": LAST_TAG}
        return {
            "type": "array",
            "items": {"anyOf": [{"type": "string"}, number]},
            "minItems": 1,
            "maxItems": MAX_ACCEPT,
        }


@dataclass(frozen=True, kw_only=True)
@_inheriting
class ClassConfig(
    ClassKeys[Number | Inherit, int | Inherit, Number | Inherit | None],
):
    """The values that a configuration overrides for one class, or `INHERIT`."""

    accept: tuple[str | int, ...] | Inherit = declared(
        Key(
            _TagSet(),
            INHERIT,
            "Tags whose pixels count for the class, by name or number.",
            needs_pixels=True,
        )
    )

    def __post_init__(self) -> None:
        for name, key in _CLASS_KEYS.items():
            value = getattr(self, name)
            if value is not INHERIT:
                object.__setattr__(self, name, key.allowed.checked(name, value))

    def as_dict(self) -> dict[str, object]:
        """The overridden keys alone, in canonical form."""
        given = {name: getattr(self, name) for name in _CLASS_KEYS}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in given.items()
            if value is not INHERIT
        }

    @classmethod
    def from_mapping(cls, raw: object, *, at: str = "") -> ClassConfig:
        """One class's overrides, checked; `at` is their JSON pointer.

        Raises
        ------
        ConfigError
            Not a mapping, an unknown key, or a wrong value.
        """
        if not isinstance(raw, Mapping):
            raise ConfigError(
                f"{place_of(at)}expected a mapping of keys, found {shown(raw)}",
                pointer=at,
            )
        refuse_unknown_keys(raw, _CLASS_KEYS, at=at)
        make: Callable[..., ClassConfig] = cls
        return make(
            **{
                name: _CLASS_KEYS[name].allowed.checked(name, raw[name], at)
                for name in raw
            }
        )


_CLASS_KEYS: Final = keys_of(ClassConfig)


@dataclass(frozen=True, kw_only=True)
class ClassLimits(ClassKeys[Number, int, Number | None]):
    """The numbers that apply to one class: its own, else the global ones.

    Percent, pixels and metres; None is no limit on the distance.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class Thresholds(ClassKeys[FloatArray, IntArray, FloatArray]):
    """`ClassLimits` of K classes: every attribute is a (K,) array.

    Percent and metres are float64, pixels int64; no limit on the distance is ``-inf``
    or ``inf``. A box whose match is exactly the threshold passes under profile
    ``paper`` and fails under ``carlasimu``. A box of exactly `size_big_box` is large
    only under ``carlasimu``. A box that is exactly at any other limit is within it.

    Attributes
    ----------
    threshold_kept_large_box : (K,) float64, percent
        What a large box must reach to be kept: `threshold_big_box`, or under profile
        ``carlasimu`` the higher of both thresholds, since it must pass both.
    """

    threshold_kept_large_box: FloatArray


@dataclass(frozen=True, kw_only=True)
class DecideConfig(ClassKeys[Number, int, Number | None]):
    """The keys that verdicts depend on once everything is measured.

    Some of them, such as `profile`, change what is measured as well: those have
    `Key.needs_pixels`. Percent are 0..100, distances metres. Wrong values raise
    `ConfigError` when the object is made, so every `DecideConfig` is valid.
    """

    profile: Profile = declared(
        Key(
            AllowedWords(get_args(Profile)),
            "paper",
            "How boxes are counted and compared: as the paper says, or bit for bit as "
            "its authors' published code does.",
            needs_pixels=True,
            shown_before="threshold_small_box",
        )
    )
    evidence: EvidenceChoice = declared(
        Key(
            AllowedWords(get_args(EvidenceChoice)),
            SEMANTIC,
            "By what boxes are judged: the segmentation, or a channel besides it.",
            needs_pixels=True,
        )
    )
    depth_tolerance: Number = declared(
        Key(
            METRES,
            0.15,
            "How far in front of a box and behind it a depth may lie and still be its "
            "own.",
            evidence=("depth", "depth_center"),
            needs_pixels=True,
        )
    )
    ordered_min_pixels: int = declared(
        Key(
            counted("pixels"),
            3,
            "Fewest pixels with a tag of its class that nearer boxes must leave to a "
            "box.",
            evidence=("ordered",),
        )
    )
    lidar_min_points: int = declared(
        Key(
            counted("points"),
            5,
            "Fewest LiDAR points with a tag of its class that must lie inside a box.",
            evidence=("lidar",),
        )
    )
    classes: Mapping[str, ClassConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, key in keys_of(type(self)).items():
            # The canonical form of the value: 10.0 becomes 10.
            value = key.allowed.checked(name, getattr(self, name))
            object.__setattr__(self, name, value)
        object.__setattr__(self, "classes", _canonical_classes(self.classes))
        self._refuse_crossed_distances()

    def _refuse_crossed_distances(self) -> None:
        names = (None, *self.classes)
        thresholds = self.thresholds_for([name or "" for name in names])
        nearest, farthest = thresholds.min_distance, thresholds.max_distance
        crossed = nearest > farthest
        if crossed.any():
            index = int(np.argmax(crossed))
            at = f"/classes/{pointer_token(names[index])}" if names[index] else ""
            raise ConfigError(
                f"{'classes.' + str(names[index]) + ': ' if at else ''}min_distance: "
                f"expected at most max_distance ({farthest[index]:.15g}), "
                f"found {nearest[index]:.15g}",
                pointer=f"{at}/min_distance",
            )

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """Its keys in the order in which they are shown, ``classes`` at the end."""
        return (*keys_of(cls), "classes")

    @classmethod
    def from_mapping(cls: type[_Config], raw: object) -> _Config:
        """A configuration from a file or a request; missing keys take their defaults.

        Raises
        ------
        ConfigError
            Unknown key (names the nearest valid one) or wrong value.
        """
        if not isinstance(raw, Mapping):
            raise ConfigError(
                f"expected a mapping of keys, found {shown(raw)}", pointer=""
            )
        refuse_unknown_keys(raw, cls.keys())
        given = dict(raw)
        if given.get("classes") is None:
            given["classes"] = {}
        return cls(**given)

    def as_dict(self) -> dict[str, object]:
        """Every key, defaults filled in, ready for JSON; `from_mapping` inverts it."""
        plain = {key: getattr(self, key) for key in keys_of(type(self))}
        overrides = {name: one.as_dict() for name, one in self.classes.items()}
        return {**plain, "classes": overrides}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, as 64 hexadecimal digits.

        A key that was added later (`Key.later`) is left out while it has its default:
        one more key does not change the digests of stored configurations.
        """
        keys = keys_of(type(self))
        hashed = {
            name: value
            for name, value in self.as_dict().items()
            if name not in keys or not keys[name].is_left_out(value)
        }
        canonical = json.dumps(
            hashed, sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        return hashlib.sha256(canonical.encode()).hexdigest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[object, tuple[dict[str, object]]]:
        # A read-only mapping cannot be pickled; worker processes get the plain form.
        return type(self).from_mapping, (self.as_dict(),)

    @property
    def channels(self) -> tuple[ChannelName, ...]:
        """Channels to try in this order; the first with a number judges the box."""
        if self.evidence == SEMANTIC:
            return ()
        return STRONGEST_FIRST if self.evidence == AUTO else (self.evidence,)

    def of_class(self, name: str) -> ClassConfig:
        """The overrides of a class by its name or an alias; all `INHERIT` if none."""
        return self.classes.get(canonical_class(name), _NO_OVERRIDES)

    def limits_of(self, class_name: str) -> ClassLimits:
        """The values for one class: its overrides, and the global values."""
        return _limits_of(self, class_name)

    def thresholds_for(self, class_names: Iterable[str]) -> Thresholds:
        """The values for each of K classes, in the order given."""
        return _thresholds_for(self, tuple(class_names))


_Config = TypeVar("_Config", bound=DecideConfig)


@dataclass(frozen=True, kw_only=True)
class FilterConfig(DecideConfig):
    """Everything that a verdict depends on, except pixels and boxes.

    In addition to the keys of `DecideConfig`, it has those for reading images and
    projecting 3D boxes.
    """

    projection: ProjectionMode = declared(
        Key(
            AllowedWords(get_args(ProjectionMode)),
            "clipped",
            "How 3D boxes become rectangles: cut exactly at the image, or as in the "
            "paper.",
            needs_pixels=True,
            shown_before="depth_tolerance",
        )
    )
    palette: str = declared(
        Key(
            AllowedWords(PALETTES),
            "auto",
            "Which of CARLA's tables of tags segmentations are made with.",
            needs_pixels=True,
        )
    )
    encoding: Encoding = declared(
        Key(
            AllowedWords(get_args(Encoding)),
            "auto",
            "What pixels of segmentations are: colours of a palette, or raw tag "
            "numbers.",
            needs_pixels=True,
        )
    )
    channel_order: OrderOfChannels = declared(
        Key(
            AllowedWords(get_args(OrderOfChannels)),
            "auto",
            "Order of the colour channels of segmentations.",
            needs_pixels=True,
        )
    )
    lossy_segmentation: Lossy = declared(
        Key(
            AllowedWords(get_args(Lossy)),
            "refuse",
            "Whether segmentations as JPEG are refused, or read by the nearest "
            "colours.",
            needs_pixels=True,
        )
    )

    # `dataclass` would hash the fields, and `classes` cannot be hashed.
    __hash__ = DecideConfig.__hash__

    def measuring(
        self,
        dataset: SegmentationOptions | None = None,
        *,
        dataset_name: str = "the dataset",
        ignored: JsonObject | None = None,
    ) -> MeasureConfig:
        """The settings on which measured numbers depend, completed by the dataset's.

        Parameters
        ----------
        dataset : SegmentationOptions, optional
            The dataset's options for segmentations. Default: none.
        dataset_name : str
            The name of the dataset in errors.
        ignored : JsonObject, optional
            The dataset's ignored pixels, which never count.

        Raises
        ------
        SegmentationError
            ``segmentation_contradiction``: dataset and configuration differ.
        """
        own = SegmentationOptions.named_by(self)
        reading = own
        if dataset is not None:
            layers = {dataset_name: dataset, "the configuration": own}
            reading = SegmentationOptions.agreed(layers)
        return MeasureConfig(
            profile=self.profile,
            projection=self.projection,
            own_reading=own,
            reading=reading,
            accept={
                name: one.accept
                for name, one in self.classes.items()
                if one.accept is not INHERIT
            },
            ignored=ignored,
            channels=tuple(name for name in CHANNELS if name in self.channels),
            depth_tolerance=float(self.depth_tolerance),
        )

    def accept_masks(self, class_names: Iterable[str], family: str | None) -> IntArray:
        """(K,) int64: the tags each class accepts; see `MeasureConfig.accept_masks`."""
        return self.measuring().accept_masks(class_names, family)


class _ObjectSchema(TypedDict):
    type: str
    properties: dict[str, dict[str, object]]
    additionalProperties: bool


class ConfigSchema(_ObjectSchema):
    """The JSON schema of a class of configurations."""

    title: str
    description: str


def schema_of(config_class: type[DecideConfig]) -> ConfigSchema:
    """The JSON schema of the mappings that `from_mapping` of a class accepts.

    In addition to standard keywords, a key has ``x-unit``, ``x-evidence`` (the kinds of
    evidence whose rules read it, if not all; ``auto`` if it tries one of them) and
    ``x-needs-pixels`` (whether images may have to be read again after a change).
    """
    properties = {
        name: {**key.schema(), "default": key.default}
        for name, key in keys_of(config_class).items()
    }
    properties["classes"] = {
        "description": "What single classes do differently, by their names.",
        "type": ["object", "null"],
        "propertyNames": {"minLength": 1, "maxLength": _MAX_CLASS_NAME},
        "additionalProperties": _object_schema(
            {name: key.schema() for name, key in _CLASS_KEYS.items()}
        ),
        "default": {},
    }
    return {
        "title": config_class.__name__,
        "description": "What verdicts depend on; every key is optional.",
        **_object_schema(properties),
    }


def _object_schema(properties: dict[str, dict[str, object]]) -> _ObjectSchema:
    return {
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
    }


_NO_OVERRIDES: Final = ClassConfig()

_MAX_CLASS_NAME: Final = 200


def _canonical_classes(raw: object) -> Mapping[str, ClassConfig]:
    if not isinstance(raw, Mapping):
        raise ConfigError(
            f"classes: expected a mapping of class names, found {shown(raw)}",
            pointer="/classes",
        )
    classes: dict[str, ClassConfig] = {}
    for given_name, overrides in raw.items():
        name = canonical_class(_checked_class_name(given_name))
        if name in classes:
            raise ConfigError(
                f"classes: {' and '.join(map(repr, _names_of(name, raw)))} name the "
                "same class; keep one",
                pointer=f"/classes/{pointer_token(given_name)}",
            )
        one = (
            overrides
            if isinstance(overrides, ClassConfig)
            else ClassConfig.from_mapping(
                overrides, at=f"/classes/{pointer_token(given_name)}"
            )
        )
        classes[name] = one
    return MappingProxyType(
        {name: classes[name] for name in sorted(classes) if classes[name].as_dict()}
    )


# Cached: called for every box, with few distinct results.
@lru_cache(maxsize=1024)
def _limits_of(config: DecideConfig, class_name: str) -> ClassLimits:
    own = config.of_class(class_name)
    applying = {
        name: getattr(config if getattr(own, name) is INHERIT else own, name)
        for name in _NUMBER_RANGES
    }
    return ClassLimits(**applying)


# Cached: called for every frame, mostly with the classes of the frame before.
@lru_cache(maxsize=256)
def _thresholds_for(config: DecideConfig, names: tuple[str, ...]) -> Thresholds:
    limits = [config.limits_of(name) for name in names]
    columns: dict[str, NDArray[np.float64 | np.int64]] = {}
    for key, allowed in _NUMBER_RANGES.items():
        values = [getattr(one, key) for one in limits]
        columns[key] = np.array(
            [allowed.null if value is None else value for value in values],
            np.int64 if allowed.whole else np.float64,
        )
    small, large = columns["threshold_small_box"], columns["threshold_big_box"]
    kept_large = np.maximum(small, large) if config.profile == "carlasimu" else large
    columns["threshold_kept_large_box"] = kept_large
    for column in columns.values():
        column.setflags(write=False)
    make: Callable[..., Thresholds] = Thresholds
    return make(**columns)


def _names_of(name: str, classes: Mapping[str, object]) -> list[str]:
    return [given for given in classes if canonical_class(given) == name]


def _checked_class_name(name: object) -> str:
    if (
        not isinstance(name, str)
        or not 0 < len(name) <= _MAX_CLASS_NAME
        or not name.isprintable()
    ):
        raise ConfigError(
            f"classes: expected a class name of 1 to {_MAX_CLASS_NAME} printable "
            f"characters, found {str(name)[:60]!r}",
            pointer="/classes",
        )
    return name


class ConfigChange(NamedTuple):
    """One key in which two configurations differ.

    Attributes
    ----------
    key : str
        Such as ``classes.van.accept`` if it is nested.
    before, after : object
        Its values.
    """

    key: str
    before: object
    after: object


def diff_configs(before: FilterConfig, after: FilterConfig) -> list[ConfigChange]:
    """The keys in which two configurations differ.

    Parameters
    ----------
    before, after : FilterConfig

    Returns
    -------
    list of ConfigChange
        Every key whose value differs, in the order of the keys. An override that only
        one of them has is shown as None on the other side.
    """
    old, new = _flat(before), _flat(after)
    keys = list(dict.fromkeys([*old, *new]))
    return [
        ConfigChange(key, old.get(key), new.get(key))
        for key in keys
        if old.get(key, INHERIT) != new.get(key, INHERIT)
    ]


def _flat(config: FilterConfig) -> dict[str, object]:
    plain = {key: getattr(config, key) for key in keys_of(FilterConfig)}
    nested = {
        f"classes.{name}.{key}": value
        for name, one in config.classes.items()
        for key, value in one.as_dict().items()
    }
    return {**plain, **nested}
