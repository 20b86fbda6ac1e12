"""What the product imports is what it declares, and nothing is declared for nothing."""

from __future__ import annotations

import ast
import re
import sys
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from tests.support.sources import PRODUCT, python_sources

MODULE_OF = {
    "opencv-python-headless": "cv2",
    "python-multipart": "python_multipart",
    "pyyaml": "yaml",
    "zlib-ng": "zlib_ng",
}
# The first versions without a known hole that somebody could reach from outside.
FLOORS = {
    "defusedxml": "0.7.1",
    "h11": "0.16",  # chunks that are none
    "python-multipart": "0.0.34",  # headers of parts without end
    "starlette": "0.49.1",  # ranges in numbers
}
EXTRAS = ("parquet", "postgres", "s3", "cluster", "carla")
# Used by name, never imported: uvicorn serves with them.
NOT_IMPORTED = {"httptools", "uvloop"}


def imported() -> set[str]:
    """Top-level modules that the product imports, without its own and Python's."""
    names = {
        name.split(".")[0]
        for source in python_sources(*PRODUCT)
        for node in ast.walk(source.tree)
        for name in imports_of(node)
    }
    return names - set(sys.stdlib_module_names) - set(PRODUCT)


def imports_of(node: ast.AST) -> list[str]:
    """The modules that one statement imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [node.module or ""]
    return []


def declared(extra: str = "") -> set[str]:
    """The modules of the packages that an installation or an extra brings."""
    requirements = metadata.requires("unghost") or []
    names = [
        re.split(r"[^\w.-]", requirement)[0].lower()
        for requirement in requirements
        if re.findall(r"extra == .(\w+)", requirement) == ([extra] if extra else [])
    ]
    return {MODULE_OF.get(name, name.replace("-", "_")) for name in names}


def test_every_import_is_declared():
    extras = {module for extra in EXTRAS for module in declared(extra)}

    assert imported() - declared() - extras == set()


def test_every_declared_package_is_used():
    assert declared() - imported() - NOT_IMPORTED == set()


@pytest.mark.parametrize("name", FLOORS)
def test_dependencies_with_a_known_hole_are_not_installed(name):
    declared = map(Requirement, metadata.requires("unghost") or [])
    (wanted,) = (one for one in declared if one.name == name)
    lowest = [Version(one.version) for one in wanted.specifier if one.operator == ">="]

    assert lowest >= [Version(FLOORS[name])]
    assert Version(metadata.version(name)) >= Version(FLOORS[name])
