"""Modules that `unghost.capture` must not import: too large for CARLA's machine."""

from __future__ import annotations

LARGE_MODULES = ("numpy", "cv2", "fastapi", "sqlalchemy", "pydantic", "uvicorn", "app")
