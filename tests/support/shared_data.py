"""Finds large test data in the folder `shared` beside the checkout, if it exists."""

from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[3] / "shared"
SHARED = _BESIDE if _BESIDE.is_dir() else None


def shared(path: str) -> Path:
    """The path of a file or folder there; skips the test if it is missing."""
    if SHARED is None or not (SHARED / path).exists():
        pytest.skip(f"needs {path}, which is not beside this checkout")
    return SHARED / path
