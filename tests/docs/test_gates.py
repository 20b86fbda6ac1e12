"""The examples of gates run as they are printed, and fail when a condition holds."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.support import frames
from tests.support.command_line import CommandLine
from tests.support.documents import blocks, read

ACTIONS, PRE_COMMIT = map(
    yaml.safe_load,
    (text for text in blocks(read("docs/commands.md"), "yaml") if "--fail-if" in text),
)


@pytest.fixture
def repository(tmp_path):
    """A folder with a recording of two frames, each with a kept and a rejected box."""
    frames.write_manifest(tmp_path / "recordings" / "town10", 2)
    return tmp_path


def run(command, folder):
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    summary = str(folder / "summary.md")
    return subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PATH": programs, "GITHUB_STEP_SUMMARY": summary},
        capture_output=True,
        text=True,
        check=False,
    )


def test_example_for_github_actions_passes_and_writes_a_summary(repository):
    gate, summary = (
        step["run"] for step in ACTIONS["jobs"]["boxes"]["steps"] if "run" in step
    )

    done = [run(["sh", "-euc", script], repository) for script in (gate, summary)]

    assert [process.returncode for process in done] == [0, 0], done
    rows = (repository / "summary.md").read_text().splitlines()
    assert "| `rejected > 60%` | 50.00% (2 of 4 boxes) | passed |" in rows
    assert "| `unmapped > 0` | 0 | passed |" in rows


def test_example_for_pre_commit_passes(repository):
    (hook,) = PRE_COMMIT["repos"][0]["hooks"]

    done = run(shlex.split(hook["entry"]), repository)

    assert (done.returncode, "gate passed: unmapped > 0, it is 0" in done.stderr) == (
        0,
        True,
    ), done


def test_condition_that_holds_ends_with_4_and_is_named_with_its_figure(repository):
    words = ["filter", "recordings/town10", "--output", "d.jsonl"]
    words += ["--fail-if", "rejected>=50%", "--fail-if", "kept < 2"]

    done = CommandLine(repository, {})(*words, "--gate-report", "gates.xml")

    assert done.code == 4, done
    said = "gate failed: rejected>=50%, it is 50.00% (2 of 4 boxes)"
    assert said in done.err
    assert "gate passed: kept < 2, it is 2" in done.err
    report = (repository / "gates.xml").read_text()
    assert 'tests="2" failures="1"' in report
    assert 'name="not rejected&gt;=50%"><failure message=' in report


def test_wrong_condition_is_refused_before_anything_is_decided(repository):
    command = ("filter", "recordings/town10", "--output", "d.jsonl")
    for condition, words in [
        ("rejectd > 5%", "found 'rejectd'; did you mean 'rejected'?"),
        ("rejected > many", "expected a condition such as 'rejected > 5%'"),
    ]:
        done = CommandLine(repository, {})(*command, "--fail-if", condition)

        assert (done.code, (repository / "d.jsonl").exists()) == (2, False)
        assert words in " ".join(done.err.split())
