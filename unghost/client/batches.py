"""Sends a batch of frames in one request; frames without a result are sent again."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import h11
import httpx

from unghost import wire
from unghost.client import errors
from unghost.client.duplex import Duplex, FileChanged
from unghost.client.outgoing import END_OF_ARCHIVE, NotSent, Outcome, PackedFrame, Sent
from unghost.client.transport import Attempts, Endpoint, RetryPolicy, no_response
from unghost.wire.words import TAR

if TYPE_CHECKING:
    from unghost.wire.model import Json

Report: TypeAlias = Callable[[Outcome], object]
"""Called with each frame's outcome as soon as it is known."""


class BatchSender:
    """Sends batches over one connection. Other threads may only call `close`."""

    def __init__(
        self, endpoint: Endpoint, retry: RetryPolicy, pause: Callable[[float], bool]
    ) -> None:
        """`pause` waits so many seconds, and returns False if sending must stop."""
        self._endpoint = endpoint
        self._retry = retry
        self._pause = pause
        self._connection = Duplex(endpoint)

    def close(self) -> None:
        """Cut the connection for good; frames without a result were not sent."""
        self._connection.abort()

    def send(self, frames: Sequence[PackedFrame], report: Report) -> None:
        """Send frames until each has an outcome.

        Raises ApiError for an error that concerns all frames (no access, no such
        dataset, a full disk), and NoResponse if the server does not respond even after
        the retries. Their time starts again after each outcome.
        """
        unreported = deque(frames)
        attempts = Attempts(self._retry)
        while unreported:
            before = len(unreported)
            try:
                self._send_once(unreported, report)
                if len(unreported) == before:
                    raise self._unexpected("has no line for any frame")
            except errors.Unavailable as error:
                moved_on = len(unreported) < before
                wait_s = attempts.failed(error, moved_on=moved_on)
                if not self._pause(wait_s):
                    raise

    def _send_once(self, unreported: deque[PackedFrame], report: Report) -> None:
        """Send one request; frames with an outcome are removed from `unreported`."""
        lines = self._lines(tuple(unreported))
        ended = False
        try:
            for line in lines:
                result = self._object(line)
                if result.get("end") is True:
                    ended = True
                    _raise_problem(result)
                    continue
                # By its name in the archive, if the server could not read its key.
                first = unreported[0] if unreported else None
                if first and result.get("key") in (first.frame.key, first.name):
                    unreported.popleft()
                    report(self._outcome(first.frame.key, result))
            if not ended:
                raise self._cut(EOFError("the response has no last line"))
        except _FrameChanged as changed:
            unreported.remove(changed.packed)
            key = changed.packed.frame.key
            report(NotSent(key, ValueError(str(changed))))
        except h11.RemoteProtocolError as error:
            why = "the connection was closed before the response was complete"
            raise self._cut(EOFError(why)) from error
        except OSError as error:
            raise self._cut(error) from error
        finally:
            lines.close()

    def _lines(self, frames: tuple[PackedFrame, ...]) -> Generator[bytes, None, None]:
        """Lines of the response, while the frames are being sent and after it."""
        connection, sent = self._connection, False
        size = sum(packed.size for packed in frames) + len(END_OF_ARCHIVE)
        try:
            connection.begin(TAR, size)
            try:
                for packed in frames:
                    try:
                        for piece in packed.pieces:
                            self._connection.send(piece)
                    except FileChanged as changed:
                        raise _FrameChanged(packed, str(changed)) from changed
                    yield from connection.lines(wait=False)
                connection.send(END_OF_ARCHIVE)
                sent = True
            except OSError:
                # The response may give the reason, and the frames that were stored.
                yield from connection.lines(wait=True)
                raise
            yield from connection.lines(wait=True)
        finally:
            connection.end(sent=sent)

    def _object(self, line: bytes) -> Json:
        try:
            result = json.loads(line)
        except ValueError:
            result = None
        if isinstance(result, dict):
            return result
        raise self._unexpected("has a line that is not a JSON object")

    def _outcome(self, key: str, result: Json) -> Outcome:
        try:
            return _outcome(key, result)
        except (ValueError, AttributeError) as error:
            why = f"has a line that cannot be read: {error}"
            raise self._unexpected(why) from error

    def _unexpected(self, why: str) -> errors.UnexpectedAnswer:
        request = httpx.Request("POST", self._endpoint.url)
        return errors.unexpected(httpx.Response(200, request=request), why)

    def _cut(self, error: Exception) -> errors.NoResponse:
        sent = not isinstance(error, ConnectionRefusedError)
        return no_response(self._endpoint.url, error, sent=sent)


class _FrameChanged(Exception):
    """A file of a frame changed while it was sent."""

    def __init__(self, packed: PackedFrame, why: str) -> None:
        super().__init__(why)
        self.packed = packed


def _outcome(key: str, result: Json) -> Outcome:
    problem = result.get("problem")
    if problem is not None:
        return NotSent(key, errors.error_of_problem(problem))
    line = wire.BatchLine.read(result)
    if line.frame_id is None or line.decisions is None:
        raise ValueError("a stored frame lacks its id or its decisions")
    return Sent(
        key,
        line.frame_id,
        line.status == httpx.codes.CREATED,
        line.decisions,
        line.answers_set_aside,
        line.boxes_set_aside,
        line.notes,
    )


def _raise_problem(result: Json) -> None:
    problem = result.get("problem")
    if problem is not None:
        raise errors.error_of_problem(problem)
