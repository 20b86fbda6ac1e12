"""A run whose server is killed at a random moment is finished by the next server.

Not part of every test run; ``make test-long`` does fifty rounds (KILL_ROUNDS).
"""

import os
import random
import time
from collections import Counter
from itertools import cycle

import numpy as np
import pytest

from app.runs.queries import FLIP
from tests.support.data_folders import served
from tests.support.databases import CHOSEN, rows_of
from tests.support.run_results import wait_for_run_end
from tests.support.slow_datasets import OTHER_PIXELS, create_slow_dataset

pytestmark = pytest.mark.long

ROUNDS = int(os.environ.get("KILL_ROUNDS", "2"))
SEED = int(os.environ.get("KILL_SEED", str(random.SystemRandom().randrange(10**6))))
FRAMES = 60
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("killed") / "data"


def measured(folder):
    """The rows of evidence; a frame that is measured again gets a row of another id."""
    return rows_of(folder, "SELECT id, frame_id, measurement_id FROM evidence")


def configs():
    """An endless series of configs that need pixels, histograms, or stored numbers."""
    for number, pixels in cycle(enumerate(OTHER_PIXELS)):
        yield {**pixels, "threshold_small_box": 3 + number}
        yield {**pixels, **CARS_ARE_SKY}
        yield {**pixels, **NOTHING_VISIBLE}


def test_run_of_a_killed_server_is_finished_once_by_the_next(folder):
    print(f"KILL_SEED={SEED}")
    dice = random.Random(SEED)
    with served(folder, UNGHOST_WORKERS="1") as (_, api):
        dataset = create_slow_dataset(api, FRAMES)
    next_configs = configs()

    for _ in range(ROUNDS):
        run_id, before = killed(folder, dataset, next(next_configs), dice)
        with served(folder, UNGHOST_WORKERS="1") as (_, api):
            run = wait_for_run_end(api, run_id)
            shown = api.boxes(dataset, limit=1000)
        assert (run["state"], run["done"]) == ("done", FRAMES), run
        check_no_rows_are_lost_or_duplicated(folder, run, before)
        assert Counter(box["verdict"] for box in shown) == Counter(run["counts"])
        assert {box["run"] for box in shown} == {run_id}


def killed(folder, dataset, config, dice):
    """Request a run and kill the server after a random time.

    Returns the id of the run, and the rows of evidence that are stored by then.
    """
    with served(folder, UNGHOST_WORKERS="1") as (server, api):
        body = {"config": config, "activate": True}
        response = api.post(f"/datasets/{dataset}/runs", body)
        assert response.status_code == 202, response.text
        time.sleep(dice.uniform(0, dice.choice([0.05, 1.5])))
        server.process.kill()
        server.process.wait()
    return response.json()["id"], measured(folder)


def check_no_rows_are_lost_or_duplicated(folder, run, before):
    after = measured(folder)
    (measurement,) = rows_of(
        folder, f"SELECT measurement_id FROM runs WHERE id = {run['id']}"
    )
    frames = Counter(frame for _, frame, of in after if of == measurement[0])
    assert set(before) <= set(after)
    assert len(frames) == FRAMES
    assert set(frames.values()) == {1}
    flips = [
        np.frombuffer(boxes, FLIP)["box_id"]
        for (boxes,) in rows_of(
            folder, f"SELECT boxes FROM flips WHERE run_id = {run['id']}"
        )
    ]
    flipped = np.concatenate([np.array([], np.int64), *flips])
    assert len(flipped) == len(set(flipped.tolist())) == run["changed"]
    kept = "SELECT class_id, reason, toss_up, sum(boxes) FROM tallies GROUP BY 1, 2, 3"
    counted = (
        "SELECT class_id, reason, toss_up, count(*) FROM decisions GROUP BY 1, 2, 3"
    )
    assert rows_of(folder, kept) == rows_of(folder, counted)
    if not CHOSEN:  # only SQLite has these pragmas
        assert rows_of(folder, "PRAGMA integrity_check") == [("ok",)]
        assert rows_of(folder, "PRAGMA foreign_key_check") == []
