"""Nodes of a cluster run no Python file of a folder from somebody else."""

from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support import processes
from tests.support.cluster import Node, cluster
from tests.support.foreign_folder import ForeignFolder
from tests.support.run_results import check_run_results, post_run, wait_for_run_end
from tests.support.servers import environ_of, stop
from tests.support.slow_datasets import create_slow_dataset
from tests.support.sources import CHECKOUT

pytestmark = pytest.mark.long

FRAMES = 2


class Used(NamedTuple):
    """What a cluster has left, whose worker was started in a foreign folder."""

    started_in: ForeignFolder
    scratch: ForeignFolder
    """The `dask-scratch-space` of the folder for temporary files."""
    files_before: set[Path]
    """What it had in it at first."""
    own_folders: int
    """How many folders of their own the nodes had while they ran."""


@pytest.fixture(scope="module")
def used(tmp_path_factory):
    temporary = tmp_path_factory.mktemp("temporary")
    scratch = ForeignFolder.below(temporary, "dask-scratch-space")
    scratch.path.chmod(0o777)
    files_before = set(scratch.path.iterdir())
    folder = tmp_path_factory.mktemp("made")
    foreign, log = ForeignFolder.below(folder), folder / "log"
    with cluster(folder / "cluster", anew=True) as made:
        made.settings["TMPDIR"] = str(temporary)
        made.scheduler()
        with made.server() as (_, api), log.open("w") as errors:
            settings = {"UNGHOST_ENGINE": made.address, **made.tls("worker")}
            settings |= {"PYTHONPATH": str(CHECKOUT), **made.settings}
            process = processes.start_anew(
                foreign.command("worker"),
                foreign.path,
                environ_of(made.data, settings),
                errors,
            )
            try:
                Node(process, log).wait_for_log("joined the scheduler")
                own_folders = len(list(temporary.glob("unghost-*")))
                name = create_slow_dataset(api, FRAMES)
                run = wait_for_run_end(api, post_run(api, name))
                check_run_results(api, name, run, FRAMES)
            finally:
                stop(process)
    return Used(foreign, scratch, files_before, own_folders)


def test_worker_runs_no_python_file_of_the_folder_that_it_is_started_in(used):
    assert used.started_in.names_run() == set()


def test_nodes_keep_out_of_a_scratch_folder_that_somebody_made_for_dask(used):
    """On a machine for several people, `/tmp/dask-scratch-space` may be another's."""
    scratch = used.scratch.path

    assert used.scratch.names_run() == set()
    assert set(scratch.iterdir()) == used.files_before
    assert used.own_folders == 2
    assert list(scratch.parent.glob("unghost-*")) == []
