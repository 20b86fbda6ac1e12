"""Modules that `unghost.capture` must not import: too large for CARLA's machine."""

LARGE_MODULES = ("numpy", "cv2", "fastapi", "sqlalchemy", "pydantic", "uvicorn", "app")
