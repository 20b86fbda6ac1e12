"""The folder of a capture: files, its manifest, and what makes it go on later."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from filter_core.formats.manifest import MANIFEST_NAME
from unghost.capture.errors import CaptureError

CAPTURE_NAME: Final = "capture.json"
_SAME: Final = ("scenario_digest", "carla_version", "map")
_FOLDERS: Final[Mapping[str, str]] = {
    "image": "rgb",
    "segmentation": "segmentation",
    "instances": "instances",
    "depth": "depth",
    "lidar": "semantic_lidar",
    "lidar_intensity": "lidar",
    "radar": "radar",
}


class CaptureFolder:
    """Frames on the disk: a frame is in the manifest once all its files are whole."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.keys: list[str] = []

    def open(self, about: Mapping[str, Any]) -> None:
        """Begin a capture here, or go on with the one that is here.

        Raises
        ------
        CaptureError
            The folder holds something else, or frames of another capture.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        known = self._read_about()
        if known is None and any(self.path.iterdir()):
            raise CaptureError(
                f"{self.path} is not empty and holds no capture: choose another "
                "--output"
            )
        self.keys = self._read_keys()
        if known is not None and self.keys:
            self._require_same(known, about)
        else:
            # Without a frame there is nothing that a mended scenario could not fit.
            self.describe(about)

    def describe(self, about: Mapping[str, Any]) -> None:
        """Write what the capture is, whole or not at all."""
        content = json.dumps(about, indent=2, ensure_ascii=False) + "\n"
        _write_whole(self.path / CAPTURE_NAME, content.encode())

    def add(
        self, key: str, files: Mapping[str, tuple[str, bytes]], frame: dict[str, Any]
    ) -> None:
        """Store a frame: first its files, then its line."""
        stem = f"{len(self.keys):06d}"
        paths = {}
        for kind, (suffix, content) in files.items():
            name = f"{_FOLDERS[kind]}/{stem}{suffix}"
            target = self.path / name
            target.parent.mkdir(exist_ok=True)
            _write_whole(target, content)
            paths[kind] = name
        # The manifest has one place for points, and that is for those with tags.
        more = paths.pop("lidar_intensity", None)
        if more is not None:
            frame["extra"]["files"] = {"lidar_intensity": more}
        self._append({"key": key, **paths, **frame})
        self.keys.append(key)

    def _append(self, line: Mapping[str, Any]) -> None:
        text = json.dumps(line, ensure_ascii=False, allow_nan=False) + "\n"
        with (self.path / MANIFEST_NAME).open("ab") as file:
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())

    def _read_about(self) -> dict[str, Any] | None:
        path = self.path / CAPTURE_NAME
        if not path.exists():
            return None
        try:
            known = json.loads(path.read_bytes())
        except ValueError as error:
            raise CaptureError(f"{path}: not JSON: {error}") from error
        is_ours = isinstance(known, dict) and set(_SAME) <= set(known)
        return known if is_ours else None

    def _require_same(self, known: Mapping[str, Any], new: Mapping[str, Any]) -> None:
        for name in _SAME:
            if known.get(name) != new.get(name):
                what = "scenario" if name == "scenario_digest" else name
                raise CaptureError(
                    f"{self.path} holds a capture with another {what}: choose another "
                    "--output, or repeat what it was begun with"
                )

    def _read_keys(self) -> list[str]:
        path = self.path / MANIFEST_NAME
        if not path.exists():
            return []
        content = path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            # The line that was being written when the machine stopped.
            os.truncate(path, whole)
        lines = content[:whole].splitlines()
        try:
            return [str(json.loads(line)["key"]) for line in lines]
        except (ValueError, LookupError, TypeError) as error:
            raise CaptureError(
                f"{path}: damaged, no capture can go on here: {error}"
            ) from error


def _write_whole(target: Path, content: bytes) -> None:
    partial = target.with_name(f".{target.name}.part")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(target)
