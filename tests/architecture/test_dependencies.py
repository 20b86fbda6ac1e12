"""The product declares the packages that it imports, and uses all that it declares."""

import ast
import re
import sys
from importlib import metadata
from itertools import product

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.support.documents import read
from tests.support.sources import PRODUCT, imports, python_sources

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
    "python-multipart": "0.0.31",  # endless headers of parts
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
        for node in imports(source)
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


def test_every_import_is_declared_and_every_declared_package_is_used():
    extras = {module for extra in EXTRAS for module in declared(extra)}

    modules = imported()
    assert modules - declared() - extras == OF_CALLERS
    assert declared() - modules - NOT_IMPORTED == set()


PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
PLATFORMS = ("linux", "darwin", "win32")


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        ("requirements.lock", ()),
        ("requirements-cluster.lock", ("cluster", "parquet", "postgres", "s3")),
    ],
)
def test_lock_has_one_allowed_version_of_each_declared_package(lock, extras):
    project = pytest.importorskip("tomllib").loads(read("pyproject.toml"))["project"]
    declared = [*project["dependencies"]]
    for extra in extras:
        declared += project["optional-dependencies"][extra]
    pinned = [Requirement(pin) for pin in re.findall(r"^(\w.*?) \\$", read(lock), re.M)]

    for python, platform in product(PYTHONS, PLATFORMS):
        machine = {
            "python_version": python,
            "python_full_version": f"{python}.9",
            "sys_platform": platform,
            "platform_machine": "x86_64",
        }
        chosen = {
            canonicalize_name(pin.name): next(iter(pin.specifier)).version
            for pin in pinned
            if pin.marker is None or pin.marker.evaluate(machine)
        }
        for need in map(Requirement, declared):
            if need.marker is None or need.marker.evaluate(machine):
                assert chosen[canonicalize_name(need.name)] in need.specifier


def test_locks_have_a_hash_for_each_package_and_name_no_server():
    for lock in ("requirements.lock", "requirements-cluster.lock"):
        packages = re.split(r"\n(?=\w)", read(lock).partition("\n")[2])[1:]

        assert len(packages) > 50
        assert [text for text in packages if "--hash=sha256:" not in text] == []
        assert "://" not in read(lock)


@pytest.mark.parametrize("name", LOWEST_VERSIONS)
def test_dependencies_with_a_known_vulnerability_are_not_installed(name):
    declared = map(Requirement, metadata.requires("unghost") or [])
    (need,) = (need for need in declared if need.name == name)
    lowest = [Version(spec.version) for spec in need.specifier if spec.operator == ">="]

    assert lowest >= [Version(LOWEST_VERSIONS[name])]
    assert Version(metadata.version(name)) >= Version(LOWEST_VERSIONS[name])
