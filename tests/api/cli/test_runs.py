"""Runs on the command line: waited for, interrupted, cancelled, compared."""

import json
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.command_line import CommandLine
from tests.support.slow_datasets import OTHER_PIXELS
from tests.support.waiting import until
from unghost import Client, Conflict

pytestmark = pytest.mark.long

DONE, REFUSED, INTERRUPTED = 0, 1, 130
FRAMES = 150


@pytest.fixture
def unghost(slow, tmp_path: Path) -> CommandLine:
    server, *_ = slow
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    (tmp_path / "strict.yaml").write_text("min_visible_pixels: 1000000\n")
    return CommandLine(tmp_path, settings)


def interrupted(unghost, slow, config, *options):
    """Interrupt `run --wait` part way; return its messages, and the run afterwards."""
    server, _, dataset = slow
    (unghost.folder / "pixels.yaml").write_text(json.dumps(config))
    words = ("run", dataset, "--config", "pixels.yaml", "--wait", *options)
    with Client(server.url, server.token) as client:
        before = next(client.runs(dataset)).id
        with unghost.running(*words) as process:
            until(lambda: next(client.runs(dataset)).id != before)
            newest = next(client.runs(dataset))
            next(state for state in client.events(newest) if state.done)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
        assert process.returncode == INTERRUPTED
        return err, client.run(newest.id)


def test_interrupting_run_wait_leaves_the_run_running(unghost, slow):
    err, run = interrupted(unghost, slow, OTHER_PIXELS[0])

    assert run.state == "running"
    assert f"run {run.id} continues on the server" in err
    assert f"`unghost cancel {run.id}` cancels it" in err
    assert unghost("wait", run.id).out.startswith(f"run {run.id}\tdone\t")


def test_interrupting_with_cancel_on_interrupt_cancels_the_run(unghost, slow):
    err, run = interrupted(unghost, slow, OTHER_PIXELS[1], "--cancel-on-interrupt")

    assert run.state == "cancelled"
    assert f"run {run.id} was cancelled" in err


def test_cancel_on_interrupt_without_wait_is_refused(unghost, tmp_path):
    (tmp_path / "filter.yaml").write_text("min_visible_pixels: 3")

    result = unghost(
        *("run", "town", "--config", "filter.yaml", "--cancel-on-interrupt")
    )

    assert result.code == 2
    assert "--cancel-on-interrupt is for --wait" in result.err


def test_cancel_command_cancels_a_run_and_waiting_for_it_fails(unghost, slow):
    server, _, dataset = slow
    with Client(server.url, server.token) as client:
        runs = [client.start_run(dataset, config).id for config in OTHER_PIXELS[2:6]]

        cancelled = unghost("cancel", runs[-1])

        assert (cancelled.code, cancelled.out) == (DONE, f"run {runs[-1]}\tcancelled\n")
        for code in (unghost(word, runs[-1]).code for word in ("wait", "cancel")):
            assert code == REFUSED
        for run in runs[:-1]:
            with suppress(Conflict):
                client.cancel(run)


def test_run_wait_prints_progress(unghost, slow):
    *_, dataset = slow

    result = unghost("run", dataset, "--config", "strict.yaml", "--wait")

    assert result.code == DONE
    assert f"{FRAMES} of {FRAMES} frames" in result.err
    assert f"0 kept, {2 * FRAMES} rejected" in result.out


def test_diff_command_compares_two_runs_per_class(unghost, slow):
    server, _, dataset = slow
    run = unghost("run", dataset, "--config", "strict.yaml", "--wait", "--json")
    with Client(server.url, server.token) as client:
        active = client.dataset(dataset).active_run

    numbers = (active, run.records[0]["id"])
    lines = unghost("diff", *numbers).out.splitlines()
    *boxes, sums = unghost("diff", *reversed(numbers), "--json").records

    sides = f"{FRAMES}\t{FRAMES}\t0"
    assert lines == [f"car\t{sides}", f"all\t{sides}"]
    assert len({box["box_id"] for box in boxes}) == FRAMES
    assert {box["after"]["verdict"] for box in boxes} == {"kept"}
    assert (sums["kept_to_rejected"], sums["rejected_to_kept"]) == (0, FRAMES)
