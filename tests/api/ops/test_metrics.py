"""Metrics for Prometheus: counted by route, never by a client's text, and cheap."""

import re
import time

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support import archives
from tests.support import frames as scene
from tests.support.databases import CHOSEN, change
from tests.support.statements import statements_of
from tests.support.waiting import until

pytestmark = pytest.mark.long

TABLE_READ = re.compile(r"\bFROM (\w+)")
SMALL_TABLES = {"datasets", "tallies", "runs", "exports", "tokens"}


def families(client):
    text = client.get("/metrics").text
    return {family.name: family for family in text_string_to_metric_families(text)}


def scrape_metrics(client):
    """Values by name and label values, with the labels in alphabetical order."""
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in families(client).values()
        for sample in family.samples
    }


def test_requests_are_counted_by_route_and_status(serve):
    """Those without a route are counted together."""
    with serve().admin() as client:
        for number in (1, 2, 3):
            client.get(f"/probe/items/{number}")
        client.get("/probe/items/none")
        client.get('/nowhere"}')
        client.request("PROPFIND", "/nowhere")
        text, metrics = client.get("/metrics").text, scrape_metrics(client)

    route = "/probe/items/{item_id}"
    assert metrics["unghost_requests_total", "GET", route, "200"] == 3
    assert metrics["unghost_requests_total", "GET", route, "422"] == 1
    assert metrics["unghost_request_seconds_bucket", "+Inf", "GET", route, "200"] == 3
    assert metrics["unghost_request_seconds_count", "GET", route, "422"] == 1
    assert metrics["unghost_requests_total", "GET", "other", "404"] == 1
    assert metrics["unghost_requests_total", "other", "other", "404"] == 1
    assert "nowhere" not in text


def test_metrics_follow_the_naming_and_types_of_prometheus(admin):
    admin.get("/healthz")

    response, metrics = admin.get("/metrics"), families(admin)

    assert response.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert all(name.startswith(("unghost_", "process_")) for name in metrics)
    assert [name for name, metric in metrics.items() if not metric.documentation] == []
    assert {metric.type for metric in metrics.values()} == {
        "gauge",
        "counter",
        "histogram",
    }
    assert all(
        sample.name.endswith("_total")
        for metric in metrics.values()
        if metric.type == "counter"
        for sample in metric.samples
    )


@pytest.fixture(scope="module")
def worked(tmp_path_factory):
    """A server that has done a little of everything, and a client of it.

    It is a process of its own, so that its figures count nothing else.
    """
    from tests.support.api import Api
    from tests.support.servers import running_server

    with running_server(tmp_path_factory.mktemp("worked") / "data") as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            work(api)
            yield server, api


def work(api):
    name = api.dataset()
    car, ghost = (b["box_id"] for b in api.upload_frame(name, "a")["decisions"])
    archives.send(api, name, archives.tar_archive(archives.frame("b", number=1)))
    assert api.put(name, "bad", {"boxes": [{"id": "1"}]}).status_code == 422
    assert api.put(name, "a").status_code == 200
    assert api.review(car, "keep").status_code == 201
    assert api.review(car, "reject").status_code == 412
    boxes = {"box_ids": [car, ghost], "seen_revisions": [1, 0]}
    body = {"dataset": name, "verdict": "unsure", **boxes}
    bulk = api.post("/reviews/bulk", body).json()
    api.post(f"/review-batches/{bulk['id']}/undo")
    api.run(name, {"min_visible_pixels": 10**6}, activate=False)


def test_counters_count_frames_boxes_and_reviews(worked):
    metrics = scrape_metrics(worked[1].http)

    assert metrics["unghost_frames_stored_total",] == 2
    assert metrics["unghost_boxes_stored_total",] == 4
    assert metrics["unghost_frames_refused_total",] == 1
    assert metrics["unghost_batch_frames_total", "201"] == 1
    assert metrics["unghost_frame_bytes_stored_total", "segmentation"] == 2 * len(
        scene.segmentation()
    )
    assert metrics["unghost_decode_seconds_count",] == 2
    assert metrics["unghost_measure_seconds_count",] == 2
    assert metrics["unghost_decisions_total", "visible", "kept"] == 2
    assert metrics["unghost_decisions_total", "no_visible_pixels", "rejected"] == 2
    assert metrics["unghost_reviews_total", "keep"] == 1
    assert metrics["unghost_reviews_total", "unsure"] == 2
    assert metrics["unghost_reviews_total", "undo"] == 2
    assert ("unghost_reviews_total", "reject") not in metrics


def test_gauges_show_stored_data_and_jobs(worked):
    server, api = worked
    metrics = scrape_metrics(api.http)

    assert metrics["unghost_boxes", "visible", "kept"] == 2
    assert metrics["unghost_boxes_reviewed", "keep"] == 1
    assert metrics["unghost_jobs", "run", "done"] == 2
    assert metrics["unghost_jobs", "export", "queued"] == 0
    assert metrics["unghost_database_up",] == metrics["unghost_datasets",] == 1
    assert metrics["unghost_workers",] >= 1
    nothing = ("batches_open", "event_streams_open", "stopping")
    assert [metrics[f"unghost_{name}",] for name in nothing] == [0, 0, 0]
    if not CHOSEN:
        size = (server.data / "unghost.db").stat().st_size
        assert metrics["unghost_database_bytes",] == size
        assert metrics["unghost_wal_bytes",] > 0
    assert metrics["unghost_database_bytes",] > 0
    assert metrics["unghost_disk_bytes",] > metrics["unghost_disk_free_bytes",] > 0
    assert metrics["process_cpu_seconds_total",] > 0
    assert metrics["process_resident_memory_bytes",] > 10**7
    assert metrics["process_start_time_seconds",] < time.time()


def test_stored_files_are_counted_in_the_background(worked):
    _, api = worked
    until(lambda: ("unghost_blobs",) in scrape_metrics(api.http))
    metrics = scrape_metrics(api.http)

    sizes = [len(scene.image(number)) for number in (0, 1)]
    assert metrics["unghost_blobs",] == 3
    assert metrics["unghost_blob_bytes",] == sum(sizes) + len(scene.segmentation())


def test_metrics_read_no_table_that_grows_with_the_boxes(serve):
    service = serve()

    with service.admin() as client:
        client.get("/metrics")  # starts to count the blobs in the background
        context = service.app.state.services
        context.engine.start(str, None).result()
        with statements_of(service.app.state.database.engine) as said:
            metrics = scrape_metrics(client)

    read = {table for statement, _ in said for table in TABLE_READ.findall(statement)}
    assert metrics["unghost_database_up",] == 1
    assert read <= SMALL_TABLES, said
    assert "tallies" in read


def test_metrics_are_served_when_the_database_fails(serve):
    service = serve()
    change(service.settings.data, "DROP TABLE tallies")

    with service.admin() as client:
        metrics = scrape_metrics(client)

    assert metrics["unghost_database_up",] == 0
    assert ("unghost_datasets",) not in metrics
    assert metrics["unghost_disk_free_bytes",] > 0
