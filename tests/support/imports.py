"""What is too heavy to be imported where CARLA runs."""

from __future__ import annotations

HEAVY = ("numpy", "cv2", "fastapi", "sqlalchemy", "pydantic", "uvicorn", "app")
