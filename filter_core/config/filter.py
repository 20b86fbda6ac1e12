"""A configuration of the filter, and in which keys two of them differ.

`FilterConfig` is a frozen value that names itself by its digest. The part of it that
decides is a `DecideConfig`; the part that measures is made by `FilterConfig.measuring`.
Each key is declared once, with its default, as a field of one of the two.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, Final, TypeVar

import numpy as np

from filter_core.classes import canonical_accept, canonical_class
from filter_core.config.keys import (
    AUTO,
    CHANNELS,
    CHOICES,
    NUMBERS,
    SEMANTIC,
    STRONGEST_FIRST,
    Number,
    checked_choice,
    checked_number,
    refuse_unknown_keys,
)
from filter_core.config.measure import MeasureConfig
from filter_core.errors import ConfigError
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.types import FloatArray, IntArray
from filter_core.values import place_of, pointer_token, shown


class Inherit(Enum):
    """Stands for a key that a class does not override; null would be a value."""

    GLOBAL = "global"


INHERIT: Final = Inherit.GLOBAL


@dataclass(frozen=True, kw_only=True)
class ClassConfig:
    """What one class does differently; `INHERIT` where it does not.

    `accept` is the set of tags whose pixels count for the class, by name or number.
    """

    threshold_small_box: Number | Inherit = INHERIT
    size_big_box: Number | Inherit = INHERIT
    threshold_big_box: Number | Inherit = INHERIT
    min_visible_pixels: int | Inherit = INHERIT
    min_distance: Number | Inherit | None = INHERIT
    max_distance: Number | Inherit | None = INHERIT
    accept: tuple[str | int, ...] | Inherit = INHERIT

    def __post_init__(self) -> None:
        for key in CLASS_KEYS:
            value = getattr(self, key)
            if value is not INHERIT:
                object.__setattr__(self, key, _checked_override(key, value))

    def as_dict(self) -> dict[str, object]:
        """Only what is overridden, in canonical form."""
        given = {name: getattr(self, name) for name in CLASS_KEYS}
        return {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in given.items()
            if value is not INHERIT
        }

    @classmethod
    def from_mapping(cls, raw: object, *, at: str = "") -> ClassConfig:
        """Validate one class's overrides; `at` is their JSON pointer."""
        if not isinstance(raw, Mapping):
            raise ConfigError(
                f"{place_of(at)}expected a mapping of keys, found {shown(raw)}",
                pointer=at,
            )
        refuse_unknown_keys(raw, CLASS_KEYS, at=at)
        values: dict[str, Any] = {
            key: _checked_override(key, raw[key], at=at) for key in raw
        }
        return cls(**values)


def _checked_override(key: str, value: object, *, at: str = "") -> object:
    if key == "accept":
        return canonical_accept(value, at=f"{at}/accept")
    return checked_number(key, value, at=at)


CLASS_KEYS: Final = tuple(spec.name for spec in fields(ClassConfig))


@dataclass(frozen=True)
class Thresholds:
    """The numbers that apply to each of K classes.

    Every attribute is a (K,) array: percent, pixels (int64) or metres, all inclusive.
    No limit on the distance is ``-inf`` and ``inf``.
    """

    threshold_small_box: FloatArray
    size_big_box: FloatArray
    threshold_big_box: FloatArray
    min_visible_pixels: IntArray
    min_distance: FloatArray
    max_distance: FloatArray


CONFIG_KEYS: Final = (
    "profile",
    "threshold_small_box",
    "size_big_box",
    "threshold_big_box",
    "min_visible_pixels",
    "min_distance",
    "max_distance",
    "evidence",
    "projection",
    "depth_tolerance",
    "ordered_min_pixels",
    "lidar_min_points",
    "palette",
    "encoding",
    "channel_order",
    "lossy_segmentation",
    "classes",
)
"""All keys of a configuration, in the order in which they are shown."""


@dataclass(frozen=True, kw_only=True)
class DecideConfig:
    """What verdicts depend on once everything is measured: no key here needs a pixel.

    Percent are 0..100, distances metres. Wrong values raise `ConfigError` at once, so
    that a configuration that exists can be used.
    """

    profile: str = "paper"
    threshold_small_box: Number = 10
    size_big_box: Number = 70
    threshold_big_box: Number = 50
    min_visible_pixels: int = 1
    min_distance: Number | None = None
    max_distance: Number | None = None
    evidence: str = "semantic"
    depth_tolerance: Number = 0.15
    ordered_min_pixels: int = 3
    lidar_min_points: int = 5
    classes: Mapping[str, ClassConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own = self.keys()
        for key in CHOICES:
            if key in own:
                checked_choice(key, getattr(self, key))
        for key in NUMBERS:
            # Frozen for everyone else; here 10.0 becomes 10 before anyone looks.
            object.__setattr__(self, key, checked_number(key, getattr(self, key)))
        object.__setattr__(self, "classes", _canonical_classes(self.classes))
        self._refuse_crossed_distances()

    def _refuse_crossed_distances(self) -> None:
        names = (None, *self.classes)
        limits = self.thresholds_for([name or "" for name in names])
        crossed = limits.min_distance > limits.max_distance
        if crossed.any():
            index = int(np.argmax(crossed))
            at = f"/classes/{pointer_token(names[index])}" if names[index] else ""
            raise ConfigError(
                f"{'classes.' + str(names[index]) + ': ' if at else ''}min_distance: "
                f"expected at most max_distance ({limits.max_distance[index]:.15g}), "
                f"found {limits.min_distance[index]:.15g}",
                pointer=f"{at}/min_distance",
            )

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """The keys of this configuration, in the order of `CONFIG_KEYS`."""
        own = {spec.name for spec in fields(cls)}
        return tuple(key for key in CONFIG_KEYS if key in own)

    @classmethod
    def from_mapping(cls: type[_Config], raw: object) -> _Config:
        """A configuration from what a file or a request holds; absent keys default.

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
        plain = {key: getattr(self, key) for key in self.keys() if key != "classes"}
        overrides = {name: one.as_dict() for name, one in self.classes.items()}
        return {**plain, "classes": overrides}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, as 64 hexadecimal digits."""
        canonical = json.dumps(
            self.as_dict(), sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        return hashlib.sha256(canonical.encode()).hexdigest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[object, tuple[dict[str, object]]]:
        # A read-only mapping cannot be pickled; worker processes get the plain form.
        return type(self).from_mapping, (self.as_dict(),)

    @property
    def channels(self) -> tuple[str, ...]:
        """What it decides by beside the segmentation; the first that has a number."""
        if self.evidence == SEMANTIC:
            return ()
        return STRONGEST_FIRST if self.evidence == AUTO else (self.evidence,)

    def of_class(self, name: str) -> ClassConfig:
        """The overrides of a class, aliases understood; none if it has none."""
        return self.classes.get(canonical_class(name), _NO_OVERRIDES)

    def limit_of(self, class_name: str, key: str) -> Number | None:
        """One number as it applies to a class: its own, or the one for all."""
        return _limit_of(self, class_name, key)

    def thresholds_for(self, class_names: Iterable[str]) -> Thresholds:
        """The numbers that apply to each class, in the order given."""
        return _thresholds_for(self, tuple(class_names))


_Config = TypeVar("_Config", bound=DecideConfig)


@dataclass(frozen=True, kw_only=True)
class FilterConfig(DecideConfig):
    """Everything a verdict depends on besides pixels. Change one: another config.

    To the keys that decide it adds those that say how pixels are read; `measuring` is
    the part of it that measured numbers depend on.
    """

    projection: str = "clipped"
    palette: str = "auto"
    encoding: str = "auto"
    channel_order: str = "auto"
    lossy_segmentation: str = "refuse"

    # A dataclass that compares its fields would hash them, and `classes` has no hash.
    __hash__ = DecideConfig.__hash__

    def measuring(
        self,
        reading: SegmentationOptions | None = None,
        *,
        ignored: object = None,
    ) -> MeasureConfig:
        """The part of it that measured numbers depend on.

        Parameters
        ----------
        reading : SegmentationOptions, optional
            What this configuration and a dataset say together
            (`SegmentationOptions.agreed`); without a dataset, what this one says.
        ignored : object, optional
            Pixels of the dataset that never count, as JSON.
        """
        own = SegmentationOptions.named_by(self)
        return MeasureConfig(
            profile=self.profile,
            projection=self.projection,
            own_reading=own,
            reading=own if reading is None else reading,
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


# Looked up several times for each of a million boxes; a handful of answers.
@lru_cache(maxsize=4096)
def _limit_of(config: DecideConfig, class_name: str, key: str) -> Number | None:
    own: Number | Inherit | None = getattr(config.of_class(class_name), key)
    applies: Number | None = getattr(config, key) if own is INHERIT else own
    return applies


# Asked for every frame, of the same classes as the frame before.
@lru_cache(maxsize=256)
def _thresholds_for(config: DecideConfig, names: tuple[str, ...]) -> Thresholds:
    def column(key: str, absent: float = np.nan) -> FloatArray:
        values = [config.limit_of(name, key) for name in names]
        limits = np.array([absent if v is None else v for v in values], np.float64)
        limits.setflags(write=False)
        return limits

    return Thresholds(
        threshold_small_box=column("threshold_small_box"),
        size_big_box=column("size_big_box"),
        threshold_big_box=column("threshold_big_box"),
        min_visible_pixels=column("min_visible_pixels").astype(np.int64),
        min_distance=column("min_distance", -np.inf),
        max_distance=column("max_distance", np.inf),
    )


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


@dataclass(frozen=True)
class ConfigChange:
    """One key in which two configurations differ; `classes.van.accept` if nested."""

    key: str
    before: object
    after: object


def diff_configs(before: FilterConfig, after: FilterConfig) -> list[ConfigChange]:
    """Every key whose value differs, in the order of the keys.

    An override that only one of them has is shown as None on the other side.
    """
    old, new = _flat(before), _flat(after)
    keys = list(dict.fromkeys([*old, *new]))
    return [
        ConfigChange(key, old.get(key), new.get(key))
        for key in keys
        if old.get(key, INHERIT) != new.get(key, INHERIT)
    ]


def _flat(config: FilterConfig) -> dict[str, object]:
    plain = {key: getattr(config, key) for key in CONFIG_KEYS if key != "classes"}
    nested = {
        f"classes.{name}.{key}": value
        for name, one in config.classes.items()
        for key, value in one.as_dict().items()
    }
    return {**plain, **nested}
