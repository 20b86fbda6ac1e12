"""Importing the client loads no large modules, since it also runs where CARLA runs."""

from __future__ import annotations

import subprocess
import sys

from tests.support.imports import HEAVY


def modules_after(statement: str) -> set[str]:
    program = f"import sys; {statement}; print(*sys.modules, sep='\\n')"
    answer = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    return set(answer.stdout.split())


def test_importing_the_client_loads_neither_the_server_nor_pixels():
    loaded = modules_after("import unghost; unghost.Client()")

    assert loaded.isdisjoint(HEAVY)
    assert loaded.isdisjoint({"filter_core", "typer", "yaml"})


def test_the_command_line_starts_without_them_too():
    loaded = modules_after("import unghost.cli")

    assert loaded.isdisjoint({*HEAVY, "filter_core", "httpx", "unghost.client"})


def test_every_public_name_is_there():
    modules_after(
        "import unghost; [getattr(unghost, name) for name in unghost.__all__]"
    )


def test_importing_the_package_loads_nothing_of_it():
    loaded = modules_after("import unghost, unghost.wire.words")

    assert {name for name in loaded if name.startswith("unghost")} == {
        "unghost",
        "unghost.wire",
        "unghost.wire.words",
    }
    assert loaded.isdisjoint({*HEAVY, "httpx", "typer"})


def test_the_wire_loads_neither_a_connection_nor_the_library():
    loaded = modules_after(
        "from unghost import wire; [getattr(wire, n) for n in dir(wire)]"
    )

    assert "pydantic" in loaded
    assert loaded.isdisjoint({"httpx", "filter_core", "unghost.client", "app"})
