"""Other Python processes search for modules where the process that starts them does."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.foreign_folder import ForeignFolder
from tests.support.sources import CHECKOUT

PATIENCE_S = 60
PRINTING = "import json, sys; print(json.dumps([sys.argv[1:], sys.path]))"
STARTING = """
import multiprocessing
import sys

from filter_core.processes import child_context

def work(pipe):
    pipe.send(sys.path)

if __name__ == "__main__":
    child_context([])  # spawned processes start as safely as those that are forked
    context = multiprocessing.get_context(sys.argv[1])
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=[theirs])
    process.start()
    assert ours.recv() == sys.path
    process.join()
"""
PRELOADING = """
import sys

from filter_core.processes import child_context

def work(pipe):
    pipe.send({"colorsys", "fractions"} & {*sys.modules})

if __name__ == "__main__":
    context = child_context(["colorsys"])
    child_context(["fractions"])
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=[theirs])
    process.start()
    assert ours.recv() == {"colorsys", "fractions"}
    process.join()
"""
RUNNING = """
import json
import subprocess
import sys

from filter_core.processes import module_command

ran = subprocess.run(module_command("printing", "-a", "b"), stdout=subprocess.PIPE)
assert json.loads(ran.stdout) == [["-a", "b"], sys.path]
"""


@pytest.fixture
def foreign(tmp_path: Path) -> ForeignFolder:
    return ForeignFolder.below(tmp_path)


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (STARTING, ["forkserver"]),
        (STARTING, ["spawn"]),
        (RUNNING, []),
        (PRELOADING, []),  # forked ones have the modules of every caller
    ],
)
def test_started_processes_search_where_their_parent_does_and_nowhere_else(
    foreign, tmp_path, program, words
):
    modules = tmp_path / "given"
    modules.mkdir()
    (modules / "printing.py").write_text(PRINTING, "utf-8")
    script = tmp_path / "bin" / "program.py"
    script.write_text(program, "utf-8")

    ended = subprocess.run(
        [sys.executable, str(script), *words],
        cwd=foreign.path,
        env={"PYTHONPATH": f"{modules}:{CHECKOUT}"},
        capture_output=True,
        check=False,
        text=True,
        timeout=PATIENCE_S,
    )

    assert ended.returncode == 0, ended.stderr
    assert foreign.names_run() == set()
