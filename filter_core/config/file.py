"""Reading configuration files: our own keys, or carlasimu's boundingBox.yaml.

carlasimu is the code that the paper's authors published; its file is read as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from types import MappingProxyType
from typing import Final, Protocol

import yaml

from filter_core.class_names import canonical_class
from filter_core.classes import MEASURED_CLASSES, PASS
from filter_core.config.filter import FilterConfig
from filter_core.errors import ConfigError, JsonError
from filter_core.json_text import JsonLimits, read_json, repeated_key
from filter_core.values import JsonObject, escape_text, shown

_MAX_CHARACTERS: Final = 64 * 1024

_MAX_DEPTH: Final = 16

_MAX_VALUES: Final = 10_000
"""More would take seconds: YAML is read by Python code, character by character."""

_JSON_LIMITS: Final = JsonLimits(
    max_depth=_MAX_DEPTH, max_values=_MAX_VALUES, max_keys=_MAX_VALUES
)

_MAX_KEY: Final = 1000

_MAX_DIGITS: Final = 1000

_MAX_UNUSED: Final = 100

_WHOLE_NUMBER: Final = "tag:yaml.org,2002:int"

_TEXT: Final = "tag:yaml.org,2002:str"

_SHOWN_KEY: Final = 80

_SHOWN_KEYS: Final = 5

CARLASIMU_ROOT: Final = "sitting"
"""The one key at the top of each of carlasimu's files; its authors named it so."""

_BY_PATH: Final = {
    f"{CARLASIMU_ROOT}.threshold_small_box": "threshold_small_box",
    f"{CARLASIMU_ROOT}.size_big_box": "size_big_box",
    f"{CARLASIMU_ROOT}.threshold_big_box": "threshold_big_box",
    f"{CARLASIMU_ROOT}.cam_rgb.min_distance": "min_forward",
    f"{CARLASIMU_ROOT}.cam_rgb.filter": "classes",
}
"""Our keys, by their paths in carlasimu's file.

Its ``min_distance`` is not a distance from the camera, but forward along its axis; its
``max_distance`` only limits what it draws. ``filter: False`` leaves every class as it
is (`_UNFILTERED`).
"""

_UNFILTERED: Final = dict.fromkeys(MEASURED_CLASSES, PASS)


@dataclass(frozen=True)
class LoadedConfig:
    """A configuration as it was read from a file.

    `keys` are those that were given, of carlasimu's file by our names; `unused_keys`
    those of its file that it does not use.
    """

    config: FilterConfig
    unused_keys: tuple[str, ...] = ()
    keys: Mapping[str, object] = field(default_factory=dict)

    def after(self, active: FilterConfig) -> FilterConfig:
        """The configuration of a dataset that has had another one, `active`.

        A file that names neither evidence nor a profile leaves the dataset's evidence
        as it is.
        """
        if not self.keys.keys().isdisjoint(("evidence", "profile")):
            return self.config
        return FilterConfig.from_mapping({**self.keys, "evidence": active.evidence})


def load_config(
    source: str | bytes | Mapping[str, object],
    *,
    below: Mapping[str, object] = MappingProxyType({}),
) -> LoadedConfig:
    """The configuration that a YAML or JSON text, or a mapping, describes.

    Its `unused_keys` are those that concern only the capture, such as
    ``sitting.cam_rgb.3D``: the first 100, long ones cut off.

    Parameters
    ----------
    source : str, bytes (UTF-8) or mapping
        Our own keys (`FilterConfig`), every one optional; or the paper's published
        ``boundingBox.yaml`` (root key ``sitting``), which gives profile ``carlasimu``
        with its projection.
    below : mapping, optional
        Values of keys that `source` does not have; of ``classes``, entries of classes
        that it does not have.

    Raises
    ------
    ConfigError
        As `parse_yaml`, or as `FilterConfig.from_mapping`; or another of carlasimu's
        files, which has none of our keys.
    NotAvailable
        As `FilterConfig.from_mapping`.
    """
    raw = source if isinstance(source, Mapping) else parse_yaml(source)
    if raw is None:  # an empty file: every key is optional
        raw = {}
    if isinstance(raw, Mapping) and CARLASIMU_ROOT in raw:
        return _from_carlasimu(raw, below)
    if not isinstance(raw, Mapping):
        return LoadedConfig(FilterConfig.from_mapping(raw))
    keys = merged_keys(below, raw)
    return LoadedConfig(FilterConfig.from_mapping(keys), keys=keys)


def merged_keys(below: Mapping[str, object], above: Mapping[str, object]) -> JsonObject:
    """The keys of two configurations; those of `above` win, class by class."""
    classes, given_classes = below.get("classes"), above.get("classes") or {}
    if not isinstance(classes, Mapping) or not isinstance(given_classes, Mapping):
        return {**below, **above}
    merged = merged_classes(classes, given_classes)
    return {**below, **above, "classes": merged}


def merged_classes(
    below: Mapping[str, object], above: Mapping[str, object]
) -> dict[str, object]:
    """The entries of two mappings by class; those `above` win, under any alias."""
    taken = set(map(canonical_class, map(str, above)))
    kept = {k: v for k, v in below.items() if canonical_class(str(k)) not in taken}
    return {**kept, **above}


def parse_yaml(text: str | bytes) -> object:
    """Plain values from untrusted YAML or JSON.

    Raises `ConfigError`: not YAML, a key twice, an alias (a few bytes of them can stand
    for gigabytes), text that UTF-8 cannot encode, more than 64 Ki characters, more than
    10,000 values, or nested too deeply.
    """
    if len(text) > _MAX_CHARACTERS:
        raise ConfigError(
            f"expected at most {_MAX_CHARACTERS} characters of YAML, found {len(text)}",
            code="config_too_large",
        )
    try:
        # Decoded here, since PyYAML would take bytes with a UTF-16 mark as UTF-16.
        plain = text.decode("utf-8-sig") if isinstance(text, bytes) else text
        if plain.lstrip().startswith("{"):
            # JSON first: YAML would refuse its tabs and read 1e1 as text.
            with suppress(JsonError):
                return read_json(plain, _JSON_LIMITS, object_pairs_hook=_unique)
        return _StrictLoader(plain).get_single_data()
    except ConfigError:
        raise
    except yaml.MarkedYAMLError as exc:
        place = _place(exc.problem_mark)
        raise ConfigError(f"{place}{exc.problem}", code="bad_yaml") from exc
    except UnicodeDecodeError as exc:
        raise ConfigError(
            f"expected YAML in UTF-8, found other bytes at offset {exc.start}",
            code="bad_yaml",
        ) from exc
    except yaml.YAMLError as exc:
        raise ConfigError(f"not readable as YAML: {exc}", code="bad_yaml") from exc
    except (ArithmeticError, ValueError, LookupError, AttributeError) as exc:
        # What PyYAML raises for an impossible date, a number of a million digits, hours
        # and minutes (1:30:00) beyond the largest float, and for explicit tags on
        # values that do not fit: `!!int _`, `!!bool x`, `!!timestamp x`.
        raise ConfigError(f"a value cannot be read: {exc}", code="bad_yaml") from exc


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    if (key := repeated_key(pairs)) is not None:
        raise ConfigError(f"the key {key[:60]!r} is given twice", code="bad_yaml")
    return dict(pairs)


class _StrictLoader(yaml.SafeLoader):
    """A SafeLoader without aliases, without merging, and with unique keys."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._values = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]  # stubs
        if isinstance(event, yaml.AliasEvent):
            raise _refused("aliases are not allowed", event)
        self._depth += 1
        self._values += 1
        if self._depth > _MAX_DEPTH:
            raise _refused("nested too deeply", event)
        if self._values > _MAX_VALUES:
            raise _refused(f"more than {_MAX_VALUES} values", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            node.value = [(_color_as_text(key), value) for key, value in node.value]
            _refuse_bad_keys(node)
        if isinstance(node, yaml.ScalarNode) and escape_text(node.value) != node.value:
            raise _refused("half of a surrogate pair is not text", node)
        return node


def _whole_number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    # Python cannot print integers of thousands of digits, but text in base 16 or 60
    # (1:30:00) becomes such an integer without an error.
    if len(node.value) > _MAX_DIGITS:
        raise _refused("a number has too many digits", node)
    number: int = loader.construct_yaml_int(node)
    return number


_StrictLoader.add_constructor(_WHOLE_NUMBER, _whole_number)


_CHANNELS: Final = 3


def _color_as_text(key: yaml.Node) -> yaml.Node:
    """A key ``[220, 20, 60]`` as text, since a list can be no key; others as they are.

    A colour of a changed CARLA may be written so (`canonical_tags`).
    """
    if not isinstance(key, yaml.SequenceNode) or len(key.value) != _CHANNELS:
        return key
    if not all(node.tag == _WHOLE_NUMBER for node in key.value):
        return key
    text = ", ".join(node.value for node in key.value)
    return yaml.ScalarNode(_TEXT, f"[{text}]", key.start_mark, key.end_mark)


def _refuse_bad_keys(node: yaml.MappingNode) -> None:
    seen: set[str] = set()
    for key, _value in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag.endswith(":merge"):
            raise _refused("a key must be plain text or a number", key)
        if len(key.value) > _MAX_KEY:
            raise _refused(f"a key has more than {_MAX_KEY} characters", key)
        if key.value in seen:
            raise _refused(f"the key {key.value[:60]!r} is given twice", key)
        seen.add(key.value)


def _refused(problem: str, at: yaml.Event | yaml.Node) -> ConfigError:
    return ConfigError(f"{_place(at.start_mark)}{problem}", code="bad_yaml")


def _place(mark: _Mark | None) -> str:
    return f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""


class _Mark(Protocol):
    line: int
    column: int


def _from_carlasimu(
    raw: Mapping[str, object], below: Mapping[str, object]
) -> LoadedConfig:
    others = [str(key) for key in raw if key != CARLASIMU_ROOT]
    content = raw[CARLASIMU_ROOT]
    if others or not isinstance(content, Mapping):
        raise ConfigError(
            f"expected one root key {CARLASIMU_ROOT!r} with keys below it, as in "
            f"carlasimu's boundingBox.yaml, found {', '.join(map(repr, raw))}"[:300],
            pointer="" if others else f"/{CARLASIMU_ROOT}",
        )
    own = _our_keys(raw)
    if not own:
        # The error about another of carlasimu's files, such as its ``data.yaml``
        *first, last = _BY_PATH
        leaf_paths = list(islice(_leaf_paths(content, CARLASIMU_ROOT), _SHOWN_KEYS + 1))
        more = " and others" if len(leaf_paths) > _SHOWN_KEYS else ""
        raise ConfigError(
            "expected a key of carlasimu's boundingBox.yaml that the filter uses "
            f"({', '.join(first)} or {last}), "
            f"found {', '.join(leaf_paths[:_SHOWN_KEYS]) or 'no key'}{more}",
            pointer=f"/{CARLASIMU_ROOT}",
        )
    published = {"profile": "carlasimu", "projection": "naive"}
    keys = merged_keys(below, {**published, **own})
    paths = _leaf_paths(content, CARLASIMU_ROOT)
    unused = islice((path for path in paths if path not in _BY_PATH), _MAX_UNUSED)
    return LoadedConfig(FilterConfig.from_mapping(keys), tuple(unused), keys)


def _our_keys(raw: Mapping[str, object]) -> dict[str, object]:
    """The values that carlasimu's file has for our keys."""
    values = {}
    for path, name in _BY_PATH.items():
        *sections, last = path.split(".")
        section: object = raw
        for key in sections:
            section = section.get(key) if isinstance(section, Mapping) else None
        if isinstance(section, Mapping) and last in section:
            values[name] = section[last]
    if "classes" in values:
        is_filtering = values.pop("classes")
        if not isinstance(is_filtering, bool):
            raise ConfigError(
                f"expected true or false, found {shown(is_filtering)}",
                pointer=f"/{CARLASIMU_ROOT}/cam_rgb/filter",
            )
        if not is_filtering:
            values["classes"] = _UNFILTERED
    return values


def _leaf_paths(section: Mapping[object, object], prefix: str) -> Iterator[str]:
    for key, value in section.items():
        path = f"{prefix}.{str(key)[:_SHOWN_KEY]}"
        if isinstance(value, Mapping) and value:
            yield from _leaf_paths(value, path)
        else:
            yield path
