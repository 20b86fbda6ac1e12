"""Work that kills the service's process is tried three times and then quarantined.

A process that is killed from outside causes no quarantine, however often it happens.
"""

from collections import Counter
from contextlib import contextmanager
from functools import partial

import httpx
import pytest

from tests.support import frames as scene
from tests.support.api import FINISHED
from tests.support.cluster import PATIENCE_S
from tests.support.crash_points import client_of, crashing_servers, running_client
from tests.support.data_folders import served
from tests.support.databases import rows_of
from tests.support.poison import EMPTY, EXPORTS, FRAMES, poisoned_files
from tests.support.run_results import check_run_results, get_run, wait_for_run_end
from tests.support.servers import start, stop, token_of, wait_for_link
from tests.support.slow_datasets import FROM_PIXELS, create_slow_dataset
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

pytestmark = pytest.mark.long

MOST_DEATHS = 3
KILLED = -9
FRAMES_BEFORE = 60
KILLS = 5
FRAMES_OF_LONG_RUN = 240


@pytest.fixture
def servers(tmp_path):
    with crashing_servers(tmp_path / "data") as program:
        yield program


@pytest.fixture
def data(tmp_path):
    return tmp_path / "data"


def put_frames(api, name, *keys):
    for number, key in enumerate(keys):
        files = {"image": scene.image(number), "segmentation": scene.segmentation()}
        api.upload_frame(name, key, scene.annotation(), **files)


def put_poison(api, name, key):
    api.upload_frame(name, key, EMPTY, **poisoned_files())


def request_job(api, url, body):
    """Request a job; it may kill the server before the request is answered."""
    try:
        response = api.post(url, body)
    except httpx.TransportError:
        return
    assert response.status_code == 202, response.text


def request_run(api, name, config=FROM_PIXELS):
    request_job(api, f"/datasets/{name}/runs", {"config": config, "activate": True})


def count_measurements(data, run_id):
    """How often the evidence of a run has each frame, by the frame's key."""
    rows = rows_of(
        data,
        "SELECT frames.key FROM evidence JOIN frames ON frames.id = evidence.frame_id "
        "JOIN runs ON runs.measurement_id = evidence.measurement_id "
        "WHERE runs.id = :run",
        run=run_id,
    )
    return Counter(key for (key,) in rows)


def export(api):
    return api.json("/exports/1")


def log_path_of(data):
    return data.with_name("poisoned.log")


@contextmanager
def poisoned_server(data):
    """The process of a server with two workers, which poisoned frames kill."""
    settings = {"PYTHONPATH": str(CHECKOUT), "UNGHOST_WORKERS": "2"}
    process = start(["tests.support.poison"], data, log_path_of(data), settings)
    try:
        yield process
    finally:
        stop(process)


def last_run(data):
    """The id, state and progress of the run that was requested last."""
    return rows_of(data, "SELECT id, state, done FROM runs ORDER BY id DESC")[0]


def is_over(data):
    return last_run(data)[1] in FINISHED


def has_progressed(data, done):
    return last_run(data)[2] > done


def test_frame_that_kills_the_service_is_quarantined_and_others_are_measured(servers):
    with running_client(servers) as api:
        name = api.dataset()
        put_poison(api, name, "m-poison")
        put_frames(api, name, "a", "b", "x", "y")
    with client_of(servers.start_poisoned(FRAMES)) as api:
        request_run(api, name)
    deaths = [servers.wait_for_exit(ask=False)]
    deaths += [servers.start_and_wait_for_crash(FRAMES) for _ in range(MOST_DEATHS - 1)]
    with running_client(servers, servers.start_poisoned(FRAMES)) as api:
        run_id = last_run(servers.data)[0]
        failed = wait_for_run_end(api, run_id)

    assert deaths == [KILLED] * MOST_DEATHS
    assert (failed["state"], failed["error"]["code"]) == ("failed", "quarantined")
    assert failed["error"]["detail"].startswith("frame 'm-poison' crashed the process")
    assert (failed["done"], failed["total"]) == (4, 5)
    assert count_measurements(servers.data, run_id) == dict.fromkeys(
        ("a", "b", "x", "y"), 1
    )

    with running_client(servers) as api:
        check_run_results(api, name, api.run(name, FROM_PIXELS), 5, empty=1)


def test_export_that_kills_the_service_fails_as_quarantined(servers):
    with client_of(servers.start_poisoned(EXPORTS)) as api:
        name = api.dataset()
        put_frames(api, name, "a")
        request_job(api, f"/datasets/{name}/exports", {"format": "yolo"})
    deaths = [servers.wait_for_exit(ask=False)]
    deaths += [
        servers.start_and_wait_for_crash(EXPORTS) for _ in range(MOST_DEATHS - 1)
    ]
    with running_client(servers, servers.start_poisoned(EXPORTS)) as api:
        until(lambda: export(api)["state"] in FINISHED, "the export does not end")
        failed = export(api)

    assert deaths == [KILLED] * MOST_DEATHS
    assert (failed["state"], failed["error"]["code"]) == ("failed", "quarantined")
    assert failed["error"]["detail"].startswith("writing it crashed the process")


def test_killing_frames_in_a_chunk_do_not_stop_other_frames_from_measuring(data):
    """One chunk has frames before, between and after the two frames that kill."""
    with served(data) as (_, api):
        name = create_slow_dataset(api, FRAMES_BEFORE)
        for key in ("p", "q"):
            put_poison(api, name, key)
            put_frames(api, name, f"{key}1", f"{key}2")
    with poisoned_server(data) as process:
        url = wait_for_link(process, log_path_of(data)).partition("/#")[0]
        with client_of((url, token_of(data))) as api:
            request_run(api, name)
            assert process.wait(PATIENCE_S) == KILLED
    deaths = 1
    while not is_over(data):
        with poisoned_server(data) as process:
            until(
                lambda: process.poll() is not None or is_over(data), "nothing happens"
            )
            deaths += not is_over(data)
    with served(data) as (_, api):
        failed = get_run(api, last_run(data)[0])
        run = api.run(name, FROM_PIXELS)
        check_run_results(api, name, run, FRAMES_BEFORE + 6, empty=2)

    assert failed["error"]["code"] == "quarantined"
    assert failed["error"]["detail"].startswith("frames 'p', 'q' crashed the process")
    assert failed["done"] == failed["total"] - 2 == FRAMES_BEFORE + 4
    # Three deaths for each frame, and some of processes that had stored a frame before:
    # how many depends on how soon the threads reach a deadly frame.
    assert 2 * MOST_DEATHS <= deaths <= 4 * MOST_DEATHS + FRAMES_BEFORE + 4


def test_run_killed_from_outside_repeatedly_is_not_quarantined(data):
    done = 0
    with served(data, UNGHOST_WORKERS="1") as (_, api):
        name = create_slow_dataset(api, FRAMES_OF_LONG_RUN)
    for kill in range(KILLS):
        with served(data, UNGHOST_WORKERS="1") as (server, api):
            if kill == 0:
                request_run(api, name)
            until(partial(has_progressed, data, done), "the run does not go on")
            server.process.kill()
            server.process.wait()
        chunks = rows_of(data, "SELECT state, attempts FROM chunks ORDER BY number")
        assert chunks[0] == ("waiting", 0)
        _, _, done = last_run(data)
        assert 0 < done < FRAMES_OF_LONG_RUN
    with served(data) as (_, api):
        check_run_results(
            api, name, wait_for_run_end(api, last_run(data)[0]), FRAMES_OF_LONG_RUN
        )
