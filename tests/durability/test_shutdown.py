"""SIGTERM during uploads, runs and exports: they end, or continue after a restart."""

import json
import signal
import socket

import httpx
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support import archives, plain_http
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.connections import open_connection, request_head
from tests.support.databases import hold_write_lock, rows_of
from tests.support.event_reader import open_events
from tests.support.pictures import png
from tests.support.servers import start
from tests.support.slow_datasets import FROM_PIXELS, create_slow_dataset
from tests.support.waiting import until

pytestmark = pytest.mark.long

PATIENCE_S = 120
FRAMES = 60
MANY_BOXES = 300
BOUNDARY = "end-of-part"


class SlowUpload:
    """An upload of a frame that sends half of its body, and the rest in `finish`."""

    def __init__(self, server, dataset, key):
        body = multipart_body(
            annotation=json.dumps(scene.annotation()).encode(),
            image=scene.image(),
            segmentation=scene.segmentation(),
        )
        headers = {
            **server.headers,
            "Content-Type": f"multipart/form-data; boundary={BOUNDARY}",
            "Content-Length": len(body),
        }
        path = f"{BASE}/datasets/{dataset}/frames/{key}"
        self._socket = open_connection(server.url)
        self._socket.sendall(request_head("PUT", path, headers))
        self._socket.sendall(body[: len(body) // 2])
        self._rest = body[len(body) // 2 :]

    def finish(self):
        self._socket.sendall(self._rest)

    def answer(self):
        """Status and body, read until the connection closes; None: no answer."""
        with self._socket, self._socket.makefile("rb") as stream:
            text = stream.read().decode()
        head, _, body = text.partition("\r\n\r\n")
        return (int(head.split()[1]) if head else None), body


def multipart_body(**parts):
    head = '--{}\r\nContent-Disposition: form-data; name="{}"\r\n\r\n'
    lines = [
        head.format(BOUNDARY, name).encode() + content + b"\r\n"
        for name, content in parts.items()
    ]
    return b"".join((*lines, f"--{BOUNDARY}--\r\n".encode()))


def terminate_and_wait_for_shutdown(server):
    """Send SIGTERM and wait until the server reports that it is shutting down."""
    server.process.send_signal(signal.SIGTERM)

    def refusal():
        ready = plain_http.get(f"{server.url}/readyz", timeout=PATIENCE_S)
        codes = {fault["code"] for fault in ready.json().get("errors", ())}
        # On a busy machine the event loop may have been late, too.
        return codes - {"event_loop"}

    assert until(refusal, "it stays ready") == {"shutdown"}


def query_rows(server, statement):
    return rows_of(server.data, statement)


def ended(server):
    return server.process.wait(PATIENCE_S)


def test_shutdown_finishes_open_requests_and_refuses_new_writes(start_api):
    server, api = start_api(UNGHOST_SHUTDOWN_WAIT_S=str(PATIENCE_S))
    name = api.dataset()
    upload = SlowUpload(server, name, "slow")
    batch = archives.Connection(server, name)
    members = [frame for n in range(3) for frame in archives.frame(str(n), number=n)]
    # The first member of a fourth frame shows that the third one is complete.
    batch.send(archives.tar_without_end([*members, archives.frame("3")[0]]))
    # Once the batch has begun, so has the upload that was sent before it.
    until(lambda: "unghost_batches_open 1" in api.http.get("/metrics").text)

    terminate_and_wait_for_shutdown(server)
    late = api.put(name, "late")
    read = api.get(f"/datasets/{name}")
    lines = [batch.line() for _ in range(4)]
    upload.finish()
    status, body = upload.answer()

    assert (late.status_code, late.json()["code"]) == (503, "not_ready")
    assert int(late.headers["retry-after"]) > 0
    assert read.status_code == 200
    assert [line["status"] for line in lines[:3]] == [201, 201, 201]
    assert (lines[3]["end"], lines[3]["stored"], lines[3]["frames"]) == (True, 3, 3)
    assert lines[3]["problem"]["code"] == "not_ready"
    assert (status, json.loads(body)["frame"]["key"]) == (201, "slow")
    assert ended(server) == 0
    batch.close()
    keys = [key for (key,) in query_rows(server, "SELECT key FROM frames ORDER BY key")]
    assert keys == ["run/0", "run/1", "run/2", "slow"]
    assert "Traceback" not in server.log.read_text("utf-8")


def test_run_resumes_after_shutdown_without_measuring_a_frame_twice(start_api):
    first, api = start_api(UNGHOST_WORKERS="1")
    name = create_slow_dataset(api, FRAMES)
    accepted = api.post(f"/datasets/{name}/runs", {"config": FROM_PIXELS})
    run_id = accepted.json()["id"]
    with open_events(api, run_id) as events:
        seen = next(event for event in events if event.data and event.data["done"] > 0)
        first.process.send_signal(signal.SIGTERM)
        last = [seen, *events][-1]  # no error: the stream was ended properly

    assert ended(first) == 0
    assert last.name == "progress"
    of_run = f"SELECT state, done FROM runs WHERE id = {run_id}"
    ((state, done),) = query_rows(first, of_run)
    before = query_rows(first, "SELECT id, frame_id, measurement_id FROM evidence")
    assert (state, done) == ("running", len(before) - FRAMES)
    assert 0 < done < FRAMES

    second, api = start_api(UNGHOST_WORKERS="1")
    run = api.wait_for_job(accepted)

    after = query_rows(second, "SELECT id, frame_id, measurement_id FROM evidence")
    assert (run["state"], run["done"], run["total"]) == ("done", FRAMES, FRAMES)
    assert set(before) <= set(after)
    assert len({row[1:] for row in after}) == len(after) == 2 * FRAMES
    assert measured_frames(api) == FRAMES - done
    assert "Traceback" not in first.log.read_text("utf-8")


def measured_frames(api):
    """The number of frames that the server has measured, from its metrics."""
    text = api.http.get("/metrics").text
    metrics = {
        sample.name: sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    return metrics["unghost_measure_seconds_count"]


@pytest.mark.long
def test_export_interrupted_by_shutdown_is_rewritten_with_the_same_bytes(start_api):
    first, api = start_api()
    name = api.dataset()
    box = {"class": "car", "xyxy": scene.ON_THE_CAR}
    boxes = [{**box, "id": str(number)} for number in range(MANY_BOXES)]
    for number in range(20):
        annotation = {**scene.annotation(), "boxes": boxes, "number": number}
        api.upload_frame(name, str(number), annotation)
    body = {"format": "decisions-jsonl"}
    whole = api.wait_for_job(api.post(f"/datasets/{name}/exports", body))
    assert whole["state"] == "done", whole
    accepted = api.post(f"/datasets/{name}/exports", body)
    of_export = f"SELECT state FROM exports WHERE id = {accepted.json()['id']}"
    until(lambda: query_rows(first, of_export) != [("queued",)], every_s=0.001)

    first.process.send_signal(signal.SIGTERM)
    code = ended(first)
    left = query_rows(first, of_export)
    temporary = list((first.data / "blobs" / "tmp").iterdir())
    second, api = start_api()
    again = api.wait_for_job(accepted)

    assert (code, left, temporary) == (0, [("running",)], [])
    assert (again["state"], again["sha256"]) == ("done", whole["sha256"])
    assert query_rows(second, "SELECT count(*) FROM exports") == [(2,)]


@pytest.mark.long
def test_request_beyond_the_shutdown_wait_is_cancelled_with_503(start_api):
    server, api = start_api(UNGHOST_SHUTDOWN_WAIT_S="1")
    upload = SlowUpload(server, api.dataset(), "never")
    wait_until_upload_is_read(server, api)

    server.process.send_signal(signal.SIGTERM)
    status, body = upload.answer()

    assert (status, json.loads(body)["code"]) == (503, "not_ready")
    assert ended(server) == 0
    assert "1 requests are cancelled" in server.log.read_text("utf-8")
    assert query_rows(server, "SELECT count(*) FROM frames") == [(0,)]


@pytest.mark.sqlite_files("several servers may share PostgreSQL")
def test_data_folder_is_refused_while_its_server_stops(start_api, tmp_path):
    first, api = start_api(UNGHOST_SHUTDOWN_WAIT_S=str(PATIENCE_S))
    upload = SlowUpload(first, api.dataset(), "slow")
    wait_until_upload_is_read(first, api)
    terminate_and_wait_for_shutdown(first)

    with start(["app"], first.data, tmp_path / "log", {}) as second:
        code = second.wait(PATIENCE_S)
    upload.finish()

    assert code == 1
    refusal = (tmp_path / "log").read_text("utf-8")
    assert "by a server that is starting or stopping; try again" in refusal
    assert upload.answer()[0] == 201
    assert ended(first) == 0


@pytest.mark.long
def test_shutdown_finishes_the_download_of_a_slow_client(start_api):
    server, api = start_api(UNGHOST_SHUTDOWN_WAIT_S=str(PATIENCE_S))
    noise = np.random.default_rng(7).integers(0, 256, (2000, 3000, 3), np.uint8)
    image = png(noise)
    stored = api.upload_frame(api.dataset(), "a", {"boxes": []}, image=image)
    url = stored["frame"]["files"]["image"]["url"]

    with slow_reading_client(server) as client, client.stream("GET", url) as response:
        pieces = response.iter_bytes(1000)
        content = [next(pieces)]
        terminate_and_wait_for_shutdown(server)
        content += pieces

    assert b"".join(content) == image
    assert ended(server) == 0


def slow_reading_client(server):
    """A client with a small receive buffer: most of a download waits in the server."""
    little = (socket.SOL_SOCKET, socket.SO_RCVBUF, 64 * 1024)
    transport = httpx.HTTPTransport(socket_options=[little])
    return plain_http.Client(
        base_url=server.url,
        headers=server.headers,
        transport=transport,
        timeout=PATIENCE_S,
    )


@pytest.mark.long
def test_run_that_blocks_shutdown_is_stopped_and_resumes_after_restart(start_api):
    first, api = start_api(UNGHOST_WORKERS="1", UNGHOST_SHUTDOWN_WAIT_S="0")
    name = create_slow_dataset(api, FRAMES)
    accepted = api.post(f"/datasets/{name}/runs", {"config": FROM_PIXELS})
    until(lambda: api.http.get(accepted.headers["location"]).json()["done"])

    with hold_write_lock(first.data):  # the run cannot store what it measures
        first.process.send_signal(signal.SIGTERM)
        code = ended(first)
    _, api = start_api()
    run = api.wait_for_job(accepted)

    assert code == 1
    assert "the shutdown took too long" in first.log.read_text("utf-8")
    assert (run["state"], run["done"]) == ("done", FRAMES)


@pytest.mark.parametrize(
    "sig", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)]
)
def test_second_signal_ends_the_server_immediately(start_api, sig):
    server, api = start_api(UNGHOST_SHUTDOWN_WAIT_S="3600")
    upload = SlowUpload(server, api.dataset(), "never")
    wait_until_upload_is_read(server, api)
    terminate_and_wait_for_shutdown(server)

    server.process.send_signal(sig)

    assert ended(server) == 128 + sig
    assert upload.answer() == (None, "")


def wait_until_upload_is_read(server, api):
    """Wait until the server has begun the upload that was sent before."""
    # The server answers requests that were sent later, so it has read the upload's.
    for _ in range(3):
        assert api.http.get("/healthz").status_code == 200
    assert server.process.poll() is None
