"""Writes the parts of the documentation that repeat the code.

Each part stands between two marks, `<!-- NAME: written by ... -->` and
`<!-- end of NAME -->`. Run without arguments to write them; tests compare them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Protocol

import typer
from pydantic import ByteSize
from pydantic_core import PydanticUndefined

from app.main import create_app
from app.package import static_dir
from app.settings import Settings
from filter_core.config.filter import ClassConfig, FilterConfig
from filter_core.config.keys import keys_of
from filter_core.evidence_kinds import EVIDENCE
from filter_core.evidence_numbers import ChannelNumbers, Evidence, number_columns
from filter_core.formats.registry import FORMATS
from unghost.cli.program import LazyCommand
from unghost.cli.program import app as program
from unghost.cli.screen import EXIT_CODES
from unghost.wire.codes import ERROR_CODES


class Parameter(Protocol):
    """What is asked of an option or argument; typer and click each have their own."""

    @property
    def name(self) -> str | None:
        """As a Python name."""

    @property
    def opts(self) -> list[str]:
        """As typed on the command line."""


class Command(Protocol):
    """What is asked of a command."""

    @property
    def help(self) -> str | None:
        """Its help text."""

    @property
    def params(self) -> Sequence[Parameter]:
        """Its options and arguments."""

    def get_short_help_str(self, limit: int) -> str:
        """The first sentence of its help."""


_BINDING: Final = re.compile(
    r'keys: \[(.*?)\], help: "(.*?)",\s+(group|\.\.\.IN_THE_GRID)'
)
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
            shown = f"`{default.human_readable().replace('.0', '')}`"
        else:
            shown = f"`{default}`"
        meaning = " ".join((field.description or "").split())
        yield f"| `UNGHOST_{name.upper()}` | {shown} | {meaning} |"


def configuration_table() -> Iterator[str]:
    """Every key of a filter configuration, as the class that holds it declares it."""
    per_class = keys_of(ClassConfig)
    yield "| key | default | allowed | per class | needs pixels again | meaning |"
    yield "|---|---|---|:-:|:-:|---|"
    for name, key in keys_of(FilterConfig).items():
        default = json.dumps(key.default).strip('"')
        own = "yes" if name in per_class else ""
        again = "yes" if key.needs_pixels else ""
        yield (
            f"| `{name}` | `{default}` | {key.allowed} | {own} | {again} "
            f"| {key.sentence} |"
        )
    yield "| `classes` | `{}` | a mapping | | | What single classes do differently. |"


def channel_table() -> Iterator[str]:
    """Every word of the key `evidence`."""
    yield "| `evidence` | needs | keeps a box if |"
    yield "|---|---|---|"
    for name, kind in EVIDENCE.items():
        yield f"| `{name}` | {kind.needs} | {kind.keeps} |"


def route_table() -> Iterator[str]:
    """Every route of the OpenAPI document."""
    yield "| method | path | what it does |"
    yield "|---|---|---|"
    for path, operations in create_app(Settings()).openapi()["paths"].items():
        for method, operation in operations.items():
            text = operation.get("description") or operation["summary"]
            first = text.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
            yield f"| {method.upper()} | `{path}` | {first} |"


def error_code_table() -> Iterator[str]:
    """Every code of a problem."""
    yield "| `code` | meaning |"
    yield "|---|---|"
    for code, meaning in ERROR_CODES.items():
        yield f"| `{code}` | {meaning} |"


def command_table() -> Iterator[str]:
    """Every command with its one-line help, groups spelled out."""
    yield "| command | what it does |"
    yield "|---|---|"
    for path, command in commands():
        yield f"| `{path}` | {command.get_short_help_str(limit=200)} |"


def commands(
    path: str = "unghost", command: Command | None = None
) -> Iterator[tuple[str, Command]]:
    """Every command below one that can be typed, with the words that call it."""
    command = command or typer.main.get_command(program)
    if isinstance(command, LazyCommand):
        yield path, command.build()
        return
    for name, child in sorted(getattr(command, "commands", {}).items()):
        yield from commands(f"{path} {name}", child)


def exit_code_table() -> Iterator[str]:
    """Every exit code of the command line."""
    yield "| code | meaning |"
    yield "|--:|---|"
    for code, meaning in EXIT_CODES.items():
        yield f"| {code} | {meaning} |"


def key_table() -> Iterator[str]:
    """Every key of the review page, from the table that the page itself reads."""
    yield "| keys | what they do |"
    yield "|---|---|"
    for keys, text, group in _BINDING.findall(
        (static_dir() / "js" / "core" / "keymap.js").read_text()
    ):
        names = " ".join(f"`{key}`" for key in re.findall(r'"([^"]+)"', keys))
        where = "" if group == "group" else "In the grid: "
        yield f"| {names} | {where}{text} |"


def number_table() -> Iterator[str]:
    """Every number that is measured of a box, as the library declares it."""
    yield "| `evidence` | unit | what was measured |"
    yield "|---|---|---|"
    for table, path in ((Evidence, ""), (ChannelNumbers, "channels.")):
        for name, column in number_columns(table).items():
            yield f"| `{path}{name}` | {column.unit} | {column.meaning} |"


def format_table() -> Iterator[str]:
    """Every format that is read or written, as its module declares it."""
    yield "| format | title | what it holds | read, recognised by | written |"
    yield "|---|---|---|---|:-:|"
    for one in FORMATS.values():
        read = one.recognised_by if one.read else ""
        written = "yes" if one.write else ""
        yield f"| `{one.name}` | {one.title} | {one.docs_row} | {read} | {written} |"


def label_formats() -> Iterator[str]:
    """The formats that hold labels: those in which a box is one of its rectangles."""
    names = (f"`{one.name}`" for one in FORMATS.values() if "boxes" in one.options)
    yield f"*Labels* are {', '.join(names)}."


PARTS: Final[dict[str, tuple[Path, Callable[[], Iterator[str]]]]] = {
    "configuration": (DOCS / "configuration.md", configuration_table),
    "channels": (DOCS / "configuration.md", channel_table),
    "settings": (DOCS / "configuration.md", settings_table),
    "commands": (DOCS / "commands.md", command_table),
    "exit codes": (DOCS / "commands.md", exit_code_table),
    "keys": (DOCS / "review.md", key_table),
    "error codes": (DOCS / "api.md", error_code_table),
    "routes": (DOCS / "api.md", route_table),
    "formats": (DOCS / "formats.md", format_table),
    "formats of labels": (DOCS / "formats.md", label_formats),
    "numbers": (DOCS / "library.md", number_table),
}


def part_pattern(name: str) -> re.Pattern[str]:
    """What stands between the marks of a part; the marks themselves are groups."""
    return re.compile(
        rf"(<!-- {name}: [^>]*-->\n)(.*?)(<!-- end of {name} -->)", re.DOTALL
    )


def with_part(text: str, name: str, lines: Iterator[str]) -> str:
    """The document with this part as the code says it now."""
    content = "\n".join(lines)
    return part_pattern(name).sub(lambda part: f"{part[1]}{content}\n{part[3]}", text)


def main() -> None:
    """Brings every part up to date."""
    for name, (path, lines) in PARTS.items():
        before = path.read_text("utf-8")
        after = with_part(before, name, lines())
        if after != before:
            path.write_text(after, "utf-8")
            print(f"{path.name}: {name} written")


if __name__ == "__main__":
    main()
