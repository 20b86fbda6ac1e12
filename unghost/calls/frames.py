"""Frames: put, list, get, delete."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Final, TypeAlias

from unghost.calls.base import Calls, dataset_path, frame_path, read
from unghost.results import Frame, StoredFrame
from unghost.transport import API, Call, body_of

FileContent: TypeAlias = bytes | str | PathLike[str]

FILE_NAMES: Final = (
    "image",
    "segmentation",
    "depth",
    "instances",
    "lidar",
    "radar",
    "ignore_mask",
)


class FrameCalls(Calls):
    """Methods on frames."""

    def put_frame(
        self,
        dataset: str,
        key: str,
        annotation: Mapping[str, Any] | None = None,
        *,
        replace: bool = False,
        **files: FileContent | None,
    ) -> StoredFrame:
        """Store a frame with its boxes and files, and decide about every box.

        `files` are image, segmentation, depth, instances, lidar, radar, ignore_mask:
        bytes or the path of a file. The same frame again changes nothing (`created`
        is False); another one under the same key raises `Conflict`, unless `replace`.
        """
        parts = {
            "annotation": (
                "annotation.json",
                json.dumps(annotation or {"boxes": []}).encode(),
                "application/json",
            )
        }
        for name, content in files.items():
            if content is not None:
                parts[_part_name(name)] = (name, _bytes(content), _ANY_TYPE)
        response = self._transport.send(
            Call(
                "PUT",
                frame_path(dataset, key),
                params={"replace": replace or None},
                files=parts,
            )
        )
        body = {**body_of(response), "created": response.status_code == 201}
        return read(StoredFrame, body, response)

    def frames(self, dataset: str, **filters: object) -> Iterator[Frame]:
        """The frames of a dataset, without their boxes; filters as in the API."""
        return self._all(Frame, dataset_path(dataset, "frames"), _renamed(filters))

    def frame(self, frame_id: int) -> Frame:
        """One frame with its boxes."""
        return self._get(Frame, f"{API}/frames/{frame_id}")

    def frame_by_key(self, dataset: str, key: str) -> Frame:
        """One frame with its boxes, by the key it was stored under."""
        return self._get(Frame, frame_path(dataset, key))

    def delete_frame(self, dataset: str, key: str) -> None:
        """Delete a frame with its boxes."""
        self._transport.send(Call("DELETE", frame_path(dataset, key)))

    def frame_file(self, frame_id: int, name: str) -> bytes:
        """A file of a frame as it was stored: "image", "segmentation", ..."""
        path = f"{API}/frames/{frame_id}/{name}"
        return self._transport.send(Call("GET", path)).content


# The server goes by the content, so no type is guessed here.
_ANY_TYPE: Final = "application/octet-stream"


def _part_name(name: str) -> str:
    if name not in FILE_NAMES:
        raise TypeError(f"{name!r} is not a file of a frame: {', '.join(FILE_NAMES)}")
    return name


def _bytes(content: FileContent) -> bytes:
    return content if isinstance(content, bytes) else Path(content).read_bytes()


def _renamed(filters: Mapping[str, object]) -> dict[str, object]:
    # `class` is a keyword of Python: the filter is `class_name` here.
    return {
        "class" if name == "class_name" else name: value
        for name, value in filters.items()
    }
