"""What the server says about configs, runs, exports and whole datasets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, TypeAlias

from unghost.reading import Result
from unghost.results import Counts, Verdict

State: TypeAlias = Literal["queued", "running", "done", "failed", "cancelled"]
FINISHED: frozenset[str] = frozenset({"done", "failed", "cancelled"})


@dataclass(frozen=True, kw_only=True)
class ConfigVersion(Result):
    """An immutable filter configuration, known by its digest."""

    digest: str
    config: Mapping[str, Any] = field(default_factory=dict)
    name: str | None = None
    unused_keys: tuple[str, ...] = ()
    created_by: str | None = None
    created_at: datetime | None = None
    active: bool = False


@dataclass(frozen=True, kw_only=True)
class Run(Result):
    """One config applied to a dataset: how far it is and what came out."""

    id: int
    state: State
    dataset: str | None = None
    kind: str | None = None
    config: str | None = None
    activate: bool = False
    total: int | None = None
    done: int = 0
    changed: int | None = None
    counts: Counts | None = None
    error: Mapping[str, Any] | None = None
    created_by: str | None = None
    created_at: datetime | None = None
    started_at: datetime | None = None
    finished_at: datetime | None = None

    @property
    def finished(self) -> bool:
        """Nothing more will happen to it."""
        return self.state in FINISHED


@dataclass(frozen=True, kw_only=True)
class Stats(Result):
    """Counts of a whole dataset, by reason and by class."""

    frames: int = 0
    boxes: int = 0
    kept: int = 0
    rejected: int = 0
    unmeasured: int = 0
    reviewed: int = 0
    to_review: int = 0
    unsure: int = 0
    conflicts: int = 0
    toss_ups: int = 0
    lossy: int = 0
    effective: Counts = field(default_factory=Counts)
    by_reason: Mapping[str, int] = field(default_factory=dict)
    by_class: Mapping[str, Counts] = field(default_factory=dict)
    config: str | None = None
    run: int | None = None


@dataclass(frozen=True, kw_only=True)
class Histogram(Result):
    """Boxes per bin of match percent: `edges` has one number more than each count."""

    edges: tuple[float, ...]
    classes: Mapping[str, list[int]] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FlipSide(Result):
    """A box's verdict on one side of a change."""

    verdict: Verdict
    reason: str


@dataclass(frozen=True, kw_only=True)
class Flip(Result):
    """A box whose verdict a config would change."""

    box_id: int
    before: FlipSide
    after: FlipSide
    class_name: str | None = field(default=None, metadata={"key": "class"})
    frame_id: int | None = None
    match_percent: float | None = None


@dataclass(frozen=True, kw_only=True)
class FlipCounts(Result):
    """How many boxes change sides."""

    kept_to_rejected: int = 0
    rejected_to_kept: int = 0


@dataclass(frozen=True, kw_only=True)
class Flips(FlipCounts):
    """How many boxes would flip, and the first of them."""

    total: int = 0
    by_class: Mapping[str, FlipCounts] = field(default_factory=dict)
    items: tuple[Flip, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Diff(FlipCounts):
    """What `run` decides otherwise than `against`; `flips` lists the boxes."""

    run: int
    against: int
    compared: int = 0
    total: int = 0
    by_class: Mapping[str, int] = field(default_factory=dict)
    sides_by_class: Mapping[str, FlipCounts] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Preview(Result):
    """What a config would decide; nothing was written."""

    config: str
    needs_pixels: bool = False
    counts: Counts = field(default_factory=Counts)
    by_reason: Mapping[str, int] = field(default_factory=dict)
    by_class: Mapping[str, Counts] = field(default_factory=dict)
    reasons_by_class: Mapping[str, Any] = field(default_factory=dict)
    histograms: Mapping[str, Any] = field(default_factory=dict)
    flips: Flips = field(default_factory=Flips)


@dataclass(frozen=True, kw_only=True)
class Export(Result):
    """A file of labels in the making, or ready to be downloaded.

    `done` of `total` frames are written.
    """

    id: int
    state: State
    format: str | None = None
    dataset: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    total: int | None = None
    done: int = 0
    size_bytes: int | None = None
    sha256: str | None = None
    counts: Mapping[str, Any] | None = None
    error: Mapping[str, Any] | None = None
    created_at: datetime | None = None
    download: str | None = None

    @property
    def finished(self) -> bool:
        """Nothing more will happen to it."""
        return self.state in FINISHED


@dataclass(frozen=True, kw_only=True)
class Version(Result):
    """Which program answers."""

    version: str
