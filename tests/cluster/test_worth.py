"""`unghost worth-it` trains on the workers of a cluster."""

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from tests.support.cluster import cluster, kill_working_process
from tests.support.command_line import CommandLine
from tests.support.databases import give_tables
from tests.support.experiments import parrot, write_recording
from tests.support.servers import stop
from tests.support.waiting import until

DONE, REFUSED = 0, 1
ARMS = ("raw", "depth")
SEEDS = 3


@pytest.fixture(scope="module")
def cluster_of_two(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("cluster")) as made:
        give_tables(made.data, {})  # a worker needs a database, and no service
        made.scheduler()
        workers = [made.worker(joined=False) for _ in range(2)]
        for worker in workers:
            worker.wait_for_log("joined the scheduler")
        yield made, workers


@pytest.fixture
def words(tmp_path):
    folder = write_recording(tmp_path / "frames")
    arms, seeds = ",".join(ARMS), str(SEEDS)
    arguments = ("--arms", arms, "--seeds", seeds, "--trainer", parrot(tmp_path))
    return ("worth-it", folder, *arguments)


def on_cluster(made, tmp_path):
    """The command line with the certificate of a service."""
    return CommandLine(tmp_path, made.tls("client"))


def results(output: Path) -> dict[str, bytes | list[str]]:
    """The trials' files by path: contents, or what a result of JSON has."""
    return {
        str(path.relative_to(output)): sorted(json.loads(path.read_bytes()))
        if path.name == "result.json"
        else path.read_bytes()
        for path in (output / "trials").rglob("*.*")
    }


def trainers(folder: Path) -> set[int]:
    """The processes of trainers that run now."""
    pids = {int(path.name.removeprefix("pid-")) for path in folder.glob("pid-*")}
    return {pid for pid in pids if Path(f"/proc/{pid}/cmdline").exists()}


def test_workers_write_what_one_machine_does_and_train_nothing_again(
    cluster_of_two, words, tmp_path
):
    made, _ = cluster_of_two
    unghost = on_cluster(made, tmp_path)
    here, there = tmp_path / "on-one-machine", tmp_path / "on-a-cluster"
    hold, runs = tmp_path / "hold", tmp_path / "runs.txt"
    local = unghost(*words, "-o", here)
    runs.unlink()

    hold.touch()
    with unghost.running(*words, "-o", there, "--engine", made.address) as process:
        until(lambda: len(trainers(tmp_path)) == 2, "not both workers train")
        hold.unlink()
        _, said = process.communicate()
        code = process.wait()
    trained = runs.read_text().splitlines()
    again = unghost(*words, "-o", there, "--engine", made.address)

    assert (local.code, code, again.code) == (DONE, DONE, DONE), said + again.err
    expected = {f"{arm} {seed}" for arm in ARMS for seed in range(SEEDS)}
    assert (set(trained), len(trained)) == (expected, len(expected))
    assert runs.read_text().splitlines() == trained
    assert "train: 6 of 6 trials" in said
    assert results(there) == results(here)
    for name in ("report.json", "report.txt", "report.html"):
        written = (there / name).read_text().replace(there.name, here.name)
        assert written == (here / name).read_text()


def test_trial_of_a_killed_worker_is_done_again_and_its_trainer_ends(
    cluster_of_two, words, tmp_path
):
    made, workers = cluster_of_two
    output, hold = tmp_path / "out", tmp_path / "hold"
    hold.touch()
    unghost = on_cluster(made, tmp_path)
    with unghost.running(*words, "-o", output, "--engine", made.address) as process:
        until(lambda: len(trainers(tmp_path)) == 2, "not both workers train")
        begun = trainers(tmp_path)
        kill_working_process(workers[0])
        until(lambda: len(begun & trainers(tmp_path)) == 1, "its trainer goes on")
        hold.unlink()
        _, said = process.communicate()
        code = process.wait()

    assert code == DONE, said
    assert said.count("its worker was lost; another one trains it") == 1
    trained = (tmp_path / "runs.txt").read_text().splitlines()
    assert len(trained) == len(ARMS) * SEEDS + 1
    assert len(set(trained)) == len(ARMS) * SEEDS
    assert len(list(output.glob("trials/*/seed-*/result.json"))) == len(ARMS) * SEEDS


def test_interrupted_command_ends_the_trainers_on_the_workers(
    cluster_of_two, words, tmp_path
):
    made, _ = cluster_of_two
    (tmp_path / "hold").touch()
    unghost = on_cluster(made, tmp_path)
    arguments = (*words, "-o", tmp_path / "out", "--engine", made.address)
    with unghost.running(*arguments) as process:
        until(lambda: len(trainers(tmp_path)) == 2, "not both workers train")
        process.send_signal(signal.SIGINT)
        code = process.wait(30)

    assert code == 130
    until(lambda: not trainers(tmp_path), "trainers go on")


@pytest.mark.skipif(
    sys.platform != "linux" or os.getuid() != 0,
    reason="only where one may mount",
)
def test_worker_that_does_not_see_the_folder_is_refused_with_the_remedy(
    cluster_of_two, words, tmp_path
):
    made, _ = cluster_of_two
    output = tmp_path / "out"
    output.mkdir()
    (tmp_path / "hold").touch()
    blind = made.worker(program=("tests.support.blind_worker", str(output)))
    try:
        result = on_cluster(made, tmp_path)(
            *words, "-o", output, "--engine", made.address
        )
    finally:
        stop(blind.process)

    assert result.code == REFUSED
    assert f"does not see {output}: mount the folder there" in result.err
    until(lambda: not trainers(tmp_path), "trainers go on")


def test_scheduler_that_is_away_or_refuses_is_named(bare_unghost, words, tmp_path):
    arguments = (*words, "-o", tmp_path / "out", "--engine")

    away = bare_unghost(*arguments, "tcp://127.0.0.1:9")
    open_to_all = bare_unghost(*arguments, "tcp://192.0.2.1:8786")
    without = bare_unghost(*arguments, "tls://127.0.0.1:9")

    assert (away.code, without.code) == (REFUSED, REFUSED), away.err + without.err
    assert "no scheduler accepts this at tcp://127.0.0.1:9" in away.err
    assert "tls:// needs UNGHOST_TLS_CA" in without.err
    assert "is not encrypted" in " ".join(open_to_all.err.split())
    assert not (tmp_path / "out").exists()
