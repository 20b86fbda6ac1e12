"""Importing the client costs little: it runs where CARLA runs."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("numpy", "cv2", "fastapi", "sqlalchemy", "pydantic", "uvicorn", "app")


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
    assert modules_after("import unghost.cli").isdisjoint(HEAVY)


def test_every_public_name_is_there():
    modules_after(
        "import unghost; [getattr(unghost, name) for name in unghost.__all__]"
    )
