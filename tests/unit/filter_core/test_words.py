"""The words in type hints are those of the enumerations and tables they stand for."""

from __future__ import annotations

from typing import get_args

from filter_core.evidence_kinds import EVIDENCE, EvidenceChoice
from filter_core.types import Reason, ReasonLabel, Verdict, VerdictName


def test_every_reason_has_its_own_label():
    assert [reason.name.lower() for reason in Reason] == list(get_args(ReasonLabel))
    assert [reason.label for reason in Reason] == list(get_args(ReasonLabel))


def test_the_names_of_verdicts_are_their_values():
    assert [verdict.value for verdict in Verdict] == list(get_args(VerdictName))


def test_every_kind_of_evidence_is_described_once_and_in_its_place():
    assert list(EVIDENCE) == list(get_args(EvidenceChoice))
