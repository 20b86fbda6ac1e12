"""Exports over HTTP: written in the background, downloaded in parts."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile

import pytest

from tests.api import frames as scene
from tests.api.long_streets import FROM_PIXELS, fill
from tests.api.resources import BASE

FRAMES = 5


@pytest.fixture(scope="module")
def dataset(server):
    from tests.api.resources import Api

    api = Api.at(server.url, server.headers)
    with api.http:
        name = api.dataset()
        for number in range(FRAMES):
            api.stored(name, f"{number}", {**scene.annotation(), "number": number})
        return name


def exported(api, dataset, form="yolo", **options):
    answer = api.post(
        f"/datasets/{dataset}/exports", {"format": form, "options": options}
    )
    assert answer.json()["state"] in ("queued", "running", "done")
    return api.finished(answer)


@pytest.fixture
def export(api, dataset):
    return exported(api, dataset)


def download(api, export, **headers):
    return api.http.get(export["download"], headers=headers)


def test_an_export_says_how_far_it_is_and_what_came_out(api, dataset, export):
    assert (export["state"], export["done"], export["total"]) == (
        *("done", FRAMES),
        FRAMES,
    )
    content = download(api, export).content
    assert (len(content), hashlib.sha256(content).hexdigest()) == (
        export["size_bytes"],
        export["sha256"],
    )
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        manifest = json.loads(archive.read("manifest.json"))
    assert manifest["counts"] == export["counts"]
    assert (manifest["dataset"], manifest["frames"]) == (dataset, FRAMES)


def test_the_same_state_is_the_same_file(api, dataset, export):
    again = exported(api, dataset)
    other = exported(api, dataset, images="none")

    assert again["id"] != export["id"]
    assert again["sha256"] == export["sha256"] != other["sha256"]


def test_a_download_goes_on_where_it_stopped(api, export):
    whole = download(api, export)
    tag, size = whole.headers["etag"], len(whole.content)

    first = download(api, export, Range="bytes=0-99")
    rest = download(api, export, **{"Range": "bytes=100-", "If-Range": tag})
    last = download(api, export, Range="bytes=-10")

    assert tag == f'"{export["sha256"]}"'
    assert whole.headers["accept-ranges"] == "bytes"
    assert [part.status_code for part in (first, rest, last)] == [206] * 3
    assert first.content + rest.content == whole.content
    assert rest.headers["content-range"] == f"bytes 100-{size - 1}/{size}"
    assert last.content == whole.content[-10:]


@pytest.mark.parametrize("span", ["bytes=0-99", "bytes=999999999-"])
def test_a_part_of_another_file_is_not_continued(api, export, span):
    """A range beyond the end used to be refused, whatever it was a range of."""
    whole = download(api, export)

    stale = download(api, export, **{"Range": span, "If-Range": '"other"'})

    assert (stale.status_code, stale.content) == (200, whole.content)


def test_what_is_known_is_not_sent_again(api, export):
    tag = download(api, export).headers["etag"]

    known = download(api, export, **{"If-None-Match": tag})
    beyond = download(api, export, Range="bytes=999999999-")

    assert (known.status_code, known.content) == (304, b"")
    assert beyond.status_code == 416


def test_an_export_waits_its_turn_and_can_be_cancelled(start_api):
    server, api = start_api(UNGHOST_WORKERS="1")
    dataset = fill(api, 40)
    run = api.post(f"/datasets/{dataset}/runs", {"config": FROM_PIXELS})
    answer = api.post(f"/datasets/{dataset}/exports", {"format": "yolo"})
    url = answer.headers["location"]
    early = api.http.get(f"{url}/download")

    cancelled = api.http.post(f"{url}/cancel")
    again = api.http.post(f"{url}/cancel")
    following = exported(api, dataset)

    assert (early.status_code, early.json()["code"]) == (409, "export_not_done")
    assert (cancelled.status_code, cancelled.json()["state"]) == (202, "cancelled")
    assert (again.status_code, again.json()["code"]) == (409, "export_over")
    assert (following["state"], following["done"]) == ("done", 40)
    assert api.finished(run)["state"] == "done"
    assert api.http.get(url).json() == cancelled.json()
    assert "Traceback" not in server.log.read_text("utf-8")


def test_an_export_goes_on_after_the_server_was_killed(start_api):
    server, api = start_api(UNGHOST_WORKERS="1")
    dataset = fill(api, 30)
    before = exported(api, dataset)
    answer = api.post(f"/datasets/{dataset}/exports", {"format": "yolo"})
    server.process.kill()
    server.process.wait()

    _, api = start_api()
    after = api.finished(answer)

    assert (after["state"], after["sha256"]) == ("done", before["sha256"])
    assert hashlib.sha256(download(api, after).content).hexdigest() == after["sha256"]


def test_there_is_nothing_to_cancel_or_to_download(api):
    assert api.post("/exports/999999/cancel").status_code == 404
    assert api.get("/exports/999999/download").status_code == 404
    assert api.http.get(f"{BASE}/exports/999999").status_code == 404
