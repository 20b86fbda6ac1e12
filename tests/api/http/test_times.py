"""All times in answers have the same format, whichever route sends them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

RFC_3339_UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")
KEYS = ("at", "created_at", "started_at", "finished_at")


def times_in(value: Any) -> Iterator[str]:
    if isinstance(value, list):
        for one in value:
            yield from times_in(one)
    if isinstance(value, dict):
        yield from (value[key] for key in KEYS if value.get(key))
        for one in value.values():
            yield from times_in(one)


def test_times_have_the_same_rfc_3339_utc_format_everywhere(api):
    dataset = api.dataset()
    stored = api.upload_frame(dataset, "a")
    api.put(dataset, "b", b"[]")
    box = stored["decisions"][0]["box_id"]
    api.review(box, "keep")
    digest = api.json(f"/datasets/{dataset}/config")["digest"]
    started = api.post(f"/datasets/{dataset}/runs", {"config": digest})
    run = api.wait_for_job(started)
    export = api.post(f"/datasets/{dataset}/exports", {"format": "yolo"})

    answers = [stored, started.json(), run, export.json()]
    answers.append(api.json(f"/frames/{stored['frame']['id']}"))
    answers.append(api.json(f"/boxes/{box}/history"))
    answers += [
        api.json(f"/datasets/{dataset}{path}")
        for path in ("", "/frames", "/runs", "/configs", "/config", "/problems")
    ]

    for answer in answers:
        found = list(times_in(answer))
        assert found, answer
        assert [time for time in found if not RFC_3339_UTC.fullmatch(time)] == []
    assert (
        api.json(f"/frames/{stored['frame']['id']}")["created_at"]
        == (stored["frame"]["created_at"])
    )
