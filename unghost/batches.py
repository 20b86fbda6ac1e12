"""A batch of frames in one request; those without an answer are sent again."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final

import h11
import httpx

from unghost.duplex import Duplex, Endpoint, FileChanged
from unghost.errors import (
    Forbidden,
    NotFound,
    Unauthorized,
    Unavailable,
    UnexpectedAnswer,
    error_of_problem,
)
from unghost.outgoing import NotSent, Outcome, Sent
from unghost.packing import END_OF_ARCHIVE, PackedFrame
from unghost.results import Counts
from unghost.retry import RetryPolicy

Tell = Callable[[Outcome], object]

# One failed frame says that every other would fail as well.
HOPELESS: Final = (Unauthorized, Forbidden, NotFound, Unavailable, UnexpectedAnswer)
_MEDIA_TYPE: Final = "application/x-tar"


class BatchSender:
    """Sends batches over one connection; for one thread, but `close` for any."""

    def __init__(
        self, endpoint: Endpoint, retry: RetryPolicy, pause: Callable[[float], bool]
    ) -> None:
        """`pause` waits so many seconds and says whether to go on after it."""
        self._endpoint = endpoint
        self._retry = retry
        self._pause = pause
        self._connection = Duplex(endpoint)

    def close(self) -> None:
        """Cut the connection for good; frames without an answer were not sent."""
        self._connection.abort()

    def send(self, frames: Sequence[PackedFrame], tell: Tell) -> None:
        """Send frames until each has an outcome, told as soon as it is known.

        Raises
        ------
        ApiError
            What concerns every frame: no access, no such dataset, a full disk.
        httpx.TransportError
            The server is away, also after the retries. Any answer is a new start.
        """
        left = deque(frames)
        attempt = 1
        while left:
            before = len(left)
            try:
                self._send_once(left, tell)
                if len(left) == before:
                    raise self._unexpected("ends without a line for any frame")
            except (Unavailable, httpx.TransportError) as error:
                attempt = attempt if len(left) == before else 1
                asked = error.retry_after_s if isinstance(error, Unavailable) else None
                if attempt >= self._retry.attempts:
                    raise
                if not self._pause(self._retry.delay_s(attempt, asked)):
                    raise
                attempt += 1

    def _send_once(self, left: deque[PackedFrame], tell: Tell) -> None:
        """One request; takes from `left` what has an outcome after it."""
        lines = self._answers(tuple(left))
        ended = False
        try:
            for line in lines:
                answer = self._object(line)
                if answer.get("end") is True:
                    ended = True
                    _raise_problem(answer)
                elif left and answer.get("key") in (left[0].frame.key, left[0].name):
                    tell(_outcome(left.popleft().frame.key, answer))
            if not ended:
                raise self._cut("the answer has no last line")
        except _Lost as lost:
            left.remove(lost.packed)
            tell(NotSent(lost.packed.frame.key, ValueError(str(lost))))
        except h11.RemoteProtocolError as error:
            raise self._cut(str(error)) from error
        except OSError as error:
            raise self._cut(error.strerror or str(error)) from error
        finally:
            lines.close()

    def _answers(self, frames: tuple[PackedFrame, ...]) -> Generator[bytes, None, None]:
        """Lines of the answer, while the frames are being sent and after it."""
        connection, sent = self._connection, False
        size = sum(packed.size for packed in frames) + len(END_OF_ARCHIVE)
        try:
            connection.begin(_MEDIA_TYPE, size)
            try:
                for packed in frames:
                    self._send_frame(packed)
                    yield from connection.lines(wait=False)
                connection.send(END_OF_ARCHIVE)
                sent = True
            except OSError:
                # It may have said why, and which frames it has.
                yield from connection.lines(wait=True)
                raise
            yield from connection.lines(wait=True)
        finally:
            connection.end(sent=sent)

    def _send_frame(self, packed: PackedFrame) -> None:
        try:
            for piece in packed.pieces:
                self._connection.send(piece)
        except FileChanged as changed:
            raise _Lost(packed, str(changed)) from changed

    def _object(self, line: bytes) -> Mapping[str, Any]:
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if isinstance(answer, dict):
            return answer
        raise self._unexpected("has a line that is no JSON object")

    def _unexpected(self, why: str) -> UnexpectedAnswer:
        detail = f"the answer of {self._endpoint.url.copy_with(query=None)} {why}"
        return UnexpectedAnswer(200, {"code": "unexpected_answer", "detail": detail})

    def _cut(self, why: str) -> httpx.TransportError:
        request = httpx.Request("POST", self._endpoint.url)
        return httpx.ReadError(why, request=request)


class _Lost(Exception):
    """A frame whose files changed under the sending."""

    def __init__(self, packed: PackedFrame, why: str) -> None:
        super().__init__(why)
        self.packed = packed


def _outcome(key: str, answer: Mapping[str, Any]) -> Outcome:
    problem = answer.get("problem")
    if problem is not None:
        return NotSent(key, error_of_problem(problem))
    counts = Counts.read(answer["decisions"])
    return Sent(key, answer["frame_id"], answer["status"] == 201, counts)


def _raise_problem(answer: Mapping[str, Any]) -> None:
    problem = answer.get("problem")
    if problem is not None:
        raise error_of_problem(problem)
