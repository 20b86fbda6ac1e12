"""A transport that cuts a client off which does not read, and the timer that it uses.

Without it, such a client would keep its connection, and the rest of its response in
memory, for as long as it likes.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import sys
from collections.abc import Callable
from typing import Final

from app.logs import server_log

_CHECKS_PER_WAIT: Final = 4
"""How often progress is checked during `wait_s`."""
_INT: Final = struct.Struct("i")
_NO_LINGER: Final = struct.pack("ii", 1, 0)


class Timer:
    """Calls a function once, some time after its latest start."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, call: Callable[[], None]
    ) -> None:
        self._loop, self._call = loop, call
        self._pending: asyncio.TimerHandle | None = None

    @property
    def is_running(self) -> bool:
        """Whether the call is pending."""
        return self._pending is not None

    def start(self, seconds: float) -> None:
        """Call the function after this time, and not at an earlier start's."""
        self.stop()
        self._pending = self._loop.call_later(seconds, self._end)

    def stop(self) -> None:
        """Cancel the call, if it is pending."""
        if self._pending is not None:
            self._pending.cancel()
            self._pending = None

    def _end(self) -> None:
        self._pending = None
        self._call()


class WatchedTransport:
    """A transport that is aborted when the client stops reading.

    Bytes that the client has not received are watched, also after `close`. A slow
    client may continue: it is disconnected only if none arrive for `wait_s` seconds.
    """

    def __init__(
        self,
        transport: asyncio.Transport,
        loop: asyncio.AbstractEventLoop,
        wait_s: float,
    ) -> None:
        self._transport, self._loop, self._wait_s = transport, loop, wait_s
        self._written = self._sent = 0
        self._since = 0.0
        self._timer = Timer(loop, self._check_progress)

    def __getattr__(self, name: str) -> object:
        """All other attributes are those of the transport."""
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Write, and watch the transport until all bytes have arrived."""
        self._written += len(data)
        self._transport.write(data)
        if not self._timer.is_running:
            self._since = self._loop.time()
            self._check_later()

    def stop(self) -> None:
        """Stop watching: the connection is closed."""
        self._timer.stop()

    def _check_later(self) -> None:
        self._timer.start(self._wait_s / _CHECKS_PER_WAIT)

    def _check_progress(self) -> None:
        left = self._left()
        if not left:
            return
        now, sent = self._loop.time(), self._written - left
        if sent > self._sent:
            self._sent, self._since = sent, now
        if now - self._since >= self._wait_s:
            self._cut_off(left)
        else:
            self._check_later()

    def _left(self) -> int:
        """Bytes that were written and have not arrived."""
        left = self._transport.get_write_buffer_size()
        connection = self._transport.get_extra_info("socket")
        # Linux buffers megabytes, and accepts more once a third of them has arrived: by
        # our buffer alone, a slow client would seem to read nothing for minutes.
        return left + (_not_arrived(connection.fileno()) if connection else 0)

    def _cut_off(self, left: int) -> None:
        peer = self._transport.get_extra_info("peername")
        server_log.info(
            "disconnected %s: it read nothing of its response for %g s, with %d bytes "
            "left",
            peer[0] if peer else "-",
            self._wait_s,
            left,
        )
        if os.name == "posix":  # otherwise the system keeps sending for minutes
            connection = self._transport.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
        self._transport.abort()


def _not_arrived(descriptor: int) -> int:
    """Bytes in the system's buffer or not acknowledged yet; 0 if unknown."""
    if sys.platform != "linux":
        return 0
    import fcntl  # these modules do not exist on Windows
    import termios

    found = fcntl.ioctl(descriptor, termios.TIOCOUTQ, bytes(_INT.size))
    return int(_INT.unpack(found)[0])
