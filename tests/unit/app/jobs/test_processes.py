"""Names of processes, and whether the process of a name has ended."""

from __future__ import annotations

from app.jobs.processes import process_has_ended, this_process
from tests.support.leases import ELSEWHERE, ended_process


def test_a_process_knows_itself_and_the_dead_from_the_living():
    assert this_process() != this_process()
    assert not process_has_ended(this_process())
    assert process_has_ended(ended_process())
    assert not process_has_ended(ELSEWHERE)
    assert not process_has_ended("nonsense")


def test_a_number_that_another_process_has_by_now_is_no_sign_of_life():
    machine, pid, started, rest = this_process().split("/")

    assert process_has_ended("/".join((machine, pid, str(int(started) - 1), rest)))
