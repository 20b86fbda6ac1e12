"""Counts for Prometheus: by route, never by what somebody asked for."""

from __future__ import annotations

import re

from app.metrics import RequestMetrics

LINE = re.compile(r"(# (HELP|TYPE) \w+ .+|\w+(\{(\w+=\"[^\"\n\\]*\",?)+\})? [0-9.e+]+)")


def test_answers_are_counted_by_route_and_status(serve):
    with serve().admin() as client:
        for number in (1, 2, 3):
            client.get(f"/probe/items/{number}")
        client.get("/probe/items/none")
        text = client.get("/metrics").text

    route = 'method="GET",route="/probe/items/{item_id}"'
    assert f'unghost_requests_total{{{route},status="200"}} 3' in text
    assert f'unghost_requests_total{{{route},status="422"}} 1' in text
    assert f'unghost_request_seconds_bucket{{{route},le="+Inf"}} 4' in text
    assert f"unghost_request_seconds_count{{{route}}} 4" in text


def test_what_has_no_route_is_counted_together(serve):
    with serve().admin() as client:
        client.get('/nowhere"}')
        client.request("PROPFIND", "/nowhere")
        text = client.get("/metrics").text

    assert 'unghost_requests_total{method="GET",route="other",status="404"} 1' in text
    assert 'method="other",route="other"' in text
    assert "nowhere" not in text


def test_every_line_is_one_that_prometheus_reads(admin):
    admin.get("/healthz")

    answer = admin.get("/metrics")

    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert [line for line in answer.text.splitlines() if not LINE.fullmatch(line)] == []


def test_durations_fall_into_their_buckets():
    metrics = RequestMetrics("1")
    for seconds in (0.005, 0.2, 99.0):
        metrics.observe("GET", "/a", 200, seconds)

    found = re.findall(r'le="(.+?)"} (\d+)', metrics.text())

    assert dict(found) == {
        "0.005": "1",
        "0.025": "1",
        "0.1": "1",
        "0.25": "2",
        "0.5": "2",
        "1.0": "2",
        "2.5": "2",
        "10.0": "2",
        "60.0": "2",
        "+Inf": "3",
    }
