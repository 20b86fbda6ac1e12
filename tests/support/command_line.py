"""Runs `unghost` as a command with its own home folder, and returns what it wrote."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.databases import environment_of
from tests.support.processes import Process, start, start_anew

MODULE = "unghost.cli"
PROGRAM = [sys.executable, "-m", MODULE]
TIME_LIMIT_S = 120


@dataclass(frozen=True)
class CommandResult:
    """Standard output, standard error and exit code of a command."""

    code: int
    out: str
    err: str

    @property
    def records(self) -> list[dict[str, Any]]:
        """Standard output as JSON lines; fails if a line is anything else."""
        return [json.loads(line) for line in self.out.splitlines()]


@dataclass(frozen=True)
class CommandLine:
    """Runs `unghost` in a folder of its own, with these environment variables."""

    folder: Path
    settings: Mapping[str, str]
    anew: bool = False
    """Start a new Python interpreter, for tests that look at its arguments in /proc."""

    @property
    def environ(self) -> dict[str, str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith("UNGHOST_")}
        home = {"HOME": str(self.folder), "XDG_STATE_HOME": str(self.folder / "state")}
        data = self.settings.get("UNGHOST_DATA")
        database = environment_of(Path(data)) if data else {}
        return {**clean, **home, **database, **self.settings}

    def __call__(self, *words: object) -> CommandResult:
        with self.running(*words) as process:
            out, err = process.communicate(timeout=TIME_LIMIT_S)
            return CommandResult(process.wait(), out, err)

    @contextmanager
    def running(self, *words: object) -> Iterator[Process]:
        """Start the command; it is killed when the block ends."""
        arguments = list(map(str, words))
        process: Process
        if self.anew:
            process = start_anew([*PROGRAM, *arguments], self.folder, self.environ)
        else:
            process = start([MODULE, *arguments], self.folder, self.environ)
        with process:
            try:
                yield process
            finally:
                process.kill()
