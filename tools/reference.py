"""Writes the parts of the documentation that repeat the code: settings and commands.

Each part stands between two marks, `<!-- NAME: written by ... -->` and
`<!-- end of NAME -->`. Run without arguments to write them; tests compare them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import click
import typer
from pydantic import ByteSize
from pydantic_core import PydanticUndefined

from app.settings import Settings
from unghost.cli.program import app as program

DOCS: Final = Path(__file__).resolve().parents[1] / "docs"


def settings_table() -> Iterator[str]:
    """Every setting: its variable, default and meaning."""
    yield "| variable | default | meaning |"
    yield "|---|---|---|"
    for name, field in Settings.model_fields.items():
        default = field.default
        if default is PydanticUndefined:
            shown = "cores"
        elif default is None or default == ():
            shown = "unset"
        elif isinstance(default, ByteSize):
            shown = f"`{default.human_readable()}`"
        else:
            shown = f"`{default}`"
        yield f"| `UNGHOST_{name.upper()}` | {shown} | {field.description} |"


def command_table() -> Iterator[str]:
    """Every command with its one-line help, groups spelled out."""
    yield "| command | what it does |"
    yield "|---|---|"
    for path, command in commands():
        yield f"| `{path}` | {command.get_short_help_str(limit=200)} |"


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command that can be typed, with the words that call it."""
    yield from _below("unghost", typer.main.get_command(program))


def _below(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    children = getattr(command, "commands", None)
    if children is None:
        yield path, command
        return
    for name, child in sorted(children.items()):
        yield from _below(f"{path} {name}", child)


PARTS: Final[dict[str, tuple[Path, Callable[[], Iterator[str]]]]] = {
    "settings": (DOCS / "configuration.md", settings_table),
    "commands": (DOCS / "commands.md", command_table),
}


def part_pattern(name: str) -> re.Pattern[str]:
    """What stands between the marks of a part; the marks themselves are groups."""
    return re.compile(
        rf"(<!-- {name}: [^>]*-->\n)(.*?)(<!-- end of {name} -->)", re.DOTALL
    )


def with_part(text: str, name: str, lines: Iterator[str]) -> str:
    """The document with this part as the code says it now."""
    content = "\n".join(lines)
    return part_pattern(name).sub(
        lambda found: f"{found[1]}{content}\n{found[3]}", text
    )


def main() -> int:
    """Brings every part up to date."""
    for name, (path, lines) in PARTS.items():
        before = path.read_text("utf-8")
        after = with_part(before, name, lines())
        if after != before:
            path.write_text(after, "utf-8")
            print(f"{path.name}: {name} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
