"""Exports over HTTP: written in the background, downloaded in parts."""

import hashlib
import io
import json
import zipfile
from datetime import datetime, timedelta, timezone
from itertools import chain

import pytest

from app.access.service import MOST_LINKS
from app.db.tables import Export
from app.engine.local import CHUNK_FRAMES
from app.storage.durable import MAINTENANCE_LOCK, locked
from app.storage.room import DeletionSignal
from tests.support import databases, plain_http
from tests.support.api import BASE, Api
from tests.support.archives import frame, send, tar_archive
from tests.support.data_folders import blobs
from tests.support.live import block_jobs, hold_frames
from tests.support.response_checks import assert_matches_model
from tests.support.slow_datasets import FROM_PIXELS
from tests.support.waiting import until
from unghost import wire

CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}
FRAMES = 5
SOME_FORMATS = ("coco", "decisions-csv", "decisions-jsonl")


@pytest.fixture(scope="module")
def dataset(server):
    api = Api.at(server.url, server.headers)
    with api.http:
        return api.dataset_of_frames(FRAMES)


def run_export(api, dataset, form="yolo", **options):
    response = api.post(
        f"/datasets/{dataset}/exports", {"format": form, "options": options}
    )
    assert response.json()["state"] in ("queued", "running", "done")
    return api.wait_for_job(response)


@pytest.fixture(scope="module")
def export(api, dataset):
    return run_export(api, dataset)


def download(api, export, **headers):
    return api.http.get(export["download"], headers=headers)


def test_export_has_progress_size_digest_and_counts(api, dataset, export):
    """An export of the same state gives the same file."""
    again = run_export(api, dataset)
    other = run_export(api, dataset, images="none")

    assert (export["state"], export["done"], export["total"]) == (
        *("done", FRAMES),
        FRAMES,
    )
    content = download(api, export).content
    digest = hashlib.sha256(content).hexdigest()
    assert (len(content), digest) == (export["size_bytes"], export["sha256"])
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        manifest = json.loads(archive.read("manifest.json"))
    assert manifest["counts"] == export["counts"]
    assert (manifest["dataset"], manifest["frames"]) == (dataset, FRAMES)
    assert again["id"] != export["id"]
    assert again["sha256"] == export["sha256"] != other["sha256"]


def contents(api, dataset, **options):
    """The files of a new export, and its manifest."""
    archive = download(api, run_export(api, dataset, **options)).content
    with zipfile.ZipFile(io.BytesIO(archive)) as zipped:
        files = {name: zipped.read(name) for name in zipped.namelist()}
    return files, json.loads(files.pop("manifest.json"))


@pytest.fixture(scope="module")
def exports_around_a_run(api):
    """A dataset's exports by format, and those after a run that changed no verdict."""
    dataset = api.dataset_of_one_frame()
    before = {form: contents(api, dataset, form=form) for form in SOME_FORMATS}
    run = api.run(dataset, {}, activate=True)
    after = {form: contents(api, dataset, form=form) for form in SOME_FORMATS}
    return before, run["id"], after


@pytest.mark.parametrize("form", SOME_FORMATS)
def test_run_that_changes_no_verdict_changes_only_its_number_in_an_export(
    exports_around_a_run, form
):
    before, run, after = exports_around_a_run
    (files, manifest), (later, later_manifest) = before[form], after[form]

    assert later_manifest == {**manifest, "run": run} != manifest
    if form == "decisions-jsonl":
        lines = files["decisions.jsonl"]
        numbers = [f'"run":{number}'.encode() for number in (manifest["run"], run)]
        files = {**files, "decisions.jsonl": lines.replace(*numbers)}
        assert files["decisions.jsonl"] != lines
    assert later == files


def test_download_resumes_with_a_byte_range(api, export):
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


def test_queued_export_waits_and_can_be_cancelled_but_not_deleted(serve):
    service = serve()
    with service.admin() as http:
        api = Api(http)
        dataset = api.dataset_of_one_frame()
        with block_jobs(service.app.state.services.engine):
            run = api.post(f"/datasets/{dataset}/runs", {"config": CARS_ARE_SKY})
            response = api.post(f"/datasets/{dataset}/exports", {"format": "yolo"})
            url = response.headers["location"]
            early = http.get(f"{url}/download")

            refused = http.delete(url)
            cancelled = http.post(f"{url}/cancel")
            again = http.post(f"{url}/cancel")
        following = run_export(api, dataset)
        ran, ended = api.wait_for_job(run), http.get(url)
        deleted = http.delete(url)

    assert (early.status_code, early.json()["code"]) == (409, "export_not_done")
    assert (refused.status_code, refused.json()["code"]) == (409, "export_open")
    assert "is queued; cancel it first" in refused.json()["detail"]
    assert (cancelled.status_code, cancelled.json()["state"]) == (202, "cancelled")
    assert_matches_model(wire.Export, cancelled.json())
    assert (again.status_code, again.json()["code"]) == (409, "export_over")
    assert (following["state"], following["done"]) == ("done", 1)
    assert ran["state"] == "done"
    assert ended.json() == cancelled.json()
    assert deleted.status_code == 204


def test_short_export_does_not_wait_for_a_long_job(serve):
    with serve(workers=1).admin() as http:
        api = Api(http)
        short, long = api.dataset(), api.dataset()
        api.upload_frame(short, "a")
        frames = [frame(f"{number}") for number in range(CHUNK_FRAMES + 1)]
        send(api, long, tar_archive(chain.from_iterable(frames)))
        with hold_frames() as permits:
            run = api.post(f"/datasets/{long}/runs", {"config": FROM_PIXELS})
            waiting = api.post(f"/datasets/{long}/exports", {"format": "yolo"})
            export = api.post(f"/datasets/{short}/exports", {"format": "yolo"})
            until(lambda: state_of(http, export) == "done")
            states = [state_of(http, job) for job in (run, waiting)]
            permits.release(len(frames))

        assert states == ["running", "queued"]
        assert api.wait_for_job(waiting)["total"] == len(frames)


def state_of(http, accepted):
    return http.get(accepted.headers["location"]).json()["state"]


def test_missing_export_is_404_for_every_act(api):
    for act in ("cancel", "download-links"):
        assert api.post(f"/exports/999999/{act}", {}).status_code == 404
    for part in ("", "/download"):
        assert api.get(f"/exports/999999{part}").status_code == 404


def create_download_link(api, export):
    """Make a download link, which needs no token; return its URL, and the answer."""
    response = api.post(f"/exports/{export['id']}/download-links", {})
    assert response.status_code == 201, response.text
    return api.http.base_url.join(response.json()["url"]), response


def test_download_link_returns_the_file_of_one_export_without_a_token(
    api, dataset, export
):
    other = run_export(api, dataset)
    url, response = create_download_link(api, export)
    ends = datetime.fromisoformat(response.json()["expires_at"])

    whole = plain_http.get(url)
    rest = plain_http.get(url, headers={"Range": "bytes=100-"})
    wrong = plain_http.get(url.copy_with(path=f"{BASE}/exports/{other['id']}/file"))
    key = {"Authorization": f"Bearer {url.params['key']}"}
    elsewhere = plain_http.get(api.http.base_url.join("/version"), headers=key)

    assert response.headers["cache-control"] == "no-store"
    assert timedelta(0) < ends - datetime.now(timezone.utc) <= timedelta(minutes=5)
    assert hashlib.sha256(whole.content).hexdigest() == export["sha256"]
    assert "attachment" in whole.headers["content-disposition"]
    assert (rest.status_code, rest.content) == (206, whole.content[100:])
    assert (wrong.status_code, wrong.json()["code"]) == (401, "link_over")
    assert elsewhere.status_code == 401


def test_download_link_expires_and_ends_with_its_revoked_token(server, api, export):
    viewer = api.post("/tokens", {"name": "downloader", "role": "viewer"}).json()
    ada = Api.at(server.url, {"Authorization": f"Bearer {viewer['token']}"})
    with ada.http:
        gone, _ = create_download_link(ada, export)
    late, _ = create_download_link(api, export)
    assert plain_http.get(gone).status_code == 200

    api.http.delete(f"{BASE}/tokens/{viewer['id']}")
    ended = "expires_at = '2001-01-01 00:00:00'"
    digest = hashlib.sha256(late.params["key"].encode()).hexdigest()
    databases.change(
        server.data, f"update download_links set {ended} where hash = :one", one=digest
    )

    codes = [plain_http.get(url).json()["code"] for url in (gone, late)]
    assert codes == ["link_over", "link_over"]


def test_oldest_download_link_of_a_token_is_deleted_over_the_limit(server, api, export):
    others, _ = create_download_link(api, export)
    viewer = api.post("/tokens", {"name": "greedy", "role": "viewer"}).json()
    greedy = Api.at(server.url, {"Authorization": f"Bearer {viewer['token']}"})
    with greedy.http:
        made = [create_download_link(greedy, export)[0] for _ in range(MOST_LINKS + 1)]

    statuses = [
        plain_http.head(url).status_code for url in (made[0], made[1], made[-1], others)
    ]
    assert statuses == [401, 200, 200, 200]


def stored(service, export):
    """Whether the file of an export exists."""
    name = export["sha256"]
    return any(path.name == name for path in blobs(service.settings.data))


def test_deleted_export_is_gone_with_its_file(serve):
    service = serve()
    with service.admin() as http:
        api = Api(http)
        name = api.dataset_of_one_frame()
        first, same = run_export(api, name), run_export(api, name)

        deleted = api.delete(f"/exports/{first['id']}")
        kept = stored(service, same), download(api, same).status_code
        again = api.delete(f"/exports/{first['id']}")
        shown = api.get(f"/exports/{first['id']}")
        listed = api.json(f"/datasets/{name}/exports")["items"]
        last = api.delete(f"/exports/{same['id']}")
        audit = api.json("/audit")["items"][0]
        frames = api.json(f"/datasets/{name}/frames/a")

        assert (deleted.status_code, deleted.content) == (204, b"")
        assert first["sha256"] == same["sha256"]
        assert kept == (True, 200)
        assert (again.status_code, shown.status_code) == (404, 404)
        assert [item["id"] for item in listed] == [same["id"]]
        assert (last.status_code, stored(service, same)) == (204, False)
        assert (audit["action"], audit["subject"]) == (
            "export.deleted",
            str(same["id"]),
        )
        assert audit["details"] == {"dataset": name, "format": "yolo"}
        assert api.get(f"/frames/{frames['id']}/image").status_code == 200


def removed(api, export):
    """An export once its file is deleted."""
    path = f"/exports/{export['id']}"
    until(lambda: api.json(path)["download"] is None)
    return api.json(path)


def test_oldest_export_makes_place_for_a_new_one(serve, caplog):
    caplog.set_level("INFO")
    service = serve(max_export_bytes=1_024)
    with service.admin() as http:
        api = Api(http)
        name = api.dataset_of_one_frame()
        first = run_export(api, name)
        alone = download(api, first).status_code
        link = f"/exports/{first['id']}/download-links"
        address = api.post(link).json()["url"]

        newer = run_export(api, name, form="coco")
        gone = removed(api, first)
        refused = [
            api.http.get(first["download"]),
            api.post(link),
            service_get(service, address),
        ]

        assert first["size_bytes"] > 1_024
        assert alone == 200
        assert (gone["state"], gone["sha256"]) == ("done", None)
        assert gone["error"]["code"] == "export_removed"
        assert "UNGHOST_MAX_EXPORT_BYTES" in gone["error"]["detail"]
        assert {
            (response.status_code, response.json()["code"]) for response in refused
        } == {(409, "export_removed")}
        assert refused[0].json()["detail"].endswith(gone["error"]["detail"])
        assert (stored(service, first), download(api, newer).status_code) == (
            False,
            200,
        )
        assert api.json(f"/exports/{newer['id']}")["error"] is None
        assert api.delete(f"/exports/{first['id']}").status_code == 204
    assert f"the file of export {first['id']} was deleted" in caplog.text


def service_get(service, address):
    with service.client() as anonymous:
        return anonymous.get(address)


def test_old_export_is_deleted_once_no_backup_is_made(serve):
    service = serve(export_days=1)
    with service.admin() as http:
        api = Api(http)
        name = api.dataset_of_one_frame()
        first, newer = run_export(api, name), run_export(api, name, form="coco")
        lock = service.settings.data / MAINTENANCE_LOCK
        with locked(lock):
            refused = api.delete(f"/exports/{newer['id']}")
            with service.app.state.database.write() as session:
                session.get(Export, first["id"]).finished_at -= timedelta(hours=25)
            service.app.state.services.one(DeletionSignal).set()
            kept = run_export(api, name)  # meanwhile, the service looks for old ones

            assert (refused.status_code, refused.json()["code"]) == (503, "try_later")
            assert "backup" in refused.json()["detail"]
            assert (download(api, first).status_code, stored(service, first)) == (
                200,
                True,
            )
        service.app.state.services.one(DeletionSignal).set()

        gone = removed(api, first)

        assert "UNGHOST_EXPORT_DAYS" in gone["error"]["detail"]
        assert kept["sha256"] == first["sha256"]
        assert {download(api, link).status_code for link in (newer, kept)} == {200}
