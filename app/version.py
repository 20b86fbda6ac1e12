"""What this service is, and which filter decides in it."""

from __future__ import annotations

from importlib.metadata import version
from typing import Final

VERSION: Final = version("unghost")
FILTER_CORE_VERSION: Final = VERSION
"""The library is released together with the service."""
