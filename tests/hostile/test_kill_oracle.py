"""A server is killed while several clients send it every kind of write.

Afterwards every acknowledged write is stored, complete and exactly once; any other is
stored completely or not at all. ``KILL_ROUNDS`` says how often; ``make test-long``
kills 200 times.
"""

import hashlib
import os
import random
import threading
import time
from contextlib import ExitStack

import pytest

from tests.support import databases
from tests.support.api import Api
from tests.support.hostile.write_record import Writer, WriteRecord, digest, files
from tests.support.servers import running_server
from tests.support.waiting import until

pytestmark = pytest.mark.long

ROUNDS = int(os.environ.get("KILL_ROUNDS", "2"))
SEED = int(os.environ.get("KILL_SEED", str(random.SystemRandom().randrange(10**6))))
WRITERS = (
    "uploads 1",
    "uploads 2",
    "batches",
    "reviews 1",
    "reviews 2",
    "bulk",
    "configs",
)
FRAMES = 12
SETTINGS = {"UNGHOST_MAX_OPEN_RUNS": "100000", "UNGHOST_LOG_LEVEL": "warning"}
RECOUNT = """
    SELECT dataset_id, class_id, reason, toss_up, review, sum(boxes) FROM (
        SELECT dataset_id, class_id, reason, toss_up, review, boxes FROM tallies
        UNION ALL
        SELECT dataset_id, class_id, reason, toss_up, coalesce(review, ''), -1
        FROM decisions
    ) AS both_ways GROUP BY 1, 2, 3, 4, 5 HAVING sum(boxes) <> 0
"""


@pytest.mark.timeout(14400)
def test_acknowledged_writes_survive_any_kill_exactly_once(tmp_path):
    print(f"KILL_SEED={SEED}")
    dice, folder = random.Random(SEED), tmp_path / "data"
    write_record, promised = None, 0
    for number in range(ROUNDS + 1):
        with running_server(folder, SETTINGS) as server, ExitStack() as opened:
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
            if write_record is not None:
                check_acknowledged_writes(api, write_record)
                promised += write_record.count_confirmed()
            if number < ROUNDS:
                write_record = begin_round(api, number)
                write_until_killed(server, write_record, dice)
        check_database(folder)
    print(f"{ROUNDS} kills, {promised} acknowledged writes")
    assert promised > 10 * ROUNDS


def begin_round(api, number):
    """Make a dataset with some frames; return the record of what was acknowledged."""
    write_record = WriteRecord(f"round-{number}")
    assert api.post("/datasets", {"name": write_record.dataset}).status_code == 201
    for place in range(FRAMES):
        response = api.put(write_record.dataset, f"first/{place}", **files(place))
        assert response.status_code == 201
        for decision in response.json()["decisions"]:
            write_record.answers[decision["box_id"]] = []
    return write_record


def write_until_killed(server, write_record, dice):
    box_ids = sorted(write_record.answers)
    shares = {
        "reviews 1": box_ids[:8],
        "reviews 2": box_ids[8:16],
        "bulk": box_ids[16:],
    }
    faults: list[BaseException] = []
    with ExitStack() as opened:
        threads = []
        for name in WRITERS:
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
            own = random.Random(dice.random())
            writer = Writer(api, write_record, own, name, tuple(shares.get(name, ())))
            threads.append(
                threading.Thread(
                    target=run_and_record_errors, args=(writer.write, faults), name=name
                )
            )
        for thread in threads:
            thread.start()
        # Count acknowledged writes, not seconds: a busy machine acknowledges slowly.
        enough = dice.randrange(20, 100)
        until(lambda: write_record.count_confirmed() >= enough or faults, every_s=0.001)
        time.sleep(dice.uniform(0, 0.03))
        server.process.kill()
        server.process.wait()
        for thread in threads:
            thread.join()
    assert not faults, faults


def run_and_record_errors(work, faults):
    """Run `work`; keep what it raises, which would be lost in a thread."""
    try:
        work()
    except BaseException as fault:
        faults.append(fault)


def check_acknowledged_writes(api, write_record):
    check_frames(api, write_record)
    check_answers(api, write_record)
    check_jobs(api, write_record)


def check_frames(api, write_record):
    listed = api.all_items(f"/datasets/{write_record.dataset}/frames")
    keys = [frame["key"] for frame in listed]
    ours = [key for key in keys if not key.startswith("first/")]
    assert len(set(keys)) == len(keys)
    assert len(keys) - len(ours) == FRAMES
    assert (
        write_record.stored.keys()
        <= set(ours)
        <= write_record.stored.keys() | write_record.sending.keys()
    )
    digests: dict[str, str] = {}
    for start in range(0, len(ours), 1000):
        body = {"keys": ours[start : start + 1000]}
        response = api.post(f"/datasets/{write_record.dataset}/known-frames", body)
        digests |= {item["key"]: item["digest"] for item in response.json()["items"]}
    for key in ours:
        possible = {write_record.stored[key]} if key in write_record.stored else set()
        possible |= write_record.sending.get(key, set())
        assert digests[key] in {digest(number) for number in possible}, key
    for frame in listed[-5:]:
        check_frame_is_complete(api, frame["id"])
    stats = api.json(f"/datasets/{write_record.dataset}/stats")
    assert (stats["frames"], stats["boxes"]) == (len(keys), 2 * len(keys))
    assert stats["kept"] + stats["rejected"] == stats["boxes"]


def check_frame_is_complete(api, frame_id):
    """Check that each file has the bytes of its digest, and each box its verdict."""
    frame = api.json(f"/frames/{frame_id}")
    assert [box["verdict"] for box in frame["boxes"]] == ["kept", "rejected"]
    assert sorted(frame["files"]) == ["image", "segmentation"]
    for kind, file in frame["files"].items():
        content = api.get(f"/frames/{frame_id}/{kind}").content
        assert hashlib.sha256(content).hexdigest() == file["sha256"]


def check_answers(api, write_record):
    """Check that no acknowledged answer is lost, and no bulk answer stored in part."""
    more = {}
    for box_id, said in write_record.answers.items():
        items = api.all_items(f"/boxes/{box_id}/history")
        reviews = sorted(
            (entry["revision"], entry["verdict"])
            for entry in items
            if entry["kind"] == "review"
        )
        assert [revision for revision, _ in reviews] == list(range(1, len(reviews) + 1))
        verdicts = [verdict for _, verdict in reviews]
        assert verdicts[: len(said)] == said
        if len(verdicts) > len(said):
            (more[box_id],) = verdicts[len(said) :]
    in_flight = [
        boxes for boxes, _ in write_record.maybe_answers
    ] + write_record.maybe_undone
    for boxes in in_flight:
        assert boxes <= more.keys() or not boxes & more.keys()
    for boxes, verdict in write_record.maybe_answers:
        assert {more[box_id] for box_id in boxes if box_id in more} <= {verdict}
    assert more.keys() <= set().union(*in_flight)


def check_jobs(api, write_record):
    """Check that acknowledged configurations and runs are there once, and runs end."""
    path = f"/datasets/{write_record.dataset}"
    digests = [config["digest"] for config in api.all_items(f"{path}/configs")]
    assert len(set(digests)) == len(digests)
    assert write_record.digests <= set(digests)
    assert len(digests) <= 1 + len(write_record.digests) + write_record.maybe_configs
    runs = [run["id"] for run in api.all_items(f"{path}/runs")]
    assert len(set(runs)) == len(runs)
    assert write_record.runs <= set(runs)
    assert len(runs) <= 1 + len(write_record.runs) + write_record.maybe_runs
    for run_id in runs:
        with api.http.stream("GET", f"/api/v1/runs/{run_id}/events") as events:
            events.read()
        run = api.json(f"/runs/{run_id}")
        assert (run["state"], run["error"]) == ("done", None)


def check_database(folder):
    """Check the database of an ended server, before a start replays its journal."""
    assert databases.problems_of(folder) == []
    assert databases.rows_of(folder, RECOUNT) == []
