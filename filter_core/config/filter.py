"""Configurations of the filter (`FilterConfig`), and how two of them differ.

`FilterConfig` extends `DecideConfig`, which has the keys that verdicts depend on once
everything is measured; `FilterConfig.measuring` returns the `MeasureConfig`, on which
measured numbers depend. Configurations are frozen and identified by their digest. Their
keys are declared in `keys.py`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple, TypeVar

import numpy as np

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.class_names import canonical_class, class_meant_by
from filter_core.classes import MEASURED_CLASSES, PASS
from filter_core.config.declaration import (
    INHERIT,
    MAX_CLASS_NAME,
    Inherit,
    Number,
    NumberRange,
    refuse_unknown_keys,
)
from filter_core.config.keys import (
    ClassKeys,
    DecidingKeys,
    OnlyClassKeys,
    ReadingKeys,
    keys_of,
)
from filter_core.config.measure import MeasureConfig
from filter_core.errors import ConfigError
from filter_core.evidence_kinds import (
    AUTO,
    CHANNELS,
    SEMANTIC,
    STRONGEST_FIRST,
    ChannelName,
)
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.values import JsonObject, pointer_token, prefix_of, shown, similar
from filter_core.verdicts import Profile


@dataclass(frozen=True, kw_only=True)
class ClassConfig(
    OnlyClassKeys, ClassKeys[Number | Inherit, int | Inherit, Number | Inherit | None]
):
    """The values that a configuration overrides for one class, or `INHERIT`."""

    def __post_init__(self) -> None:
        for name, key in keys_of(ClassConfig).items():
            value = getattr(self, name)
            if value is not INHERIT:
                object.__setattr__(self, name, key.allowed.checked(name, value))

    def as_dict(self) -> dict[str, object]:
        """The overridden keys alone, in canonical form."""
        values = {name: getattr(self, name) for name in keys_of(ClassConfig)}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
            if value is not INHERIT
        }

    @classmethod
    def from_mapping(cls, raw: object, *, at: str = "") -> ClassConfig:
        """One class's overrides, checked; `at` is their JSON pointer.

        Raises `ConfigError`: not a mapping, an unknown key, or a wrong value.
        """
        if not isinstance(raw, Mapping):
            raise ConfigError(
                f"{prefix_of(at)}expected a mapping of keys, found {shown(raw)}",
                pointer=at,
            )
        keys = keys_of(ClassConfig)
        refuse_unknown_keys(raw, keys, at=at)
        make: Callable[..., ClassConfig] = cls
        return make(
            **{name: keys[name].allowed.checked(name, raw[name], at) for name in raw}
        )


_NO_OVERRIDES: Final = ClassConfig()


@dataclass(frozen=True, kw_only=True)
class ClassLimits(ClassKeys[Number, int, Number | None]):
    """The numbers that apply to one class: its own, else those of the configuration.

    Percent, pixels and metres; None is no limit on the distance.
    """

    def __post_init__(self) -> None:
        for name, key in keys_of(ClassKeys).items():
            if getattr(self, name) is INHERIT:
                object.__setattr__(self, name, key.default)


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitsByClass(ClassKeys[FloatArray, IntArray, FloatArray]):
    """The values of `ClassLimits` for each of K classes: every key is a (K,) array.

    Percent and metres are float64, pixels int64; no limit on the distance is ``-inf``
    or ``inf``. A box whose match is exactly the threshold passes under profile
    ``paper`` and fails under ``carlasimu``. A box of exactly `size_big_box` is large
    only under ``carlasimu``. A box that is exactly at any other limit is within it. Of
    a class that is `passed`, the class map says ``pass``: its boxes are not measured.
    """

    profile: Profile
    passed: BoolArray


_IN_EVERY_DIGEST: Final = frozenset(
    {
        *("profile", "threshold_small_box", "size_big_box", "threshold_big_box"),
        *("min_visible_pixels", "min_distance", "max_distance", "evidence"),
        *("projection", "depth_tolerance", "ordered_min_pixels", "lidar_min_points"),
        *("palette", "encoding", "channel_order", "lossy_segmentation", "classes"),
    }
)
"""The keys of the first stored configurations; this set never changes."""


@dataclass(frozen=True, kw_only=True)
class DecideConfig(DecidingKeys, ClassLimits):
    """The keys that verdicts depend on once everything is measured.

    Percent are 0..100, distances metres. Wrong values raise `ConfigError` when the
    object is made, so every `DecideConfig` is valid.
    """

    classes: Mapping[str, ClassConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values: dict[str, object] = {
            name: getattr(self, name) for name in keys_of(type(self))
        }
        # Two defaults depend on other keys: who names a profile has the paper's filter,
        # and only `auto` keeps small remainders that thresholds would have cut.
        if values["evidence"] is INHERIT and values["profile"] is not INHERIT:
            values["evidence"] = SEMANTIC
        if values["min_visible_pixels"] is INHERIT:
            chooses = values["evidence"] not in (INHERIT, AUTO)
            values["min_visible_pixels"] = 1 if chooses else INHERIT
        for name, key in keys_of(type(self)).items():
            # The canonical form of the value: 10.0 becomes 10.
            is_given = values[name] is not INHERIT
            value = key.allowed.checked(name, values[name]) if is_given else key.default
            object.__setattr__(self, name, value)
        object.__setattr__(self, "classes", _canonical_classes(self.classes))
        _refuse_crossed_distances(self, "")
        for name, own in self.classes.items():
            _refuse_crossed_distances(_limits(self, own), name)

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """Its keys in the order in which they are shown, ``classes`` at the end."""
        return (*keys_of(cls), "classes")

    @classmethod
    def from_mapping(cls: type[_Config], raw: object) -> _Config:
        """A configuration from a file or a request; missing keys take their defaults.

        Raises `ConfigError`: unknown key (names the nearest valid one) or wrong value.
        """
        if not isinstance(raw, Mapping):
            raise ConfigError(
                f"expected a mapping of keys, found {shown(raw)}", pointer=""
            )
        refuse_unknown_keys(raw, cls.keys())
        values = dict(raw)
        if values.get("classes") is None:
            values["classes"] = {}
        return cls(**values)

    def as_dict(self) -> dict[str, object]:
        """Every key, defaults filled in, ready for JSON; `from_mapping` inverts it."""
        values = {key: getattr(self, key) for key in keys_of(type(self))}
        # A mapping as JSON has it, which nobody else can change
        plain = {
            key: dict(value) if isinstance(value, Mapping) else value
            for key, value in values.items()
        }
        overrides = {
            name: override.as_dict() for name, override in self.classes.items()
        }
        return {**plain, "classes": overrides}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, as 64 hexadecimal digits.

        A key that is not in `_IN_EVERY_DIGEST` is left out while it has its default, so
        that the digests of configurations that were stored before it do not change.
        Its default must therefore never change either.
        """
        keys = keys_of(type(self))
        hashed = {
            name: value
            for name, value in self.as_dict().items()
            if name in _IN_EVERY_DIGEST or value != keys[name].default
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
        """The overrides that apply to a class; all `INHERIT` if there are none.

        They are those of its own name, completed by those of the class as which it is
        measured: the one that the configuration says, or else that the name means.
        """
        own = self.classes.get(canonical_class(name), _NO_OVERRIDES)
        is_mapped = own.measures_as is not INHERIT
        target = str(own.measures_as) if is_mapped else class_meant_by(name) or name
        other = self.classes.get(target, _NO_OVERRIDES)
        if other is _NO_OVERRIDES or other is own:
            return own
        return ClassConfig(
            **{
                key: getattr(other if getattr(own, key) is INHERIT else own, key)
                for key in keys_of(ClassConfig)
            }
        )

    def limits_of(self, class_name: str) -> ClassLimits:
        """The values for one class: its overrides, and the global values."""
        return _limits_of(self, class_name)

    def limits_by_class(self, class_names: Iterable[str]) -> LimitsByClass:
        """The values for each of K classes, in the order given."""
        return _limits_by_class(self, tuple(class_names))


_Config = TypeVar("_Config", bound=DecideConfig)


@dataclass(frozen=True, kw_only=True)
class FilterConfig(ReadingKeys, DecideConfig):
    """Everything that a verdict depends on, except pixels and boxes.

    In addition to the keys of `DecideConfig`, it has those for reading images and
    projecting 3D boxes.
    """

    # `dataclass` would hash the fields, and `classes` cannot be hashed.
    __hash__ = DecideConfig.__hash__

    def measuring(
        self,
        dataset: SegmentationOptions | None = None,
        *,
        dataset_name: str = "the dataset",
        renamed: Mapping[str, str] | None = None,
        ignored: JsonObject | None = None,
    ) -> MeasureConfig:
        """The settings on which measured numbers depend, completed by the dataset's.

        Parameters
        ----------
        dataset : SegmentationOptions, optional
            The dataset's options for segmentations. Default: it has none.
        dataset_name : str
            The name of the dataset in errors.
        renamed : Mapping of str to str, optional
            The dataset's renamed classes, see `MeasureConfig`.
        ignored : JsonObject, optional
            The dataset's ignored pixels, which never count.

        Raises
        ------
        SegmentationError
            ``segmentation_contradiction``: dataset and configuration differ.
        """
        own = replace(
            SegmentationOptions.named_by(self),
            tags=self.tags,
            tag_scale=1 if self.tag_scale == "auto" else self.tag_scale,
        )
        layers = {
            dataset_name: dataset or SegmentationOptions(),
            "the configuration": own,
        }
        return MeasureConfig(
            profile=self.profile,
            projection=self.projection,
            min_forward=None if self.min_forward is None else float(self.min_forward),
            own_reading=own,
            reading=SegmentationOptions.agreed(layers),
            accept={
                name: override.accept
                for name, override in self.classes.items()
                if override.accept is not INHERIT
            },
            class_map={
                name: override.measures_as
                for name, override in self.classes.items()
                if override.measures_as is not INHERIT
            },
            renamed=renamed or {},
            ignored=ignored,
            channels=tuple(name for name in CHANNELS if name in self.channels),
            depth_tolerance=float(self.depth_tolerance),
            depth_encoding=self.depth_encoding,
        )


def _canonical_classes(raw: object) -> Mapping[str, ClassConfig]:
    if not isinstance(raw, Mapping):
        raise ConfigError(
            f"classes: expected a mapping of class names, found {shown(raw)}",
            pointer="/classes",
        )
    classes: dict[str, ClassConfig] = {}
    for given_name, overrides in raw.items():
        if (
            not isinstance(given_name, str)
            or not 0 < len(given_name) <= MAX_CLASS_NAME
            or not given_name.isprintable()
        ):
            raise ConfigError(
                f"classes: expected a class name of 1 to {MAX_CLASS_NAME} printable "
                f"characters, found {str(given_name)[:60]!r}",
                pointer="/classes",
            )
        name = canonical_class(given_name)
        if name in classes:
            same = (
                repr(spelling) for spelling in raw if canonical_class(spelling) == name
            )
            raise ConfigError(
                f"classes: {' and '.join(same)} name the same class; keep one",
                pointer=f"/classes/{pointer_token(given_name)}",
            )
        at = f"/classes/{pointer_token(given_name)}"
        if isinstance(overrides, str):
            overrides = {"measures_as": overrides}
        if not isinstance(overrides, ClassConfig):
            overrides = ClassConfig.from_mapping(overrides, at=at)
        classes[name] = overrides
    for name, override in classes.items():
        _refuse_unknown_meaning(name, override, classes)
    return MappingProxyType(
        {name: classes[name] for name in sorted(classes) if classes[name].as_dict()}
    )


def _refuse_unknown_meaning(
    name: str, override: ClassConfig, classes: Mapping[str, ClassConfig]
) -> None:
    """Raise if a class is to be measured as something that has no tags."""
    if override.measures_as is INHERIT:
        return
    at = f"/classes/{pointer_token(name)}"
    if override.accept is not INHERIT:
        raise ConfigError(
            f"classes.{name}: expected measures_as or accept, found both; keep one",
            pointer=at,
        )
    other = classes.get(override.measures_as, _NO_OVERRIDES)
    if override.measures_as in (*MEASURED_CLASSES, PASS) or other.accept is not INHERIT:
        return
    close = similar(override.measures_as, (*MEASURED_CLASSES, PASS))
    hint = f"did you mean {close!r}?" if close else f"such as {MEASURED_CLASSES[0]!r}"
    raise ConfigError(
        f"classes.{name}: expected a class that has tags, or {PASS}, found "
        f"{override.measures_as!r}; {hint}",
        pointer=f"{at}/measures_as",
    )


def _refuse_crossed_distances(limits: ClassLimits, class_name: str) -> None:
    """Raise if the nearest distance is beyond the farthest; "" is no class."""
    nearest, farthest = limits.min_distance, limits.max_distance
    if nearest is not None and farthest is not None and nearest > farthest:
        at = f"/classes/{pointer_token(class_name)}" if class_name else ""
        raise ConfigError(
            f"{f'classes.{class_name}: ' if class_name else ''}min_distance: expected "
            f"at most max_distance ({farthest:.15g}), found {nearest:.15g}",
            pointer=f"{at}/min_distance",
        )


_NUMBER_RANGES: Final = {
    name: key.allowed
    for name, key in keys_of(ClassKeys).items()
    if isinstance(key.allowed, NumberRange)
}


def _limits(config: DecideConfig, own: ClassConfig) -> ClassLimits:
    applying = {
        name: getattr(config if getattr(own, name) is INHERIT else own, name)
        for name in keys_of(ClassKeys)
    }
    return ClassLimits(**applying)


# Cached: called for every box, with few distinct results.
@lru_cache(maxsize=1024)
def _limits_of(config: DecideConfig, class_name: str) -> ClassLimits:
    return _limits(config, config.of_class(class_name))


# Cached: called for every frame, mostly with the classes of the frame before.
@lru_cache(maxsize=256)
def _limits_by_class(config: DecideConfig, names: tuple[str, ...]) -> LimitsByClass:
    limits = [config.limits_of(name) for name in names]
    arrays = {
        name: allowed.array([getattr(class_limits, name) for class_limits in limits])
        for name, allowed in _NUMBER_RANGES.items()
    }
    passed = np.array([config.of_class(name).measures_as == PASS for name in names])
    make: Callable[..., LimitsByClass] = LimitsByClass
    return make(**arrays, profile=config.profile, passed=passed.astype(np.bool_))


def schema_of(config_class: type[DecideConfig]) -> dict[str, object]:
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
        "propertyNames": {"minLength": 1, "maxLength": MAX_CLASS_NAME},
        "additionalProperties": {
            "anyOf": [
                keys_of(ClassConfig)["measures_as"].allowed.schema(),
                object_schema(
                    {name: key.schema() for name, key in keys_of(ClassConfig).items()}
                ),
            ]
        },
        "default": {},
    }
    return {
        "title": config_class.__name__,
        "description": "What verdicts depend on; every key is optional.",
        **object_schema(properties),
    }


def object_schema(properties: Mapping[str, object]) -> dict[str, object]:
    """The JSON schema of a mapping with these keys and no others."""
    return {"type": "object", "properties": properties, "additionalProperties": False}


class ConfigChange(NamedTuple):
    """One key in which two configurations differ, such as ``classes.van.accept``."""

    key: str
    before: object
    after: object


def diff_configs(before: FilterConfig, after: FilterConfig) -> list[ConfigChange]:
    """The keys in which two configurations differ, in the order of the keys.

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
    plain = {key: getattr(config, key) for key in keys_of(FilterConfig)}
    nested = {
        f"classes.{name}.{key}": value
        for name, override in config.classes.items()
        for key, value in override.as_dict().items()
    }
    return {**plain, **nested}
