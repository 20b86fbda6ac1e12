"""Things of one kind: the first ten of them, and how many there are."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final, NamedTuple

from filter_core.errors import FilterError, problem_of

MOST_EXAMPLES: Final = 10


class Example(NamedTuple):
    """One thing by its name, and what is to be said about it."""

    name: str
    why: str


class Counted(NamedTuple):
    """How often something occurs."""

    name: str
    number: int


def counted(counts: Counter[str]) -> tuple[Counted, ...]:
    """The most frequent first."""
    return tuple(Counted(name, count) for name, count in counts.most_common())


@dataclass(frozen=True)
class Listed:
    """Things of one kind, of which the first ten are examples."""

    kind: str
    count: int
    examples: tuple[Example, ...]


class Listing:
    """Collects things by their kinds, in memory that does not grow with them."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._examples: dict[str, list[Example]] = {}

    def add(self, kind: str, name: str, why: str) -> None:
        """One more thing."""
        self._counts[kind] = self._counts.get(kind, 0) + 1
        examples = self._examples.setdefault(kind, [])
        if len(examples) < MOST_EXAMPLES:
            examples.append(Example(name, why))

    def refuse(self, key: str, problem: FilterError) -> None:
        """One more frame that cannot be used, by the code of its first fault."""
        code = problem_of(problem)["errors"][0]["code"]
        self.add(code, key, problem.detail)

    def listed(self) -> tuple[Listed, ...]:
        """All kinds, the most frequent first."""
        ordered = sorted(self._counts.items(), key=lambda item: -item[1])
        return tuple(
            Listed(kind, count, tuple(self._examples[kind])) for kind, count in ordered
        )
