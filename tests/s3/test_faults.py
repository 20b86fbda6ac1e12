"""The bucket is unreachable, silent, or breaks connections off.

The server answers 503 within seconds, and nothing that was stored is lost.
"""

import random
import threading
import time
from functools import partial

import pytest

from tests.support import frames as scene
from tests.support import plain_http
from tests.support.api import Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.s3_service import served_on_s3
from tests.support.servers import wait_until_ready
from tests.support.slow_datasets import FROM_PIXELS
from tests.support.waiting import until

IDLE = "\nunghost_workers_busy 0.0\n"


def files(number):
    return {"image": scene.image(number), "segmentation": scene.segmentation()}


def problem(response):
    return response.status_code, response.json()["code"]


@pytest.fixture(params=["shut", pytest.param("hold", marks=pytest.mark.long)])
def unreachable_store(on_s3, request):
    """The store refuses connections or accepts them silently, until the test ends.

    Gives a dataset and the id of a frame that was stored before.
    """
    dataset = on_s3.api.dataset()
    stored = on_s3.api.upload_frame(dataset, "before", **files(1))
    getattr(on_s3.gate, request.param)()
    try:
        yield dataset, stored["frame"]["id"]
    finally:
        on_s3.gate.flow()
        on_s3.gate.open()


def test_unreachable_store_returns_503_and_stored_files_are_read_later(
    on_s3, unreachable_store
):
    dataset, frame_id = unreachable_store

    refused = on_s3.api.put(dataset, "after", **files(2))
    picture = on_s3.api.get(f"/frames/{frame_id}/image")
    ready = plain_http.get(f"{on_s3.server.url}/readyz", timeout=60)
    listed = on_s3.api.json(f"/datasets/{dataset}/frames")["items"]
    on_s3.gate.flow()
    on_s3.gate.shut()
    on_s3.gate.open()
    wait_until_ready(on_s3.server.url)

    assert problem(refused) == problem(picture) == (503, "storage_away")
    assert int(refused.headers["retry-after"]) > 0
    faults = {fault["code"] for fault in ready.json()["errors"]}
    # On a busy machine the event loop may have been late, too.
    assert (ready.status_code, faults - {"event_loop"}) == (503, {"blobs"})
    assert [each["key"] for each in listed] == ["before"]
    assert on_s3.api.get(f"/frames/{frame_id}/image").content == scene.image(1)
    assert on_s3.api.put(dataset, "after", **files(2)).status_code == 201


def test_batch_ends_at_the_frame_that_the_store_did_not_take(on_s3):
    api, dataset = on_s3.api, on_s3.api.dataset()
    members = [file for name in ("a", "b") for file in frame(name)]
    on_s3.gate.shut()

    response = send(api, dataset, tar_archive(members))
    on_s3.gate.open()
    again = send(api, dataset, tar_archive(members))

    (end,) = lines_of(response.text)
    assert (end["problem"]["status"], end["problem"]["code"]) == (503, "storage_away")
    assert [line.get("status") for line in lines_of(again.text)] == [201, 201, None]


def count_log_warnings(server):
    """How often jobs have asked the store in vain, as the log says."""
    return server.log.read_text("utf-8").count(
        "the storage of the files does not respond"
    )


@pytest.fixture
def run_without_store(on_s3):
    """A run that needs pixels while the store is unreachable, and its dataset."""
    dataset = on_s3.api.dataset()
    for number in range(3):
        on_s3.api.upload_frame(dataset, f"{number}", **files(number))
    before = count_log_warnings(on_s3.server)
    on_s3.gate.shut()
    try:
        run = on_s3.api.post(f"/datasets/{dataset}/runs", {"config": FROM_PIXELS})
        until(lambda: count_log_warnings(on_s3.server) > before)
        yield dataset, run
    finally:
        on_s3.gate.open()


def test_run_and_export_finish_after_the_store_was_unreachable(
    on_s3, run_without_store
):
    dataset, run = run_without_store
    body = {"format": "yolo", "options": {"images": "copy"}}
    export = on_s3.api.post(f"/datasets/{dataset}/exports", body)

    on_s3.gate.open()

    assert on_s3.api.wait_for_job(run)["state"] == "done"
    assert on_s3.api.wait_for_job(export)["state"] == "done"


def test_run_can_be_cancelled_while_the_store_is_unreachable(on_s3, run_without_store):
    _, run = run_without_store
    begun = time.monotonic()

    on_s3.api.http.post(f"{run.headers['location']}/cancel")

    assert on_s3.api.wait_for_job(run)["state"] == "cancelled"
    assert time.monotonic() - begun < 20
    until(lambda: IDLE in on_s3.api.http.get("/metrics").text, "they still measure")


def send_one_by_one(api, dataset, count):
    """Upload frames one after another, each again after 503 until it is stored."""

    def is_stored(number):
        status = api.put(dataset, f"one/{number}", **files(number)).status_code
        assert status in (200, 201, 503)
        return status != 503

    for number in range(count):
        until(partial(is_stored, number), f"frame {number} was never stored")


def send_in_batches(api, dataset, count):
    """Upload frames as a batch; again those that no line of the answer says stored."""
    left = set(range(count))

    def all_are_stored():
        members = [
            file
            for number in sorted(left)
            for file in frame(f"{number}", number=number)
        ]
        for line in lines_of(send(api, dataset, tar_archive(members)).text):
            if line.get("status") in (200, 201):
                left.discard(int(line["key"].removeprefix("run/")))
        return not left

    until(all_are_stored, lambda: f"never stored: {left}")


def interrupt_store_at_random(way, over, seed):
    """Make the store unreachable for moments at random times, until `over` is set."""
    chance = random.Random(seed)
    while not over.wait(chance.uniform(0.05, 0.4)):
        way.shut()
        time.sleep(chance.uniform(0.0, 0.3))
        way.open()


def check_uploads_survive_interruptions(running, count):
    """Upload frames singly and in batches while the store comes and goes.

    Afterwards every frame and every file is there and unharmed.
    """
    api, over = running.api, threading.Event()
    dataset = api.dataset()
    troubles = threading.Thread(
        target=interrupt_store_at_random, args=(running.gate, over, count)
    )
    with Api.at(running.server.url, running.server.headers).http as http:
        batches = threading.Thread(
            target=send_in_batches, args=(Api(http), dataset, count)
        )
        troubles.start()
        batches.start()
        try:
            send_one_by_one(api, dataset, count)
            batches.join()
        finally:
            over.set()
            troubles.join()
    wait_until_ready(running.server.url)
    check_every_frame(running, dataset, count)


def check_every_frame(running, dataset, count):
    api = running.api
    frames = api.json(f"/datasets/{dataset}/frames", limit=200)["items"]
    contents = {api.get(f"/frames/{each['id']}/image").content for each in frames}
    doctor = running.command("doctor", "--verify", "--json")

    assert len(frames) == 2 * count
    assert contents == {scene.image(number) for number in range(count)}
    assert doctor.code == 0, doctor.out


def test_acknowledged_frames_survive_interruptions_of_the_store(on_s3):
    check_uploads_survive_interruptions(on_s3, 15)


@pytest.mark.long
def test_acknowledged_frames_survive_many_interruptions_of_the_store(tmp_path, s3):
    with served_on_s3(tmp_path, s3) as running:
        check_uploads_survive_interruptions(running, 100)
