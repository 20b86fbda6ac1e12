"""This installation: its version, and the folders of its page and its migrations."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Final

import app

_PACKAGE = Path(app.__file__).resolve().parent


def static_dir() -> Path:
    """The folder with the review page's files."""
    return _resource("static")


def migrations_dir() -> Path:
    """The folder with Alembic's environment and versions."""
    return _resource("migrations")


def _resource(name: str) -> Path:
    """The folder `app/_<name>` of a wheel, or `<name>` next to `app` in a checkout.

    Raises FileNotFoundError: the installation is incomplete.
    """
    candidates = (_PACKAGE / f"_{name}", _PACKAGE.parent / name)
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise FileNotFoundError(f"this installation has no {name!r} folder; reinstall it")


VERSION: Final = version("unghost")
FILTER_CORE_VERSION: Final = VERSION
"""The library is released together with the service."""
