"""Parses a Dockerfile into its stages; only the syntax that this project uses."""

import json
import re
import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Instruction:
    """One instruction of a Dockerfile, with its continuation lines joined."""

    keyword: str
    rest: str


@dataclass(frozen=True)
class Stage:
    """The instructions from one FROM to the next."""

    instructions: tuple[Instruction, ...]

    def all(self, keyword: str) -> list[str]:
        """The arguments of each instruction with this keyword."""
        return [each.rest for each in self.instructions if each.keyword == keyword]

    def last(self, keyword: str) -> str:
        """The arguments of the last instruction with this keyword, which wins."""
        return self.all(keyword)[-1]

    @property
    def environment(self) -> dict[str, str]:
        """The variables that ENV sets; a later value replaces an earlier one."""
        pairs = (part for rest in self.all("ENV") for part in shlex.split(rest))
        return dict(pair.split("=", 1) for pair in pairs)

    @property
    def command(self) -> list[str]:
        """The words of CMD, which must be in its exec form (a JSON list)."""
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
