"""Histories, problems and the end of a cut batch have every field of their model."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import pytest

from tests.support import archives, plain_http
from tests.support.response_checks import assert_matches_model
from tests.support.servers import RunningServer
from unghost import wire

BASE = "/api/v1"


@pytest.fixture
def http(server: RunningServer) -> Iterator[httpx.Client]:
    with plain_http.Client(
        base_url=server.url + BASE, headers=server.headers, timeout=60
    ) as client:
        yield client


def test_last_line_for_a_truncated_archive_has_every_field(http, dataset):
    whole = archives.tar_archive([*archives.frame("a"), *archives.frame("b")])
    told = http.post(
        f"/datasets/{dataset}/batches",
        content=whole[: len(whole) // 2],
        headers={"Content-Type": "application/x-tar"},
    )
    end = json.loads(told.text.splitlines()[-1])

    assert end["problem"]["status"] == 422
    assert_matches_model(wire.BatchEnd, end)
