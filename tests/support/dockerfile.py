"""Reads a Dockerfile: instructions in order, by stage. Just what this project uses."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Instruction:
    """One line of a Dockerfile, continuation lines joined."""

    keyword: str
    rest: str


@dataclass(frozen=True)
class Stage:
    """From one FROM to the next."""

    instructions: tuple[Instruction, ...]

    def all(self, keyword: str) -> list[str]:
        """What follows each occurrence of the keyword."""
        return [each.rest for each in self.instructions if each.keyword == keyword]

    def last(self, keyword: str) -> str:
        """What follows the occurrence that counts."""
        return self.all(keyword)[-1]

    @property
    def environment(self) -> dict[str, str]:
        """Every ENV, later ones over earlier ones."""
        pairs = (part for rest in self.all("ENV") for part in shlex.split(rest))
        return dict(pair.split("=", 1) for pair in pairs)

    @property
    def command(self) -> list[str]:
        """CMD in its exec form."""
        return [str(word) for word in json.loads(self.last("CMD"))]


def parse_dockerfile(text: str) -> list[Stage]:
    """The stages of a Dockerfile.

    Raises
    ------
    ValueError
        A line is not an instruction.
    """
    joined = re.sub(r"\\\n\s*", "", text)
    lines = [line.strip() for line in joined.splitlines()]
    stages: list[list[Instruction]] = []
    for line in lines:
        if not line or line.startswith("#"):
            continue
        keyword, _, rest = line.partition(" ")
        if not re.fullmatch(r"[A-Z]+", keyword) or not rest:
            raise ValueError(f"not an instruction: {line!r}")
        if keyword == "FROM":
            stages.append([])
        stages[-1].append(Instruction(keyword, rest.strip()))
    return [Stage(tuple(stage)) for stage in stages]
