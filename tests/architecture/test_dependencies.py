"""The product declares the packages that it imports, and uses all that it declares."""

from __future__ import annotations

import ast
import re
import sys
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from tests.support.sources import PRODUCT, python_sources
from tests.support.syntax import facts

MODULE_OF = {
    "opencv-python-headless": "cv2",
    "python-multipart": "python_multipart",
    "pyyaml": "yaml",
    "zlib-ng": "zlib_ng",
}
# The first versions without a known vulnerability that requests could exploit.
LOWEST_VERSIONS = {
    "defusedxml": "0.7.1",
    "h11": "0.16",  # malformed chunks
    "python-multipart": "0.0.34",  # endless headers of parts
    "starlette": "0.49.1",  # very many ranges
}
EXTRAS = ("parquet", "postgres", "s3", "cluster", "carla", "train")
# Never imported by the product: uvicorn finds them by name and uses them.
NOT_IMPORTED = {"httptools", "uvloop"}


# Imported where the caller has them, or by type checkers alone.
OF_CALLERS = {"pandas", "polars", "typing_extensions"}


def imported() -> set[str]:
    """The top-level modules of others that the product imports."""
    names = {
        name.split(".")[0]
        for source in python_sources(*PRODUCT)
        for node in facts(source).imports
        for name in modules_of(node)
    }
    return names - set(sys.stdlib_module_names) - set(PRODUCT)


def modules_of(node: ast.Import | ast.ImportFrom) -> list[str]:
    """The modules that one statement imports."""
    if isinstance(node, ast.ImportFrom):
        return [node.module or ""]
    return [alias.name for alias in node.names]


def declared(extra: str = "") -> set[str]:
    """The modules of the packages that the product, or this extra of it, declares."""
    requirements = metadata.requires("unghost") or []
    names = [
        re.split(r"[^\w.-]", requirement)[0].lower()
        for requirement in requirements
        if re.findall(r"extra == .(\w+)", requirement) == ([extra] if extra else [])
    ]
    return {MODULE_OF.get(name, name.replace("-", "_")) for name in names}


def test_every_import_is_declared():
    extras = {module for extra in EXTRAS for module in declared(extra)}

    assert imported() - declared() - extras == OF_CALLERS


def test_every_declared_package_is_used():
    assert declared() - imported() - NOT_IMPORTED == set()


@pytest.mark.parametrize("name", LOWEST_VERSIONS)
def test_dependencies_with_a_known_vulnerability_are_not_installed(name):
    declared = map(Requirement, metadata.requires("unghost") or [])
    (wanted,) = (one for one in declared if one.name == name)
    lowest = [Version(one.version) for one in wanted.specifier if one.operator == ">="]

    assert lowest >= [Version(LOWEST_VERSIONS[name])]
    assert Version(metadata.version(name)) >= Version(LOWEST_VERSIONS[name])
