"""In which keys two configurations differ."""

from __future__ import annotations

from dataclasses import dataclass

from filter_core.config.filter import CONFIG_KEYS, INHERIT, FilterConfig


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
