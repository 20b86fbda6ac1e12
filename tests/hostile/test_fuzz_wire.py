"""Fuzzing of what clients send: archives, forms, cursors, ranges, entity tags."""

import asyncio
import base64
import json
from contextlib import suppress
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from app.errors import AppError
from app.http.bodies import read_parts
from app.ingest.tar import TarLimits, TarStream
from tests.support import archives
from tests.support import frames as scene
from tests.support.hostile.mutations import (
    EXAMPLES,
    damaged,
    fuzz_settings,
    little_memory,
)
from tests.support.hostile.openapi_cases import DATASET
from tests.support.hostile.wire_samples import ARCHIVES, FORM, MEDIA_TYPE
from tests.support.threads import in_thread

pytestmark = pytest.mark.long

LIMITS = TarLimits(max_archive_bytes=10**7, max_member_bytes=20_000, max_members=50)
on_a_server = settings(
    max_examples=max(EXAMPLES // 2, 1),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@fuzz_settings
@given(content=damaged(ARCHIVES), cut=st.integers(1, 5000))
def test_any_archive_in_chunks_of_any_size_is_read_or_refused(content, cut):
    stream = TarStream(LIMITS)
    with little_memory(), suppress(AppError):
        for start in range(0, len(content), cut):
            for name, _ in stream.feed(content[start : start + cut]):
                assert ".." not in name.split("/")
        stream.close()


media_types = damaged(
    [MEDIA_TYPE.encode(), b'multipart/form-data; boundary="a\\"b"']
).map(lambda content: content.decode("latin-1"))


@fuzz_settings
@given(content=damaged([FORM]), media_type=st.one_of(st.just(MEDIA_TYPE), media_types))
@example(FORM, "multipart/form-data; boundary*=utf-8''%ff")
@example(FORM, "multipart/form-data; boundary=" + "x" * 5000)
@example(FORM, "multipart/form-data; boundary=ü")
def test_any_multipart_form_is_read_or_refused(content, media_type):
    async def stream():
        for start, end in pairwise([*range(0, len(content), 500), len(content)]):
            yield content[start:end]

    with little_memory(), suppress(AppError):
        reading = read_parts(media_type, stream(), max_parts=16, max_part_bytes=20_000)
        in_thread(asyncio.run, reading)


def check_no_server_error(response):
    """Check that the answer is not a 5xx, and that an error is a problem document."""
    assert response.status_code < 500, response.text
    if response.status_code >= 400:
        problem = response.json()
        assert problem["status"] == response.status_code
        assert problem["code"] != "internal"
    return response


CURSORS = [
    base64.urlsafe_b64encode(json.dumps(place).encode())
    for place in ([0, 12.5, 1, 7], [1, 1e308, 3, 2**62], [0, -1, 0, 1])
]
cursors = st.one_of(
    damaged([*CURSORS, b"12.5~7", b"run/1", b"17", b"nan~1", b"inf~9"]),
    st.lists(
        st.one_of(st.integers(), st.floats(), st.text(max_size=3)), max_size=5
    ).map(lambda place: base64.urlsafe_b64encode(json.dumps(place).encode())),
).map(lambda content: content.decode("latin-1"))
LISTS = (
    "/boxes?dataset={name}&sort=id",
    "/boxes?dataset={name}&sort=doubt",
    "/boxes?dataset={name}&sort=match_percent",
    "/boxes?dataset={name}&sort=-match_percent",
    "/boxes?dataset={name}&sort=crowding",
    "/datasets/{name}/frames?sort=key",
    "/datasets/{name}/frames?sort=-id",
    "/datasets/{name}/runs?limit=1",
    "/runs/{run}/diff?limit=1",
    "/tokens?limit=1",
    "/datasets?limit=1",
)


@on_a_server
@given(cursor=cursors, path=st.sampled_from(LISTS))
@example("=" * 3, LISTS[1])
@example(base64.urlsafe_b64encode(b"[" * 1400).decode(), LISTS[1])
@example(base64.urlsafe_b64encode(b"[1e999,1,1,1]").decode(), LISTS[1])
@example("9" * 1999, LISTS[6])
@example("\x00", LISTS[5])
def test_any_cursor_returns_a_page_or_is_refused(api, last_run, cursor, path):
    url = "/api/v1" + path.format(name=DATASET, run=last_run)
    check_no_server_error(api.http.get(f"{url}", params={"cursor": cursor}))


@pytest.fixture(scope="module")
def last_run(api):
    return api.json(f"/datasets/{DATASET}/runs", limit=1)["items"][0]["id"]


visible = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40)
ranges = st.one_of(
    visible,
    visible.map("bytes={}".format),
    st.tuples(st.integers(), st.integers()).map("bytes={0[0]}-{0[1]}".format),
    st.sampled_from(
        [
            "bytes=0-0,2-3",
            "bytes=--1",
            "bytes=-0",
            "bytes=0-" + "9" * 4999,
            "bytes= 1 - 2",
        ]
    ),
)
TAGS = st.one_of(visible, st.sampled_from(["*", "W/*", '"', '"a", W/"b"', ",,,"]))


@on_a_server
@given(
    byte_range=ranges,
    etag=st.one_of(st.none(), TAGS),
    if_range=st.one_of(st.none(), TAGS),
)
def test_any_range_and_etag_return_file_bytes_or_are_refused(
    api, byte_range, etag, if_range
):
    chosen = {"Range": byte_range, "If-None-Match": etag, "If-Range": if_range}
    headers = {name: text.strip() for name, text in chosen.items() if text is not None}
    frame = api.json(f"/datasets/{DATASET}/frames", limit=1)["items"][0]["id"]
    response = check_no_server_error(
        api.http.get(f"/api/v1/frames/{frame}/image", headers=headers)
    )
    whole = scene.image()
    if response.status_code == 200:
        assert response.content == whole
    if response.status_code == 206:
        assert response.content in whole


@on_a_server
@given(content=damaged(ARCHIVES))
def test_any_archive_is_answered_without_a_server_error(api, content):
    response = check_no_server_error(
        archives.send(api, DATASET, content, replace="true")
    )
    if response.status_code == 200:
        *lines, end = archives.lines_of(response.text)
        assert end["end"]
        assert end["frames"] == len(lines)
        assert {line["status"] for line in lines} <= {200, 201, 409, 413, 422}
        assert end.get("problem", {"status": 422})["status"] < 500


@on_a_server
@given(content=damaged([FORM]))
def test_any_multipart_form_is_answered_without_a_server_error(api, content):
    check_no_server_error(
        api.http.put(
            f"/api/v1/datasets/{DATASET}/frames/fuzzed?replace=true",
            content=content,
            headers={"Content-Type": MEDIA_TYPE},
        )
    )
