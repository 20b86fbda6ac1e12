"""Where the large oracles and the real frames are, if they lie beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[3] / "shared"
SHARED = _BESIDE if _BESIDE.is_dir() else None


def shared(path: str) -> Path:
    """The file or folder, or a skip that says what is missing."""
    if SHARED is None or not (SHARED / path).exists():
        pytest.skip(f"needs {path}, which is not beside this checkout")
    return SHARED / path
