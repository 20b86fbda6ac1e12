"""A folder from somebody else, with Python files that no process of ours may run."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_OTHERS = ("app", "cv2", "filter_core", "numpy", "pydantic", "unghost")
_FILE = """
with open({note!r}, "a") as file:
    file.write({name!r} + chr(10))
raise ImportError({name!r})
"""
_SCRIPT = """
from unghost.cli import main

if __name__ == "__main__":
    main()
"""


@dataclass(frozen=True)
class ForeignFolder:
    """A folder with a Python file for each module that a process of ours may import.

    Such a file notes its name when it is run, and cannot be imported.
    """

    path: Path
    script: Path
    """What an installer makes of `unghost`: it lies, as there, in another folder."""
    note: Path
    """Where the files note that they were run."""

    @classmethod
    def below(cls, parent: Path, name: str = "foreign") -> ForeignFolder:
        """Make one of this name in a folder."""
        made = cls(parent / name, parent / "bin" / "unghost", parent / "note")
        made.path.mkdir()
        for module in (*sys.stdlib_module_names, *_OTHERS):
            content = _FILE.format(note=str(made.note), name=module)
            (made.path / f"{module}.py").write_text(content, "utf-8")
        made.script.parent.mkdir()
        made.script.write_text(_SCRIPT, "utf-8")
        return made

    def command(self, *words: object) -> list[str]:
        """The command line of `unghost` with these words, in a new process."""
        return [sys.executable, str(self.script), *map(str, words)]

    def names_run(self) -> set[str]:
        """The names of the files that were run."""
        with suppress(FileNotFoundError):
            return set(self.note.read_text("utf-8").split())
        return set()
