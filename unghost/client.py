"""The client of the REST API: one method per endpoint, typed results, no cleverness."""

from __future__ import annotations

from types import TracebackType
from typing import Final, TypeVar

import httpx

from unghost.calls.boxes import BoxCalls
from unghost.calls.configs import ConfigCalls
from unghost.calls.datasets import DatasetCalls
from unghost.calls.exports import ExportCalls
from unghost.calls.frames import FrameCalls
from unghost.calls.health import HealthCalls
from unghost.calls.people import PeopleCalls
from unghost.calls.pictures import PictureCalls
from unghost.calls.quality import QualityCalls
from unghost.calls.runs import RunCalls
from unghost.discovery import find_server
from unghost.retry import RetryPolicy
from unghost.transport import Transport

# A frame is decided while its upload waits, and a busy server does one after another.
DEFAULT_TIMEOUT: Final = httpx.Timeout(60.0, connect=5.0)
_PATIENCE: Final = RetryPolicy()

ClientT = TypeVar("ClientT", bound="Client")


class Client(
    DatasetCalls,
    FrameCalls,
    PictureCalls,
    BoxCalls,
    ConfigCalls,
    RunCalls,
    ExportCalls,
    PeopleCalls,
    QualityCalls,
    HealthCalls,
):
    """A connection to an Unghost server.

    Without arguments it talks to the server of `UNGHOST_SERVER`, else the one on this
    machine, and finds that one's token by itself. Safe to use from many threads.

        with Client() as client:
            for box in client.boxes("town10", verdict="rejected"):
                print(box.frame, box.id, box.explanation)
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        timeout: float | httpx.Timeout = DEFAULT_TIMEOUT,
        retry: RetryPolicy = _PATIENCE,
    ) -> None:
        server = find_server(url, token)
        self.url = server.url
        self.token = server.token
        self._transport = Transport(server, timeout=timeout, retry=retry)

    def __repr__(self) -> str:
        # Without the token: representations end in logs.
        return f"Client({self.url!r})"

    def __enter__(self: ClientT) -> ClientT:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()
