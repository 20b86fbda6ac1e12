"""Commands that are started in a folder from somebody else run no file of it."""

import json
import subprocess
from contextlib import closing

import pytest

from tests.support.api import Api
from tests.support.archives import TAR, tar_archive
from tests.support.folders import LAYOUT_FILES
from tests.support.foreign_folder import ForeignFolder
from tests.support.frames import write_manifest
from tests.support.servers import environ_of, start_anew, stop, token_of, wait_for_link
from unghost.cli.local.filter import FEWEST_FRAMES, FEWEST_PROCESSES

DONE = 0
LONG_S = 120


@pytest.fixture
def foreign(tmp_path) -> ForeignFolder:
    return ForeignFolder.below(tmp_path)


def test_filter_runs_no_python_file_of_the_folder_that_it_is_started_in(
    foreign, tmp_path
):
    """Nor do its worker processes; their lines are written in the order of frames."""
    write_manifest(foreign.path, 1)
    manifest = foreign.path / "manifest.jsonl"
    line, keys = manifest.read_text(), [f"run/{n:06}" for n in range(FEWEST_FRAMES)]
    manifest.write_text("".join(line.replace("run/000000", key) for key in keys))

    ended = subprocess.run(
        foreign.command("filter", ".", "-o", "-", "--workers", FEWEST_PROCESSES),
        cwd=foreign.path,
        env=environ_of(tmp_path / "data", {}),
        capture_output=True,
        check=False,
        text=True,
        timeout=LONG_S,
    )

    assert ended.returncode == DONE, ended.stderr
    assert [json.loads(line)["key"] for line in ended.stdout.splitlines()] == keys
    assert foreign.names_run() == set()


def test_service_runs_no_python_file_of_the_folder_that_it_is_started_in(
    foreign, tmp_path
):
    data, log = foreign.path / "data", tmp_path / "log"
    process = start_anew(foreign.command("serve"), data, log, {})
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        api = Api.at(url, {"Authorization": f"Bearer {token_of(data)}"})
        with closing(api.http):
            frame = api.upload_frame(api.dataset(), "a")
            # Both are done by child processes.
            drawn = api.get(f"/frames/{frame['frame']['id']}/overlay")
            read = api.http.post(
                "/api/v1/folders",
                content=tar_archive(LAYOUT_FILES["kitti"].items()),
                headers=TAR,
            )
    finally:
        stop(process)

    assert (drawn.status_code, read.status_code) == (200, 200), read.text
    assert foreign.names_run() == set()
