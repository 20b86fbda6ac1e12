"""Each node of a cluster is killed or stopped in the middle of a run or an export."""

import os
import signal
import time

import pytest

from tests.support import frames
from tests.support.cluster import cluster, working_process
from tests.support.databases import DATABASE_URL, migrated_postgres
from tests.support.poison import EMPTY, poisoned_files
from tests.support.run_results import (
    check_run_results,
    get_run,
    post_run,
    start_run,
    wait_for_run_end,
)
from tests.support.servers import STOP_WAIT_S, stop
from tests.support.slow_datasets import FROM_PIXELS, OTHER_PIXELS, create_slow_dataset
from tests.support.waiting import until

pytestmark = pytest.mark.long

FRAMES = 60


def start_workers_and_run(made, api, config=FROM_PIXELS, *, workers=1):
    """Start workers and a run.

    Gives the workers, the dataset's name and the run's number before the run ends.
    """
    joined = [made.worker() for _ in range(workers)]
    name = create_slow_dataset(api, FRAMES)
    return joined, name, start_run(api, name, config)


def test_run_waits_for_a_killed_scheduler_and_completes(made):
    scheduler = made.scheduler()
    with made.server() as (_, api):
        workers, name, run_id = start_workers_and_run(made, api, workers=2)

        scheduler.kill()
        until(
            lambda: all("lost the connection" in worker.log_text for worker in workers),
            "no notice",
        )
        assert get_run(api, run_id)["state"] == "running"
        made.scheduler()

        check_run_results(api, name, wait_for_run_end(api, run_id), FRAMES)


def test_hanging_scheduler_does_not_block_cancelling_or_stopping(made):
    scheduler = made.scheduler()
    # The library's own regular requests are made rare, so that only the service's count
    # of workers meets the connection that does not answer.
    quiet = {"DASK_DISTRIBUTED__CLIENT__SCHEDULER_INFO_INTERVAL": "1 hour"}
    with made.server(**quiet) as (server, api):
        _, _, run_id = start_workers_and_run(made, api)
        scheduler.process.send_signal(signal.SIGSTOP)
        try:
            # Longer than the service keeps its count of workers before it counts again.
            time.sleep(4)
            response = api.post(f"/runs/{run_id}/cancel")
            begun = time.monotonic()
            stop(server.process)
            took_s = time.monotonic() - begun
        finally:
            scheduler.process.send_signal(signal.SIGCONT)

    assert response.json()["state"] == "cancelled", response.text
    assert took_s < STOP_WAIT_S


def test_restarted_server_resumes_the_run_of_a_killed_server(made):
    made.scheduler()
    with made.server() as (server, api):
        _, name, run_id = start_workers_and_run(made, api)
        server.process.kill()
        server.process.wait()

    with made.server() as (_, api):
        check_run_results(api, name, wait_for_run_end(api, run_id), FRAMES)


def test_another_server_takes_over_the_run_of_a_killed_server(made):
    made.scheduler()
    with migrated_postgres() as url:  # with SQLite, there is only one server
        made.settings[DATABASE_URL] = url
        with made.server() as (first, api), made.server() as (_, other):
            _, name, run_id = start_workers_and_run(made, api)
            first.process.kill()
            first.process.wait()

            check_run_results(other, name, wait_for_run_end(other, run_id), FRAMES)


def test_only_the_frame_that_kills_workers_is_quarantined(made):
    made.scheduler()
    with made.server() as (_, api):
        program = ("tests.support.poisoned_worker",)
        for _ in range(2):
            made.worker(program=program)
        name = create_slow_dataset(api, FRAMES)
        first = api.json(f"/datasets/{name}/frames", limit=1)["items"][0]
        api.upload_frame(name, "zz-poison", EMPTY, **poisoned_files())
        for key in ("zz-behind", "zz-last"):
            files = {"image": frames.image(), "segmentation": frames.segmentation()}
            api.upload_frame(name, key, EMPTY, **files)
        failed = wait_for_run_end(api, post_run(api, name))

    assert failed["state"] == "failed"
    assert failed["error"]["code"] == "quarantined"
    assert "'zz-poison'" in failed["error"]["detail"]
    assert first["key"] not in failed["error"]["detail"]
    assert failed["done"] == FRAMES + 2

    with made.server(UNGHOST_ENGINE="local") as (_, api):
        run = wait_for_run_end(api, post_run(api, name))
        check_run_results(api, name, run, FRAMES + 3, empty=3)


def test_stopped_worker_returns_its_work_and_the_run_completes(made):
    made.scheduler()
    with made.server() as (_, api):
        (leaving,), _, run_id = start_workers_and_run(made, api, OTHER_PIXELS[1])

        leaving.process.send_signal(signal.SIGTERM)
        code = leaving.wait_for_exit()
        done = get_run(api, run_id)["done"]
        made.worker()
        run = wait_for_run_end(api, run_id)

    assert (code, "stopped" in leaving.log_text) == (0, True)
    assert 0 < done < FRAMES
    assert run["error"] is None
    assert (run["state"], run["done"]) == ("done", FRAMES)


@pytest.mark.parametrize("dies", ["worker", "server"])
def test_export_completes_after_its_worker_or_server_is_killed(made, dies):
    made.scheduler()
    with made.server() as (server, api):
        worker, name = made.worker(), create_slow_dataset(api, 5)
        expected = api.wait_for_job(post_export(api, name))
        busy = working_process(worker)
        os.kill(busy, signal.SIGSTOP)
        response = post_export(api, name)
        until(lambda: get_export(api, response)["state"] == "running", "nobody begins")
        if dies == "server":
            server.process.kill()
            server.process.wait()
            os.kill(busy, signal.SIGCONT)
        else:
            os.kill(busy, signal.SIGKILL)
            until(
                lambda: get_export(api, response)["state"] == "done",
                "it is not written",
            )

    with made.server() as (_, api):
        done = api.wait_for_job(response)

    assert (done["state"], done["error"]) == ("done", None)
    assert done["sha256"] == expected["sha256"]


def post_export(api, name):
    return api.post(f"/datasets/{name}/exports", {"format": "decisions-jsonl"})


def get_export(api, response):
    return api.json(f"/exports/{response.json()['id']}")


def test_worker_that_lost_its_scheduler_exits_with_69_and_a_message(made):
    scheduler = made.scheduler()
    with made.server():
        worker = made.worker("--patience", "3")
        scheduler.kill()

        assert worker.wait_for_exit() == 69
    assert "lost the connection" in worker.log_text
    assert "cannot connect to the scheduler" in worker.log_text


def test_child_process_of_a_killed_worker_ends(made):
    made.scheduler()
    with made.server():
        worker = made.worker()
        child = working_process(worker)

        worker.kill()

        until(lambda: "stopped" in worker.log_text, f"{child} works on")


def test_run_fails_if_its_worker_uses_another_database(made, tmp_path):
    made.scheduler()
    (tmp_path / "elsewhere").mkdir()
    with (
        cluster(tmp_path / "elsewhere") as other,
        other.server(UNGHOST_ENGINE="local"),
        made.server() as (_, api),
    ):
        made.worker("--data", str(other.data))
        run = wait_for_run_end(api, post_run(api, create_slow_dataset(api, 1)))

    assert run["error"]["code"] == "worker_elsewhere"
    assert "UNGHOST_DATABASE_URL" in run["error"]["detail"]


@pytest.mark.parametrize("is_away", [False, True], ids=["at work", "no scheduler"])
def test_stopped_server_leaves_its_run_to_the_next_server(made, is_away):
    scheduler = made.scheduler()
    with made.server() as (server, api):
        _, name, run_id = start_workers_and_run(made, api)
        if is_away:
            scheduler.kill()
            until(lambda: "waits for workers" in server.log.read_text(), "no notice")

        server.process.send_signal(signal.SIGTERM)
        code = server.process.wait(20)
    if is_away:
        made.scheduler()

    assert code == 0
    assert "Traceback" not in server.log.read_text()
    with made.server() as (_, api):
        check_run_results(api, name, wait_for_run_end(api, run_id), FRAMES)
