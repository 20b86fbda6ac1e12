"""A connection whose other end has to read what is written to it."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import sys
from typing import Final

from app.logs import server_log

_LOOKS: Final = 4
"""How often it is looked, in the time after which a connection is cut off."""
_INT: Final = struct.Struct("i")
_AT_ONCE: Final = struct.pack("ii", 1, 0)


class WatchedTransport:
    """A transport that is aborted when nothing of what was written arrives.

    Whatever was not taken by the other end is watched, whether or not somebody waits
    for it, and also after `close`. Only standing still counts: a download may take as
    long as it needs.
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
        self._timer: asyncio.TimerHandle | None = None

    def __getattr__(self, name: str) -> object:
        """All that is not about writing, as the transport itself does it."""
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Write, and look after it until it is sent."""
        self._written += len(data)
        self._transport.write(data)
        if self._timer is None:
            self._since = self._loop.time()
            self._look_later()

    def stop(self) -> None:
        """Watch no longer: the connection is gone."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _look_later(self) -> None:
        self._timer = self._loop.call_later(self._wait_s / _LOOKS, self._look)

    def _look(self) -> None:
        self._timer = None
        left = self._left()
        if not left:
            return
        now, sent = self._loop.time(), self._written - left
        if sent > self._sent:
            self._sent, self._since = sent, now
        if now - self._since >= self._wait_s:
            self._cut_off(left)
        else:
            self._look_later()

    def _left(self) -> int:
        """Bytes that were written and have not arrived."""
        left = self._transport.get_write_buffer_size()
        connection = self._transport.get_extra_info("socket")
        # Linux takes megabytes, and more only when a third of them has arrived: seen
        # from the buffer before it alone, a slow reader would stand still for minutes.
        return left + (_not_arrived(connection.fileno()) if connection else 0)

    def _cut_off(self, left: int) -> None:
        peer = self._transport.get_extra_info("peername")
        server_log.info(
            "cut off %s: for %g s it read nothing of its answer, %d bytes were left",
            peer[0] if peer else "-",
            self._wait_s,
            left,
        )
        if os.name == "posix":  # else the system would go on trying for minutes
            connection = self._transport.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        self._transport.abort()


def _not_arrived(descriptor: int) -> int:
    """Bytes that the system has sent or is to send, and nobody has acknowledged."""
    if sys.platform != "linux":
        return 0
    import fcntl  # these two are not there on Windows
    import termios

    found = fcntl.ioctl(descriptor, termios.TIOCOUTQ, bytes(_INT.size))
    return int(_INT.unpack(found)[0])
