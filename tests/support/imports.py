"""Modules that `unghost.capture` must not import: too large for CARLA's machine."""

from __future__ import annotations

HEAVY = ("numpy", "cv2", "fastapi", "sqlalchemy", "pydantic", "uvicorn", "app")
