"""The client against a real server: a run's progress, end and differences."""

from __future__ import annotations

import pytest

import unghost

STRICT = {"min_visible_pixels": 500}


@pytest.fixture
def strict_run(client, filled) -> unghost.Run:
    """A finished run that rejects boxes which the active run keeps."""
    run: unghost.Run = client.wait(client.start_run(filled, STRICT))
    return run


def test_run_events_continue_until_the_run_is_done(client, filled):
    run = client.start_run(filled, STRICT)

    told = list(client.events(run))

    assert told[-1].state == "done"
    assert told[-1].changed == 3
    assert {each.id for each in told} == {run.id}


def test_events_of_a_finished_run_are_only_its_end(client, strict_run):
    assert [each.state for each in client.events(strict_run.id)] == ["done"]


def test_events_of_a_missing_run_raise_not_found(client):
    with pytest.raises(unghost.NotFound):
        list(client.events(10**9))


def test_diff_compares_two_runs(client, strict_run):
    diff = client.diff(strict_run)

    assert (diff.run, diff.total, diff.kept_to_rejected) == (strict_run.id, 3, 3)
    assert (diff.rejected_to_kept, diff.by_class) == (0, {"car": 3})
    back = client.diff(diff.against, strict_run)
    assert (back.kept_to_rejected, back.rejected_to_kept) == (0, 3)


def test_flips_of_a_run_are_listed(client, strict_run):
    flips = list(client.flips(strict_run))

    assert [flip.class_name for flip in flips] == ["car"] * 3
    assert {flip.before.verdict for flip in flips} == {"kept"}
    assert {flip.after.reason for flip in flips} == {"no_visible_pixels"}
