"""Filter configurations: immutable versions, and which one is active."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from unghost.calls.base import Calls, dataset_path
from unghost.transport import API, Call
from unghost.work_results import ConfigVersion, Run


class ConfigCalls(Calls):
    """Methods on configurations."""

    def configs(self, dataset: str) -> Iterator[ConfigVersion]:
        """Every version of a dataset's configuration, newest first."""
        return self._all(ConfigVersion, dataset_path(dataset, "configs"))

    def add_config(
        self, dataset: str, config: Mapping[str, Any] | str
    ) -> ConfigVersion:
        """Store a version: a mapping, or the text of a YAML file as it is."""
        path = dataset_path(dataset, "configs")
        if isinstance(config, str):
            yaml = {"Content-Type": "application/yaml"}
            call = Call("POST", path, content=config.encode(), headers=yaml)
        else:
            call = Call("POST", path, json=config)
        return self._call(ConfigVersion, call)

    def config(self, digest: str) -> ConfigVersion:
        """One version by its digest."""
        return self._get(ConfigVersion, f"{API}/configs/{digest}")

    def active_config(self, dataset: str) -> ConfigVersion:
        """The version that decides now."""
        return self._get(ConfigVersion, dataset_path(dataset, "config"))

    def set_config(self, dataset: str, digest: str) -> Run:
        """Activate a version; the run that applies it is returned at once."""
        path = dataset_path(dataset, "config")
        return self._call(Run, Call("PUT", path, json={"digest": digest}))
