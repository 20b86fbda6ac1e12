"""Importing a part of the client's package does not load the other parts.

What importing a client, the library or the command line loads is a pin.
"""

import subprocess
import sys

import pytest

import unghost
import unghost.wire


def loaded_modules(statement: str) -> set[str]:
    program = f"import sys; {statement}; print(*sys.modules, sep='\\n')"
    process = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    return set(process.stdout.split())


def test_star_import_has_all_public_names():
    loaded = loaded_modules("from unghost import *; Client, Frame, find_server")

    assert "unghost.client.client" in loaded


def test_unknown_name_of_a_package_raises_attribute_error():
    with pytest.raises(AttributeError, match="'unghost' has no attribute 'Clint'"):
        unghost.Clint  # type: ignore[attr-defined]  # noqa: B018  # that is what is tested
    assert not hasattr(unghost.wire, "Clint")
