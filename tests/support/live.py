"""Runs the service with the probe routes added, in a thread of this process."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI

from app.engine.local import LocalEngine
from app.main import create_app
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
def hold_frames(engine: LocalEngine) -> Iterator[threading.Semaphore]:
    """Let runs measure only as many frames as the semaphore permits, until the end.

    Each frame is stored as soon as it is measured.
    """
    permits, start = threading.Semaphore(0), engine.start

    def measure(work: Callable[[Any], Any], frame: Any) -> Any:
        permits.acquire(timeout=PATIENCE_S)
        return work(frame)

    def start_held(work: Callable[[Any], Any], frame: Any) -> Future[Any]:
        return start(partial(measure, work), frame)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.runs.measure.COMMIT_EVERY_S", 0)
        patch.setattr(engine, "start", start_held)
        try:
            yield permits
        finally:
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


@contextmanager
def live(data: Path, **chosen: Any) -> Iterator[Live]:
    """Serve this data folder with these settings until the block ends."""
    give_tables(data, chosen)
    settings = Settings(data=data, **{**settings_of(data), **chosen})
    app = create_app(settings)
    app.include_router(probe_routes.router)
    app.include_router(probe_routes.open_router)
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
