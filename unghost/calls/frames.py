"""Frames: put, list, get, delete."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from typing import Any

from unghost.calls.base import Calls, dataset_path, frame_path
from unghost.outgoing import FileContent, NotSent, Outcome, OutgoingFrame
from unghost.put import put
from unghost.results import Frame, StoredFrame
from unghost.transport import API, Call
from unghost.upload import Upload


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
        given = {name: one for name, one in files.items() if one is not None}
        frame = OutgoingFrame(key, annotation or {"boxes": []}, given)
        path = dataset_path(dataset)
        return put(self._transport, path, frame, replace=replace)

    def push(
        self,
        dataset: str,
        frames: Iterable[OutgoingFrame | NotSent],
        *,
        replace: bool = False,
        connections: int = 2,
    ) -> Generator[Outcome, None, None]:
        """Store many frames; yields what became of each, as it is known, in any order.

        Frames travel in batches, and their files go from the disk to the server without
        being held in memory. What the server has already is not sent; what it refuses
        is an outcome (`NotSent`) and no error. A connection that breaks is made again,
        and frames without an answer are sent once more. Stopping early, by closing the
        iterator, sends nothing more.

            frames = (OutgoingFrame(p.stem, boxes_of(p), {"image": p}) for p in paths)
            for outcome in client.push("town10", frames):
                print(outcome.key, outcome.word)
        """
        upload = Upload(self._transport, dataset_path(dataset), replace, connections)
        return upload.send(frames)

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


def _renamed(filters: Mapping[str, object]) -> dict[str, object]:
    # `class` is a keyword of Python: the filter is `class_name` here.
    return {
        "class" if name == "class_name" else name: value
        for name, value in filters.items()
    }
