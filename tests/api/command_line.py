"""Runs `unghost` as people do: a process with its own home, arguments and exit code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.databases import environment_of

PROGRAM = [sys.executable, "-m", "unghost.cli"]
TIME_LIMIT_S = 120


@dataclass(frozen=True)
class Answer:
    """What a command said, where, and its exit code."""

    code: int
    out: str
    err: str

    @property
    def records(self) -> list[dict[str, Any]]:
        """Standard output as JSON lines; fails if a line is anything else."""
        return [json.loads(line) for line in self.out.splitlines()]


@dataclass(frozen=True)
class CommandLine:
    """`unghost` in a folder of its own."""

    folder: Path
    settings: Mapping[str, str]

    @property
    def environ(self) -> dict[str, str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith("UNGHOST_")}
        home = {"HOME": str(self.folder), "XDG_STATE_HOME": str(self.folder / "state")}
        data = self.settings.get("UNGHOST_DATA")
        database = environment_of(Path(data)) if data else {}
        return {**clean, **home, **database, **self.settings}

    def __call__(self, *words: object) -> Answer:
        done = subprocess.run(
            [*PROGRAM, *map(str, words)],
            cwd=self.folder,
            env=self.environ,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT_S,
        )
        return Answer(done.returncode, done.stdout, done.stderr)

    @contextmanager
    def running(self, *words: object) -> Iterator[subprocess.Popen[str]]:
        """The command as a process that still runs; it is ended with the block."""
        with subprocess.Popen(
            [*PROGRAM, *map(str, words)],
            cwd=self.folder,
            env=self.environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                yield process
            finally:
                process.kill()
