"""The words in type hints are those of the enumerations and tables they stand for."""

from __future__ import annotations

from typing import get_args

from filter_core.evidence_kinds import EVIDENCE, EvidenceChoice
from filter_core.verdicts import Reason, ReasonLabel, Verdict, VerdictName


def test_reason_labels_equal_the_type_hint():
    assert {reason.label for reason in Reason} == {*get_args(ReasonLabel)}
    for label in get_args(ReasonLabel):
        assert Reason[label.upper()] in Reason.with_label(label)


def test_verdict_values_equal_the_type_hint():
    assert [verdict.value for verdict in Verdict] == list(get_args(VerdictName))


def test_evidence_table_equals_the_type_hint():
    assert list(EVIDENCE) == list(get_args(EvidenceChoice))
