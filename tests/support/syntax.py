"""What rules on the source code need of each module, found in one walk over its tree.

The tree itself is not kept, since those of all modules would take a gigabyte.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from tests.support.sources import Source

REPLACING = {"setattr", "delattr", "__setattr__", "object"}
"""Functions that change an attribute of their first argument."""


class Class(NamedTuple):
    """A class: its bases without modules and type parameters, and (line, private name).

    The names are those that it has of itself.
    """

    name: str
    bases: tuple[str, ...]
    private_names: tuple[tuple[int, str], ...]


class Facts(NamedTuple):
    """What a module imports, its classes, and what it uses and sets of others."""

    has_docstring: bool
    imports: list[ast.Import | ast.ImportFrom]
    classes: list[Class]
    private_names: list[tuple[int, str]]
    """(line, name) of private names that it imports, reads or patches.

    Attributes of `self` do not count.
    """
    changed: list[tuple[int, str]]
    """(line, object) where it sets an attribute or an item of an object."""


@cache
def facts(source: Source) -> Facts:
    """The facts about a module, which is read only once."""
    tree = source.tree
    found = Facts(bool(ast.get_docstring(tree)), [], [], [], [])
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute | ast.Call | ast.ImportFrom):
            found.private_names.extend(private_names_used(node))
        if isinstance(node, ast.Attribute | ast.Call | ast.Subscript):
            found.changed.extend(objects_changed(node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found.imports.append(node)
        elif isinstance(node, ast.ClassDef):
            bases = tuple(map(base_name, node.bases))
            own = tuple(private_names_of_itself(node))
            found.classes.append(Class(node.name, bases, own))
    return found


def imported_names(source: Source) -> Iterator[tuple[int, str]]:
    """(line, full dotted name) of everything that a module imports."""
    for node in facts(source).imports:
        within = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
        yield from ((node.lineno, f"{within}{one.name}") for one in node.names)


def name_of(node: ast.expr) -> str:
    """The last part of a dotted name; empty for any other expression."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def base_name(base: ast.expr) -> str:
    return ast.unparse(base).partition("[")[0].rpartition(".")[2]


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def is_own(value: ast.expr) -> bool:
    """Whether this is `self`, `cls` or `super()`; or `os`, because of `os._exit`."""
    if isinstance(value, ast.Call):
        value = value.func
    return isinstance(value, ast.Name) and value.id in ("self", "cls", "super", "os")


def private_names_used(
    node: ast.Attribute | ast.Call | ast.ImportFrom,
) -> Iterator[tuple[int, str]]:
    """(line, name) of the private names of others that this part of a module uses."""
    names: list[str] = []
    if isinstance(node, ast.Attribute):
        if is_private(node.attr) and not is_own(node.value):
            names = [node.attr]
    elif isinstance(node, ast.ImportFrom):
        names = [*(node.module or "").split("."), *(one.name for one in node.names)]
    elif name_of(node.func) == "setattr":
        texts = (one.value for one in node.args if isinstance(one, ast.Constant))
        names = [str(text).rpartition(".")[2] for text in texts]
    return ((node.lineno, name) for name in names if is_private(name))


def private_names_of_itself(node: ast.ClassDef) -> Iterator[tuple[int, str]]:
    """(line, name) of the private names that a class has of itself."""
    for part in ast.walk(node):
        if isinstance(part, ast.FunctionDef):
            name = part.name
        elif isinstance(part, ast.Attribute) and is_own(part.value):
            name = part.attr
        elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
            name = part.id
        else:
            continue
        if is_private(name):
            yield part.lineno, name


def objects_changed(
    node: ast.Attribute | ast.Call | ast.Subscript,
) -> Iterator[tuple[int, str]]:
    """(line, object) whose attribute or item this part of a module sets."""
    if isinstance(node, ast.Call):
        if node.args and name_of(node.func) in REPLACING:
            yield node.lineno, ast.unparse(node.args[0])
    elif isinstance(node.ctx, ast.Store):
        value = ast.unparse(node.value)
        if isinstance(node, ast.Subscript):
            value = value.removeprefix("vars(").removesuffix(")")
        yield node.lineno, value
