"""Counters and histograms, and the text in which Prometheus reads them."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

Labels = Mapping[str, str]
Samples = Iterable[tuple[Labels, float]]

_ESCAPED: Final = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class Instrument(Protocol):
    """Something that can say what it has counted."""

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""


def described(name: str, kind: str, text: str) -> Iterator[str]:
    """The two lines that come before the samples of a metric."""
    yield f"# HELP {name} {text}"
    yield f"# TYPE {name} {kind}"


def sample(name: str, labels: Labels, value: float) -> str:
    """One sample; whole numbers are written as such."""
    pairs = ",".join(
        f'{key}="{val.translate(_ESCAPED)}"' for key, val in labels.items()
    )
    return f"{name}{{{pairs}}} {value:.15g}" if pairs else f"{name} {value:.15g}"


@dataclass(frozen=True)
class Gauge:
    """What was found just now; a counter that somebody else keeps if `kind` says so."""

    name: str
    text: str
    samples: Samples
    kind: str = "gauge"

    @classmethod
    def of(cls, name: str, text: str, value: float) -> Gauge:
        """Without labels."""
        return cls(name, text, (({}, value),))

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""
        yield from described(self.name, self.kind, self.text)
        for labels, value in self.samples:
            yield sample(self.name, labels, value)


class Counter:
    """Only grows; one number for each combination of its labels' values."""

    def __init__(self, name: str, text: str, labels: Sequence[str] = ()) -> None:
        self._name, self._text, self._labels = name, text, tuple(labels)
        self._lock = threading.Lock()
        self._counts: dict[tuple[str, ...], float] = {} if labels else {(): 0}

    def add(self, amount: float, *values: str) -> None:
        """Count more under these values of the labels, in their order."""
        with self._lock:
            self._counts[values] = self._counts.get(values, 0) + amount

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""
        with self._lock:
            counts = sorted(self._counts.items())
        yield from described(self._name, "counter", self._text)
        for values, count in counts:
            yield sample(
                self._name, dict(zip(self._labels, values, strict=True)), count
            )


@dataclass
class _Observed:
    """How many fell into each bucket, and their sum."""

    buckets: list[int]
    total: float = 0.0


class Histogram:
    """How observed values are spread over buckets."""

    def __init__(
        self,
        name: str,
        text: str,
        *,
        buckets: Sequence[float],
        labels: Sequence[str] = (),
    ) -> None:
        self._name, self._text, self._labels = name, text, tuple(labels)
        self._bounds = tuple(buckets)
        self._lock = threading.Lock()
        self._observed: dict[tuple[str, ...], _Observed] = {}
        if not labels:
            self._observed[()] = self._nothing()

    def observe(self, value: float, *labels: str) -> None:
        """Count one value; a bound belongs to the bucket below it."""
        with self._lock:
            observed = self._observed.get(labels)
            if observed is None:
                observed = self._observed[labels] = self._nothing()
            observed.buckets[bisect_left(self._bounds, value)] += 1
            observed.total += value

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format: buckets add up from the lowest."""
        with self._lock:
            found = sorted(
                (labels, list(one.buckets), one.total)
                for labels, one in self._observed.items()
            )
        yield from described(self._name, "histogram", self._text)
        for values, buckets, total in found:
            labels = dict(zip(self._labels, values, strict=True))
            count = 0
            for bound, within in zip((*self._bounds, "+Inf"), buckets, strict=True):
                count += within
                yield sample(
                    f"{self._name}_bucket", {**labels, "le": str(bound)}, count
                )
            yield sample(f"{self._name}_sum", labels, total)
            yield sample(f"{self._name}_count", labels, count)

    def _nothing(self) -> _Observed:
        return _Observed([0] * (len(self._bounds) + 1))
