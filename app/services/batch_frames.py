"""Puts the members of an archive together to frames, in the order they come."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from app.errors import AppError, TooLarge, Unprocessable
from app.services.frame_files import KINDS
from app.services.tar_stream import Member

_ANNOTATION: Final = ".json"


@dataclass(frozen=True)
class FrameLimits:
    """What one frame may be at most."""

    max_parts: int
    max_part_bytes: int
    max_frame_bytes: int


@dataclass
class IncomingFrame:
    """A frame as it came; `fault` is what is wrong with it already."""

    name: str
    annotation: bytes = b""
    files: dict[str, bytes] = field(default_factory=dict)
    fault: AppError | None = None

    @property
    def size_bytes(self) -> int:
        """What it holds in memory."""
        return len(self.annotation) + sum(map(len, self.files.values()))


class FrameAssembler:
    """Gives each frame when the next one begins, or the archive ends."""

    def __init__(self, limits: FrameLimits) -> None:
        self._limits = limits
        self._open: IncomingFrame | None = None

    @property
    def size_bytes(self) -> int:
        """What the frame that is not complete yet holds in memory."""
        return self._open.size_bytes if self._open else 0

    def add(self, member: Member) -> Iterator[IncomingFrame]:
        """The frames that this member completes."""
        if member.name.endswith(_ANNOTATION):
            yield from self.finish()
            self._open = IncomingFrame(member.name.removesuffix(_ANNOTATION))
            self._take(self._open, "annotation", member.content)
        elif self._open and member.name.startswith(f"{self._open.name}."):
            suffixes = member.name[len(self._open.name) + 1 :]
            self._add_file(self._open, suffixes.partition(".")[0], member.content)
        else:
            yield IncomingFrame(member.name, fault=self._misplaced(member.name))

    def finish(self) -> Iterator[IncomingFrame]:
        """The last frame."""
        done, self._open = self._open, None
        if done is not None:
            yield done

    def _misplaced(self, name: str) -> Unprocessable:
        first = "the NAME.json of its frame before it"
        expected = repr(f"{self._open.name}.KIND"[:80]) if self._open else first
        return Unprocessable(
            f"file {name[:80]!r} belongs to no frame; expected {expected}",
            code="misplaced_member",
        )

    def _add_file(self, frame: IncomingFrame, kind: str, content: bytes | None) -> None:
        if kind not in KINDS:
            _refuse(
                frame,
                Unprocessable(
                    f"unknown part {kind[:80]!r}; expected {', '.join(KINDS)}",
                    code="unknown_part",
                ),
            )
        elif kind in frame.files:
            repeated = f"part {kind!r} was sent twice"
            _refuse(frame, Unprocessable(repeated, code="repeated_part"))
        elif len(frame.files) + 2 > self._limits.max_parts:
            most = self._limits.max_parts
            _refuse(frame, TooLarge(f"the frame has more than {most} parts"))
        else:
            self._take(frame, kind, content)

    def _take(self, frame: IncomingFrame, part: str, content: bytes | None) -> None:
        limits = self._limits
        if content is None:
            most = limits.max_part_bytes
            _refuse(frame, TooLarge(f"part {part!r} is larger than {most} bytes"))
        elif frame.size_bytes + len(content) > limits.max_frame_bytes:
            most = limits.max_frame_bytes
            _refuse(frame, TooLarge(f"the frame is larger than {most} bytes"))
        elif frame.fault is None and part == "annotation":
            frame.annotation = content
        elif frame.fault is None:
            frame.files[part] = content


def _refuse(frame: IncomingFrame, fault: AppError) -> None:
    """The first fault is what is told; nothing of the frame is kept."""
    frame.fault = frame.fault or fault
    frame.annotation, frame.files = b"", {}
