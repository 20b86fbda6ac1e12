"""One HTTP connection whose response is read while the request is still being sent.

httpx reads a response only when it has sent the whole request. Here a body is written
from files to the socket in large chunks, and h11 implements the HTTP protocol.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterable, Iterator
from typing import Any, Final

import h11
import httpx

from unghost.client.call import MAX_JSON_BYTES
from unghost.client.errors import error_of, unexpected
from unghost.client.outgoing import FilePiece, Piece, open_regular
from unghost.client.transport import Endpoint, whole

_CONTINUE_S: Final = 5.0
"""How long to wait for "100 Continue"; a proxy may not forward it."""

_CHUNK_BYTES: Final = 1 << 18

MAX_LINE_BYTES: Final = 16 * 1024**2
"""Maximum size of the line of a response that is about one frame."""

_NOTHING_THERE: Final = (BlockingIOError, ssl.SSLWantReadError)


class FileChanged(Exception):
    """A file has changed since the length of the request was announced."""


class Duplex:
    """A connection that is opened when needed and kept for the next request.

    Not thread-safe, except `abort`, which any thread may call.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._socket: socket.socket | None = None
        self._http = h11.Connection(our_role=h11.CLIENT)
        self._rest = b""
        self._answered = self._aborted = False
        self._buffer = bytearray(_CHUNK_BYTES)

    def begin(self, media_type: str, size: int) -> None:
        """Send the head of a POST of `size` bytes; wait until the server accepts it.

        Raises OSError without a connection, and ApiError if the server refused before
        it had read anything.
        """
        if self._socket is None:
            self._http = h11.Connection(our_role=h11.CLIENT)
            self._socket = self._connect()
        sock = self._socket
        if self._aborted:
            self.close()
            raise ConnectionAbortedError("the upload was stopped")
        self._rest, self._answered = b"", False
        endpoint = self._endpoint
        headers = {
            "Host": endpoint.url.netloc.decode("ascii"),
            **endpoint.headers,
            "Content-Type": media_type,
            "Content-Length": str(size),
            "Expect": "100-continue",
        }
        request = h11.Request(
            method="POST", target=endpoint.url.raw_path, headers=list(headers.items())
        )
        head = self._http.send(request)
        body: Any = range(size)  # which h11 counts, but does not send
        self._http.send_with_data_passthrough(h11.Data(data=body))
        self._http.send(h11.EndOfMessage())
        sock.sendall(head)
        sock.settimeout(_CONTINUE_S)
        try:
            event = self._http.next_event()
            while event is h11.NEED_DATA:
                self._http.receive_data(sock.recv(_CHUNK_BYTES))
                event = self._http.next_event()
        except TimeoutError:
            return
        finally:
            sock.settimeout(self._endpoint.timeout.read)
        if isinstance(event, h11.Response) and event.status_code != 200:
            self._raise_refusal(event)

    def send(self, piece: Piece) -> None:
        """The next piece of the body.

        Raises OSError if the connection is broken (lines received before can still be
        read), and FileChanged.
        """
        sock = self._open_socket()
        if isinstance(piece, FilePiece):
            view, left = memoryview(self._buffer), piece.size
            try:
                file = open_regular(piece.path)
            except OSError as error:
                raise FileChanged(f"{piece.path.name}: {error.strerror}") from error
            with file:
                while left:
                    count = file.readinto(view[: min(left, _CHUNK_BYTES)])
                    if not count:
                        raise FileChanged(f"{piece.path.name} shrank while it was sent")
                    sock.sendall(view[:count])
                    left -= count
        elif piece:
            sock.sendall(piece)

    def lines(self, *, wait: bool) -> Iterator[bytes]:
        """Whole lines of the response: those received so far, or all of them.

        Raises OSError or h11.RemoteProtocolError if the connection was cut before the
        end of the response, and ApiError if its status is not 200.
        """
        while not self._answered:
            event = self._http.next_event()
            if event is h11.NEED_DATA:
                data = self._receive(wait=wait)
                if data is None:
                    return
                self._http.receive_data(data)
            elif isinstance(event, h11.Response) and event.status_code != 200:
                self._raise_refusal(event)
            elif isinstance(event, h11.Data):
                *lines, self._rest = (self._rest + event.data).split(b"\n")
                if len(self._rest) > MAX_LINE_BYTES:
                    raise unexpected(
                        self._head(200, ()),
                        f"has a line of more than {MAX_LINE_BYTES} bytes",
                    )
                yield from lines
            elif isinstance(event, h11.EndOfMessage):
                self._answered = True

    def end(self, *, sent: bool) -> None:
        """End the request; close the connection if the body was not `sent` whole."""
        # h11's state is another one if the server wants to close the connection.
        if sent and self._answered and self._http.their_state is h11.DONE:
            self._http.start_next_cycle()
        else:
            self.close()

    def abort(self) -> None:
        """Close the connection permanently, even while another thread uses it."""
        self._aborted = True
        self.close()

    def close(self) -> None:
        """Close the connection; the next request opens another."""
        sock, self._socket = self._socket, None
        if sock is None:
            return
        try:
            sock.shutdown(socket.SHUT_RDWR)
        except OSError:  # gone already
            pass
        finally:
            sock.close()

    def _connect(self) -> socket.socket:
        self._endpoint.check()
        url = self._endpoint.url
        secure = url.scheme == "https"
        port = url.port or (443 if secure else 80)
        sock = socket.create_connection(
            (url.host, port), self._endpoint.timeout.connect
        )
        sock.settimeout(self._endpoint.timeout.read)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if not secure:
            return sock
        return httpx.create_ssl_context().wrap_socket(sock, server_hostname=url.host)

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise ConnectionError("the connection was closed")
        return self._socket

    def _receive(self, *, wait: bool) -> bytes | None:
        """Bytes of the response, b"" at its end; None if none have arrived."""
        sock = self._open_socket()
        if wait:
            return sock.recv(_CHUNK_BYTES)
        sock.settimeout(0)
        try:
            return sock.recv(_CHUNK_BYTES)
        except _NOTHING_THERE:
            return None
        finally:
            sock.settimeout(self._endpoint.timeout.read)

    def _raise_refusal(self, refusal: h11.Response) -> None:
        head = self._head(refusal.status_code, refusal.headers)
        raise error_of(whole(head, self._body(), MAX_JSON_BYTES))

    def _head(
        self, status: int, headers: Iterable[tuple[bytes, bytes]]
    ) -> httpx.Response:
        request = httpx.Request("POST", self._endpoint.url)
        return httpx.Response(status, headers=list(headers), request=request)

    def _body(self) -> Iterator[bytes]:
        while not isinstance(event := self._http.next_event(), h11.EndOfMessage):
            if event is h11.NEED_DATA:
                self._http.receive_data(self._receive(wait=True) or b"")
            elif isinstance(event, h11.Data):
                yield bytes(event.data)
