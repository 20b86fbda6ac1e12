"""Importing the client loads no large modules, since it also runs where CARLA runs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import unghost
import unghost.wire
from tests.support.imports import LARGE_MODULES


def loaded_modules(statement: str) -> set[str]:
    program = f"import sys; {statement}; print(*sys.modules, sep='\\n')"
    answer = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    return set(answer.stdout.split())


def test_importing_client_does_not_load_server_or_image_libraries():
    loaded = loaded_modules("import unghost; unghost.Client()")

    assert loaded.isdisjoint(LARGE_MODULES)
    assert loaded.isdisjoint({"filter_core", "typer", "yaml"})


def test_importing_cli_does_not_load_heavy_modules_or_client():
    loaded = loaded_modules("import unghost.cli")

    assert loaded.isdisjoint({*LARGE_MODULES, "filter_core", "httpx", "unghost.client"})


def test_all_public_names_can_be_imported():
    loaded_modules(
        "import unghost; [getattr(unghost, name) for name in unghost.__all__]"
    )


def test_star_import_has_all_public_names():
    loaded = loaded_modules("from unghost import *; Client, Frame, find_server")

    assert "unghost.client.client" in loaded


def test_unknown_name_of_a_package_raises_attribute_error():
    with pytest.raises(AttributeError, match="'unghost' has no attribute 'Clint'"):
        unghost.Clint  # type: ignore[attr-defined]  # noqa: B018  # that is what is tested
    assert not hasattr(unghost.wire, "Clint")


def test_importing_package_loads_no_submodules():
    loaded = loaded_modules("import unghost, unghost.wire.words")

    assert {name for name in loaded if name.startswith("unghost")} == {
        "unghost",
        "unghost.lazy",
        "unghost.wire",
        "unghost.wire.words",
    }
    assert loaded.isdisjoint({*LARGE_MODULES, "httpx", "typer"})


def test_importing_wire_does_not_load_httpx_or_filter_core():
    loaded = loaded_modules(
        "from unghost import wire; [getattr(wire, n) for n in dir(wire)]"
    )

    assert "pydantic" in loaded
    assert loaded.isdisjoint({"httpx", "filter_core", "unghost.client", "app"})
