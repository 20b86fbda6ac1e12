"""Filter configurations of a dataset: immutable versions, one of them active."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from sqlalchemy.orm import Session

from app.db import tables
from app.db.tables import Dataset
from app.repositories.runs import ConfigRepository
from filter_core.config.filter import FilterConfig
from unghost.wire.runs import ConfigVersion


def add_version(
    session: Session,
    dataset: Dataset,
    config: FilterConfig,
    *,
    author: str,
    unused_keys: Sequence[str] = (),
) -> tuple[tables.ConfigVersion, bool]:
    """The version with this content, and whether it is new."""
    configs = ConfigRepository(session)
    known = configs.find(dataset.id, config.digest)
    if known is not None:
        return known, False
    version = tables.ConfigVersion(
        dataset_id=dataset.id,
        digest=config.digest,
        body=config.as_dict(),
        unused_keys=list(unused_keys),
        created_by=author,
    )
    return configs.add(version), True


def active_version(session: Session, dataset: Dataset) -> tables.ConfigVersion:
    """The version whose verdicts are current."""
    if dataset.active_config_id is None:
        raise RuntimeError(f"dataset {dataset.name!r} has no active config")
    return ConfigRepository(session).with_id(dataset.active_config_id)


def config_of(version: tables.ConfigVersion) -> FilterConfig:
    """A version as the filter takes it; parsed once per process."""
    return _parsed(version.digest, _Body(version.body))


def describe_version(dataset: Dataset, version: tables.ConfigVersion) -> ConfigVersion:
    """A version as it is answered."""
    return ConfigVersion(
        digest=version.digest,
        config=version.body,
        unused_keys=tuple(version.unused_keys),
        created_by=version.created_by,
        created_at=version.created_at,
        active=version.id == dataset.active_config_id,
    )


class _Body:
    """A config's body that the cache ignores: the digest already names it."""

    def __init__(self, body: Mapping[str, Any]) -> None:
        self.body = body

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Body)


@lru_cache(maxsize=256)
def _parsed(_digest: str, body: _Body) -> FilterConfig:
    return FilterConfig.from_mapping(body.body)
