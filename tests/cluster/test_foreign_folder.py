"""Nodes of a cluster run no Python file of a folder from somebody else."""

from __future__ import annotations

from tests.support import processes
from tests.support.cluster import Node, cluster
from tests.support.foreign_folder import ForeignFolder
from tests.support.run_results import check_run_results, post_run, wait_for_run_end
from tests.support.servers import environ_of, stop
from tests.support.slow_datasets import create_slow_dataset
from tests.support.sources import CHECKOUT

FRAMES = 2


def test_worker_runs_no_python_file_of_the_folder_that_it_is_started_in(tmp_path):
    foreign, log = ForeignFolder.below(tmp_path), tmp_path / "log"
    with cluster(tmp_path / "cluster") as made:
        made.scheduler()
        with made.server() as (_, api), log.open("w") as errors:
            settings = {"UNGHOST_ENGINE": made.address, **made.tls("worker")}
            environ = environ_of(made.data, {**settings, "PYTHONPATH": str(CHECKOUT)})
            process = processes.start_anew(
                foreign.command("worker"), foreign.path, environ, errors
            )
            try:
                Node(process, log).wait_for_log("joined the scheduler")
                name = create_slow_dataset(api, FRAMES)
                run = wait_for_run_end(api, post_run(api, name))
                check_run_results(api, name, run, FRAMES)
            finally:
                stop(process)

    assert foreign.names_run() == set()


def test_nodes_keep_out_of_a_scratch_folder_that_somebody_made_for_dask(tmp_path):
    """On a machine for several people, `/tmp/dask-scratch-space` may be another's."""
    foreign = ForeignFolder.below(tmp_path, "dask-scratch-space")
    foreign.path.chmod(0o777)
    before = set(foreign.path.iterdir())
    with cluster(tmp_path / "cluster", anew=True) as made:
        made.settings["TMPDIR"] = str(tmp_path)
        with made.server():
            made.scheduler()
            made.worker()

    assert foreign.names_run() == set()
    assert set(foreign.path.iterdir()) == before
    assert list(tmp_path.glob("unghost-*")) == []
