"""Many frames to the server at once: bounded, safe to interrupt and to repeat."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ThreadPoolExecutor,
    as_completed,
    wait,
)
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Literal, TypeAlias

from unghost.calls.frames import FileContent
from unghost.client import Client
from unghost.errors import (
    ApiError,
    Forbidden,
    NotFound,
    Unauthorized,
    Unavailable,
    UnexpectedAnswer,
)
from unghost.results import Frame, StoredFrame

# One failed frame says that every other would fail as well.
_HOPELESS: Final = (Unauthorized, Forbidden, NotFound, Unavailable, UnexpectedAnswer)
# Enough to keep every worker busy while the caller looks at the outcomes.
_WAITING_PER_WORKER: Final = 2


Word: TypeAlias = Literal["stored", "already_there", "refused"]


@dataclass(frozen=True)
class OutgoingFrame:
    """A frame to be sent: its key, its annotation, and its files (paths or bytes)."""

    key: str
    annotation: Mapping[str, Any]
    files: Mapping[str, FileContent] = field(default_factory=dict)


@dataclass(frozen=True)
class Sent:
    """A frame that was sent, and that the server has."""

    key: str
    stored: StoredFrame

    @property
    def word(self) -> Word:
        """What happened, in a word."""
        return "stored" if self.stored.created else "already_there"


@dataclass(frozen=True)
class AlreadyThere:
    """A frame that was not sent, because the server has one like it."""

    key: str
    word: ClassVar[Word] = "already_there"


@dataclass(frozen=True)
class NotSent:
    """A frame that the server refused, or that cannot be read here."""

    key: str
    error: ApiError | OSError | ValueError
    word: ClassVar[Word] = "refused"


Outcome: TypeAlias = Sent | AlreadyThere | NotSent


class Known:
    """What a dataset holds, as far as its listing tells, to send nothing twice.

    A frame counts as there if key, number of boxes and kinds of files agree; where
    they do not, it is sent, and the server says what is wrong.
    """

    def __init__(self, frames: Iterable[Frame]) -> None:
        self._outlines = {frame.key: _outline_there(frame) for frame in frames}

    def __contains__(self, frame: OutgoingFrame) -> bool:
        return self._outlines.get(frame.key) == _outline_here(frame)


@dataclass(frozen=True)
class Upload:
    """How to send frames: where to, and on how many connections at once.

    What is `known` to be there is not sent; `replace` makes changed frames new
    revisions instead of conflicts.
    """

    client: Client
    dataset: str
    known: Known | None = None
    replace: bool = False
    workers: int = 4

    def send(
        self, frames: Iterable[OutgoingFrame | NotSent]
    ) -> Generator[Outcome, None, None]:
        """Send frames; yields outcomes as they come, in any order.

        What a reader could not read (`NotSent`) is passed on. `frames` is consumed no
        faster than it is sent: memory does not grow with it.
        Stopping early sends nothing more. What concerns every frame (no access, no
        such dataset, no server) is raised; what concerns one is its outcome.
        """
        pool = ThreadPoolExecutor(self.workers, thread_name_prefix="upload")
        sending: set[Future[Outcome]] = set()
        try:
            for frame in frames:
                if isinstance(frame, NotSent):
                    yield frame
                    continue
                if self.known is not None and frame in self.known:
                    yield AlreadyThere(frame.key)
                    continue
                sending.add(pool.submit(self._put, frame))
                if len(sending) >= self.workers * _WAITING_PER_WORKER:
                    done, sending = wait(sending, return_when=FIRST_COMPLETED)
                    yield from (call.result() for call in done)
            yield from (call.result() for call in as_completed(sending))
        finally:
            pool.shutdown(cancel_futures=True)

    def _put(self, frame: OutgoingFrame) -> Outcome:
        files: Mapping[str, Any] = frame.files
        try:
            stored = self.client.put_frame(
                self.dataset,
                frame.key,
                frame.annotation,
                replace=self.replace,
                **files,
            )
        except _HOPELESS:
            raise
        except (ApiError, OSError) as error:
            return NotSent(frame.key, error)
        return Sent(frame.key, stored)


def _outline_there(frame: Frame) -> tuple[int, bool, bool]:
    return frame.counts.boxes, frame.has_image, frame.has_segmentation


def _outline_here(frame: OutgoingFrame) -> tuple[int, bool, bool]:
    boxes = frame.annotation.get("boxes") or ()
    return len(boxes), "image" in frame.files, "segmentation" in frame.files
