"""What the service answers has every field of its model, and the client reads each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.api.event_reader import parsed
from tests.support.servers import RunningServer
from unghost import Client, wire
from unghost.wire.model import ResponseModel


@pytest.fixture
def http(server: RunningServer) -> Iterator[httpx.Client]:
    with httpx.Client(
        base_url=server.url, headers=server.headers, trust_env=False, timeout=60
    ) as client:
        yield client


def said(answer: httpx.Response) -> Any:
    assert answer.is_success, answer.text
    return answer.json()


def assert_answered_by(kind: type[ResponseModel], raw: Any) -> None:
    """No key is missing and none is new, at any depth, and the client reads the same.

    The service cannot forget one: fields of answers have no defaults.
    """
    checked = kind.model_validate(raw)

    assert checked.model_dump(mode="json") == raw
    assert kind.read(raw) == checked


def assert_told_by(kind: type[ResponseModel], stream: httpx.Response) -> None:
    """The data of each event of a stream is answered in full."""
    told = list(parsed(iter(stream.text.splitlines())))

    assert told[-1].name == "end"
    for event in told:
        assert_answered_by(kind, event.data)


def test_tokens_and_codes_are_answered_in_full(http):
    token = said(http.post("/api/v1/tokens", json={"name": "in-full"}))
    code = said(http.post("/api/v1/login-codes", json={}))
    number = code["id"]

    assert_answered_by(wire.NewToken, token)
    assert_answered_by(wire.Page[wire.Token], said(http.get("/api/v1/tokens")))
    assert_answered_by(wire.NewLoginCode, code)
    assert_answered_by(wire.LoginCode, said(http.get(f"/api/v1/login-codes/{number}")))
    opened = said(http.post("/api/v1/session", json={"code": code["code"]}))
    assert_answered_by(wire.NewSession, opened)
    assert_answered_by(wire.LoginCode, said(http.get(f"/api/v1/login-codes/{number}")))


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/api/v1/session", wire.Session),
        ("/api/v1/audit", wire.Page[wire.AuditEntry]),
        ("/version", wire.Version),
        ("/readyz", wire.Ready),
        ("/healthz", wire.Alive),
    ],
)
def test_who_asks_and_who_answers_is_answered_in_full(http, path, kind):
    assert_answered_by(kind, said(http.get(path)))


def test_quality_and_channels_are_answered_in_full(http, server, client, filled):
    boxes = list(client.boxes(filled))
    for box, answer in zip(boxes, ["keep", "reject"] * len(boxes), strict=False):
        client.review(box.box_id, answer, seen_revision=0)
    made = client.create_token(f"second-{filled}", "reviewer")
    with Client(server.url, made.token) as second:
        for box in boxes:
            second.review(box.box_id, "keep", seen_revision=1)
        second.review(boxes[0].box_id, "reject", seen_revision=2)
    at = f"/api/v1/datasets/{filled}"

    quality = said(http.get(f"{at}/quality"))
    evaluation = said(http.get(f"{at}/evaluations", params={"truth": "people"}))

    assert quality["suggested"]
    assert quality["agreement"]["pairs"]
    assert_answered_by(wire.Quality, quality)
    assert evaluation["channels"]["semantic"]["worst"]
    assert_answered_by(wire.Evaluation, evaluation)


def test_configurations_and_what_they_would_decide_are_answered_in_full(http, filled):
    at = f"/api/v1/datasets/{filled}"
    stricter = {"min_visible_pixels": 10**6}

    version = said(http.post(f"{at}/configs", json=stricter))
    digest = version["digest"]
    preview = said(http.post(f"{at}/preview", json={"config": stricter}))
    other_pixels = {"config": {"evidence": "lidar"}}

    assert_answered_by(wire.ConfigVersion, version)
    assert_answered_by(wire.ConfigVersion, said(http.get(f"/api/v1/configs/{digest}")))
    assert_answered_by(wire.ConfigVersion, said(http.get(f"{at}/config")))
    assert_answered_by(wire.Page[wire.ConfigVersion], said(http.get(f"{at}/configs")))
    assert preview["flips"]["items"]
    assert_answered_by(wire.Preview, preview)
    unknown = said(http.post(f"{at}/preview", json=other_pixels))
    assert unknown["needs_pixels"]
    assert_answered_by(wire.Preview, unknown)


def test_runs_and_what_they_change_are_answered_in_full(http, client, filled):
    at = f"/api/v1/datasets/{filled}"
    wanted = {"config": {"min_visible_pixels": 10**6}, "activate": True}

    started = said(http.post(f"{at}/runs", json=wanted))
    client.wait(started["id"])
    run = f"/api/v1/runs/{started['id']}"

    assert_answered_by(wire.Run, started)
    assert_answered_by(wire.Run, said(http.get(run)))
    assert_answered_by(wire.Page[wire.Run], said(http.get(f"{at}/runs")))
    assert_told_by(wire.Run, http.get(f"{run}/events"))
    diff = said(http.get(f"{run}/diff", params={"limit": 2}))
    assert diff["next_cursor"] is not None
    assert_answered_by(wire.Diff, diff)


def test_exports_are_answered_in_full(http, client, filled):
    at = f"/api/v1/datasets/{filled}/exports"

    started = said(http.post(at, json={"format": "yolo", "options": {"bands": [50]}}))
    client.wait_for_export(started["id"])
    export = f"/api/v1/exports/{started['id']}"

    assert_answered_by(wire.Export, started)
    assert_answered_by(wire.Export, said(http.get(export)))
    assert_answered_by(wire.Page[wire.Export], said(http.get(at)))
    assert_told_by(wire.Export, http.get(f"{export}/events"))
    link = said(http.post(f"{export}/download-links", json={}))
    assert_answered_by(wire.DownloadLink, link)


def test_a_preview_that_needs_pixels_says_nothing_of_flips(client, filled):
    preview = client.preview(filled, {"evidence": "lidar"})

    assert preview.needs_pixels
    assert (preview.flips, preview.counts) == (None, None)
