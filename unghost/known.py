"""What a dataset holds already, so that nothing is sent twice: told by content."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from unghost.outgoing import AlreadyThere, NotSent, OutgoingFrame, is_text
from unghost.retry import PATIENCE
from unghost.transport import Call, Transport, body_of

_HASHING: Final = 2
"""Threads: reading and hashing leave the interpreter to others."""


class KnownFrames:
    """Asks the server about some frames at a time, and keeps nothing.

    Only frames whose key is there are read here, to compare what they consist of.
    """

    def __init__(self, transport: Transport, dataset_path: str) -> None:
        self._transport = transport
        self._path = f"{dataset_path}/known-frames"

    def sorted_out(
        self, frames: Sequence[OutgoingFrame | NotSent]
    ) -> Iterator[OutgoingFrame | AlreadyThere | NotSent]:
        """The same frames in their order; outcomes stand for those not to be sent."""
        keys = [frame.key for frame in frames if _may_be_there(frame)]
        there = self._ask(keys) if keys else {}
        compare = [
            frame
            for frame in frames
            if isinstance(frame, OutgoingFrame) and frame.key in there
        ]
        found: Iterator[str | NotSent] = iter(())
        if compare:
            with ThreadPoolExecutor(_HASHING, "compare") as pool:
                found = iter(list(pool.map(_digest, compare)))
        for frame in frames:
            if isinstance(frame, NotSent) or frame.key not in there:
                yield frame
                continue
            digest = next(found)
            frame_id, known = there[frame.key]
            if isinstance(digest, NotSent):
                yield digest
            else:
                yield AlreadyThere(frame.key, frame_id) if digest == known else frame

    def _ask(self, keys: Sequence[str]) -> dict[str, tuple[int, str]]:
        call = Call("POST", self._path, json={"keys": keys}, patience=PATIENCE)
        response = self._transport.send(call)
        items = body_of(response).get("items", ())
        return {item["key"]: (item["frame_id"], item["digest"]) for item in items}


def _may_be_there(frame: OutgoingFrame | NotSent) -> bool:
    # A file's name need not be text: such a key is refused when it is packed.
    return isinstance(frame, OutgoingFrame) and is_text(frame.key)


def _digest(frame: OutgoingFrame) -> str | NotSent:
    try:
        return frame.digest()
    except OSError as error:
        return NotSent(frame.key, error)
