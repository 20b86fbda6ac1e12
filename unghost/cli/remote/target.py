"""The dataset that a command sends frames to: created, or checked and completed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from unghost.cli.options import error_context
from unghost.cli.screen import Refused, Screen, naming_options, one_line, refused_on

if TYPE_CHECKING:
    from filter_core.config.file import LoadedConfig
    from filter_core.config.filter import ConfigChange, FilterConfig
    from unghost.client.client import Client
    from unghost.wire.datasets import Dataset

_LISTED_KEYS: Final = 5
"""Keys in which a configuration differs that are listed."""
_UNSET: Final = "auto"
"""The value of a dataset's option that nobody named."""
_OPTION_OF_FIELD: Final = {"/name": "--dataset", "/classes": "classes (--classes)"}


@dataclass(frozen=True)
class GivenConfig:
    """A configuration that a command was given for a dataset.

    `file` was checked. `keys` are those of the recording's description, under `classes`
    those of classes; keys of the file have priority. `loaded` is the file with these
    keys below its own; None without a file.
    """

    file: Path | None = None
    keys: Mapping[str, object] = field(default_factory=dict)
    loaded: LoadedConfig | None = None

    @classmethod
    def of(cls, file: Path | None, keys: Mapping[str, object]) -> GivenConfig:
        """The configuration of a file, if there is one, and of other keys.

        Raises `Refused`: the file, or the description, has a key or a value that is
        wrong.
        """
        from filter_core.config.file import load_config

        with error_context(file):
            content = b"" if file is None else file.read_bytes()
            loaded = load_config(content, below=keys)
        return cls(file, keys, None if file is None else loaded)

    @property
    def whole(self) -> Mapping[str, object] | None:
        """All keys of the file and the others; None without a file."""
        return None if self.loaded is None else self.loaded.config.as_dict()

    def over(self, active: Mapping[str, object]) -> dict[str, object]:
        """All keys of a dataset whose active configuration has these."""
        from filter_core.config.file import merged_keys
        from filter_core.config.filter import FilterConfig

        if self.loaded is None:
            return dict(merged_keys(active, self.keys))
        return self.loaded.after(FilterConfig.from_mapping(active)).as_dict()

    def refusal(self, dataset: str, changes: Sequence[ConfigChange]) -> str:
        """Why it cannot be that of a dataset with frames, and what can be done."""
        keys = [
            f"{change.key}: {_as_json(change.before)} -> {_as_json(change.after)}"
            for change in changes
        ]
        listed = ", ".join(keys[:_LISTED_KEYS])
        more = len(keys) - _LISTED_KEYS
        differs = f"{listed} and {more} more" if more > 0 else listed
        if self.file is None:
            return (
                f"dataset {dataset!r} has frames, and its configuration differs from "
                f"the description of the recording ({differs}); put these keys into a "
                f"file with what `unghost config show {dataset}` prints, and apply it "
                f"to every frame with `unghost config set {dataset} FILE`"
            )
        return (
            f"dataset {dataset!r} has frames, and another configuration than "
            f"{self.file} ({differs}); `unghost config set {dataset} {self.file}` "
            "applies the file to every frame, and `unghost config diff "
            f"{dataset} --config {self.file}` counts which verdicts that changes"
        )


def _as_json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


Settings: TypeAlias = Mapping[str, Any]
"""Settings of a dataset by their names, as `DatasetChanges` has them."""


@dataclass(frozen=True)
class NewDataset:
    """What a dataset gets that does not exist, or has no frames.

    `options` say how its segmentations are read, and `shown` what those show about it;
    its own options win. `classes` and `recording`, how its folder is read, are for one
    that does not exist; without classes it has those of CARLA.
    """

    options: Settings = field(default_factory=dict)
    classes: Sequence[str] = ()
    config: GivenConfig = field(default_factory=GivenConfig)
    shown: Settings = field(default_factory=dict)
    recording: Mapping[str, object] | None = None


def ensure_dataset(
    client: Client, name: str, new: NewDataset, screen: Screen
) -> Dataset:
    """The dataset, created if it does not exist.

    One without frames gets the options and the configuration.

    Raises `Refused`: it has other options or another configuration, and has frames or
    cannot get them; or it cannot have this name or these classes.
    """
    from unghost.client.errors import Conflict, NotFound

    options = new.options

    try:
        dataset = client.dataset(name)
    except NotFound:
        try:
            with naming_options(_OPTION_OF_FIELD, {"--dataset": name}):
                dataset = client.create_dataset(
                    name,
                    classes=list(new.classes) or None,
                    config=new.config.whole,
                    recording=new.recording,
                    **{**new.shown, **options},
                )
        except Conflict as taken:
            # Another push has just made it, or one like it in upper and lower case.
            with refused_on(NotFound, text=f"--dataset {name}: {taken}"):
                dataset = client.dataset(name)
    others = {
        option: value
        for option, value in options.items()
        if getattr(dataset, option) != value
    }
    unset = {
        option: value
        for option, value in new.shown.items()
        if option not in options and getattr(dataset, option) == _UNSET
    }
    if dataset.counts.frames == 0:
        others |= unset
    elif unset:
        listed = " and ".join(f"{name} {value}" for name, value in unset.items())
        screen.note(
            f"dataset {name!r} has frames, and its settings do not name {listed}: each "
            "segmentation is read by itself"
        )
    if others and dataset.counts.frames == 0:
        dataset = _changed(client, dataset, others, screen)
    for option, value in others.items():
        there = getattr(dataset, option)
        if there != value:
            raise Refused(
                f"dataset {name!r} has {option} {there!r}, not {value!r}; leave "
                f"--{option.replace('_', '-')} out, or change the dataset, which "
                f"measures every frame again: `unghost dataset edit {name} "
                f"--{option.replace('_', '-')} {value}`"
            )
    _ensure_config(client, dataset, new.config, screen)
    return dataset


def coming_config(
    client: Client, dataset: str, chosen: GivenConfig, options: Mapping[str, str]
) -> tuple[FilterConfig, Mapping[str, str]]:
    """The configuration that a dataset will have if it can get the given one.

    It has the dataset's own options, too, and those that are given. And its renamed
    classes, see `wire.Dataset`.
    """
    from filter_core.config.filter import FilterConfig
    from unghost.client.errors import NotFound

    try:
        active = client.active_config(dataset).config
        stored = client.dataset(dataset)
    except NotFound:
        active = FilterConfig().as_dict()
        return FilterConfig.from_mapping({**chosen.over(active), **options}), {}
    own = {name: getattr(stored, name) for name in ("palette", "channel_order")}
    named = {name: value for name, value in own.items() if value != _UNSET}
    keys = {**chosen.over(active), **named, **options}
    return FilterConfig.from_mapping(keys), stored.renamed_classes


def _ensure_config(
    client: Client, dataset: Dataset, chosen: GivenConfig, screen: Screen
) -> None:
    """Give a dataset without frames the configuration, unless it has it."""
    from filter_core.config.filter import FilterConfig, diff_configs

    if chosen.whole is None and not chosen.keys:
        return
    active = client.active_config(dataset.name).config
    config = FilterConfig.from_mapping(chosen.over(active))
    changes = diff_configs(FilterConfig.from_mapping(active), config)
    if not changes:
        return
    if dataset.counts.frames:
        raise Refused(one_line(chosen.refusal(dataset.name, changes)))
    version = client.add_config(dataset.name, config.as_dict())
    client.wait(client.set_config(dataset.name, version.digest))
    screen.note(
        f"configuration of {dataset.name}, which had no frames: {version.digest[:12]}"
    )


def _changed(
    client: Client, dataset: Dataset, options: Settings, screen: Screen
) -> Dataset:
    """The dataset as it is after a change of options and the run that this needs."""
    from unghost.client.errors import Conflict, RunFailed
    from unghost.wire.runs import Run

    try:
        changed = client.change_dataset(dataset.name, **options)
        if isinstance(changed, Run):
            client.wait(changed)
    except (Conflict, RunFailed) as error:
        raise Refused(
            f"{', '.join(options)} of dataset {dataset.name!r} cannot be changed: "
            f"{error}"
        ) from error
    for option, value in options.items():
        screen.note(
            f"{option} of {dataset.name}, which had no frames: "
            f"{getattr(dataset, option)!r} -> {value!r}"
        )
    return client.dataset(dataset.name)
