"""A client with async methods can use the same descriptions of calls."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TypeVar

import httpx
import pytest

import unghost
from tests.support import frames
from tests.support.servers import RunningServer
from tests.support.threads import in_thread
from unghost import wire
from unghost.client.api import Api
from unghost.client.call import Call, Listing, query_of
from unghost.client.errors import error_of

T = TypeVar("T")


class AsyncClient(Api):
    """An async client that sends each call once and reads each response completely."""

    def __init__(self, http: httpx.AsyncClient) -> None:
        self._http = http

    async def _send(self, call: Call[T]) -> T:
        response = await self._http.request(
            call.method,
            call.path,
            params=query_of(call.params),
            json=call.json,
            files=call.files,
            content=call.content,
            headers=call.headers,
        )
        if response.is_success:
            return call.read(response)
        raise error_of(response)

    async def _pages(self, listing: Listing[T]) -> AsyncIterator[T]:
        cursor: str | None = None
        while True:
            page = await self._send(listing.page(cursor))
            for item in page.items:
                yield item
            cursor = page.next_cursor
            if cursor is None:
                return


@asynccontextmanager
async def connected(server: RunningServer) -> AsyncIterator[AsyncClient]:
    headers = {"Authorization": f"Bearer {server.token}"}
    async with httpx.AsyncClient(base_url=server.url, headers=headers) as http:
        yield AsyncClient(http)


def test_async_client_awaits_a_call(server, client, filled):
    async def ask() -> unghost.Dataset:
        async with connected(server) as asking:
            dataset: unghost.Dataset = await asking.dataset(filled)
            with pytest.raises(unghost.NotFound):
                await asking.dataset("nowhere")
            return dataset

    assert in_thread(asyncio.run, ask()) == client.dataset(filled)


def test_async_client_iterates_over_pages(server, client, filled):
    async def ask() -> list[wire.FrameSummary]:
        async with connected(server) as asking:
            frames: AsyncIterator[wire.FrameSummary] = asking.frames(filled, limit=2)
            return [frame async for frame in frames]

    found = in_thread(asyncio.run, ask())

    assert len(found) == 3
    assert found == list(client.frames(filled))


def test_async_client_sends_form_json_and_yaml_calls(server, client, dataset):
    async def ask() -> tuple[
        unghost.StoredFrame, unghost.Review, unghost.ConfigVersion
    ]:
        async with connected(server) as asking:
            stored: wire.StoredFrame = await asking.put_frame(
                dataset, "a", frames.annotation(), image=frames.image()
            )
            box = stored.decisions[0].box_id
            review: wire.Review = await asking.review(box, "keep", seen_revision=0)
            version: wire.ConfigVersion = await asking.add_config(
                dataset, "min_visible_pixels: 7"
            )
            return stored, review, version

    stored, review, version = in_thread(asyncio.run, ask())

    assert stored.created
    assert client.box(review.box_id).review.verdict == "keep"
    assert client.config(version.digest).config["min_visible_pixels"] == 7
