"""Runs the service with the probe routes added, in a thread of this process."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI
from sqlalchemy import event
from sqlalchemy.orm import Session, SessionTransaction

from app.engine.local import LocalEngine
from app.main import create_app
from app.runs.measure import COMMIT_EVERY_S
from app.serve import listen, server_config
from app.settings import Settings
from tests.support import plain_http, probe_routes
from tests.support.databases import give_tables, settings_of
from tests.support.waiting import PATIENCE_S


@dataclass(frozen=True)
class Live:
    """A running service, and its application for tests to look into."""

    app: FastAPI
    settings: Settings
    url: str

    @property
    def token(self) -> str:
        return self.settings.token_file.read_text().strip()

    @property
    def bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}

    def client(self, **headers: str) -> httpx.Client:
        """A client that sends these headers only."""
        return plain_http.Client(base_url=self.url, headers=headers)

    def admin(self) -> httpx.Client:
        """A client that sends the first token."""
        return self.client(**self.bearer)


@contextmanager
def block_jobs(engine: LocalEngine) -> Iterator[None]:
    """Keep the one thread for jobs busy, so that jobs wait during the block."""
    done = threading.Event()

    def rest() -> None:
        done.wait(120)

    engine.submit(rest)
    try:
        yield
    finally:
        done.set()


@contextmanager
def hold_frames() -> Iterator[threading.Semaphore]:
    """Let runs measure only as many frames as the semaphore permits, until the end.

    Each frame needs a permit when its file is read. The clock of the threads that run
    jobs is ahead by the interval of commits at each reading, so that each frame is
    stored as soon as it is measured.
    """
    permits, readings = threading.Semaphore(0), count()
    read, clock = Path.read_bytes, time.monotonic

    def read_if_permitted(path: Path) -> bytes:
        if threading.current_thread().name.startswith("pixels"):
            permits.acquire(timeout=PATIENCE_S)
        return read(path)

    def hurried() -> float:
        if threading.current_thread().name.startswith(("jobs", "chunks")):
            return clock() + COMMIT_EVERY_S * next(readings)
        return clock()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_bytes", read_if_permitted)
        patch.setattr(time, "monotonic", hurried)
        try:
            yield permits
        finally:
            permits.release(10_000)


@contextmanager
def hold_writes(thread: str) -> Iterator[threading.Semaphore]:
    """Let a thread begin only as many transactions that write as the semaphore permits.

    It waits before it has any lock.
    """
    permits = threading.Semaphore(0)

    def wait(session: Session, transaction: SessionTransaction) -> None:
        writes = session.get_bind().get_execution_options().get("writes", False)
        is_wanted = threading.current_thread().name == thread
        if is_wanted and writes and transaction.parent is None:
            permits.acquire(timeout=PATIENCE_S)

    event.listen(Session, "after_transaction_create", wait)
    try:
        yield permits
    finally:
        event.remove(Session, "after_transaction_create", wait)
        permits.release(10_000)


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.tried = threading.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        try:
            await super().startup(sockets)
        finally:
            self.tried.set()


_documents: list[dict[str, Any]] = []
"""The OpenAPI document, once a service of this process has made it in a second."""


@contextmanager
def live(data: Path, **chosen: Any) -> Iterator[Live]:
    """Serve this data folder with these settings until the block ends."""
    give_tables(data, chosen)
    settings = Settings(data=data, **{**settings_of(data), **chosen})
    app = create_app(settings)
    app.include_router(probe_routes.router)
    app.include_router(probe_routes.open_router)
    app.openapi_schema = next(iter(_documents), None)
    server = _Server(server_config(app))
    with listen("127.0.0.1", 0) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            assert server.tried.wait(60)
            assert server.started
            yield Live(app, settings, f"http://127.0.0.1:{listener.getsockname()[1]}")
        finally:
            server.should_exit = True
            thread.join()
            if app.openapi_schema is not None:
                _documents[:] = [app.openapi_schema]
