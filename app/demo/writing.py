"""A street as a dataset in a folder: a manifest with its images, and the truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from app.demo.street import StreetFrame, StreetScene

MANIFEST: Final = "manifest.jsonl"
TRUTH: Final = "truth.jsonl"


def write_street(
    folder: Path,
    frames: int = 48,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    *,
    actors: float = 1.0,
) -> Path:
    """Render a street into a folder and return its manifest.

    The manifest appears last and at once, so that a folder with one is complete.
    `progress` is called after each frame with how many are done, and of how many.
    `actors` is the share of vehicles, people and lights that are there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    manifest: list[dict[str, Any]] = []
    truth: list[dict[str, Any]] = []
    scene = StreetScene(seed, actors=actors)
    for number, frame in enumerate(scene.frames(frames), start=1):
        manifest.append(_write_frame(folder, frame))
        truth.extend({"key": frame.key, **line} for line in frame.truth)
        if progress is not None:
            progress(number, frames)
    _write_lines(folder / TRUTH, truth)
    _write_lines(folder / MANIFEST, manifest)
    return folder / MANIFEST


def _write_frame(folder: Path, frame: StreetFrame) -> dict[str, Any]:
    paths = {}
    for name, (place, suffix, data) in _files(frame).items():
        path = folder / place / f"{frame.key}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        paths[name] = path.relative_to(folder).as_posix()
    return {"key": frame.key, **paths, **frame.annotation}


def _files(frame: StreetFrame) -> dict[str, tuple[str, str, bytes]]:
    return {
        "image": ("rgb", ".png", frame.image_png),
        "segmentation": ("seg", ".png", frame.segmentation_png),
        "instances": ("instances", ".png", frame.instances_png),
        "depth": ("depth", ".png", frame.depth_png),
        "lidar": ("lidar", ".npy", frame.lidar_npy),
    }


def _write_lines(path: Path, rows: list[dict[str, Any]]) -> None:
    text = "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)
