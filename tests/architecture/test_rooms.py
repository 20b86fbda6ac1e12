"""Which part of the service may import which other part: only those below it.

A part, here called a room, is a folder or a module directly below `app`.
"""

from __future__ import annotations

import ast
from typing import Final

from tests.support.sources import python_sources

LEVELS: Final = (
    {"__main__"},
    {"serve"},
    {"main"},
    {"ops", "datasets"},
    {"ingest"},
    {"review", "quality", "process"},
    {"runs", "exports"},
    {"boxes"},
    {"jobs"},
    {"access"},
    {"http", "maintenance"},
    {"measuring"},
    {"context"},
    {"storage"},
    {"engine"},
    {"settings", "verdicts"},
    {"db"},
    {"incoming", "metrics"},
    {"addresses", "errors", "logs", "memory", "package", "security"},
)
"""The rooms from the top down: each may import only rooms of the lines below it."""


def room_of(module: str) -> str:
    """The room of a module: the part of its name after `app`; empty for `app`."""
    return module.partition(".")[2].partition(".")[0]


def imported_rooms() -> set[tuple[str, str]]:
    """(importing room, imported room) of all imports, those in functions included."""
    pairs = set()
    for source in python_sources("app"):
        mine = room_of(source.name.removesuffix(".py").replace("/", "."))
        for node in ast.walk(source.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                named = [f"{node.module}.{alias.name}" for alias in node.names]
                modules = named if node.module == "app" else [node.module]
            elif isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            else:
                continue
            rooms = {room_of(module) for module in modules if module.startswith("app.")}
            pairs |= {(mine, room) for room in rooms - {mine, "__init__"}}
    return pairs


def test_every_room_has_its_level():
    named = {room for level in LEVELS for room in level}
    rooms = {room for pair in imported_rooms() for room in pair} - {"__init__"}

    assert rooms - named == set()


def test_rooms_import_only_rooms_of_lower_levels():
    height = {room: number for number, level in enumerate(LEVELS) for room in level}

    up = {(a, b) for a, b in imported_rooms() if height[a] >= height[b]}

    assert up == set()
