"""The API's words are the same as in the library's and the service's own tables."""

import re
from typing import get_args

import pytest
from sqlalchemy import CheckConstraint

from app.db import tables
from app.db.tables import access
from app.verdicts import REVIEW_STATES
from filter_core.decisions.record import OcclusionLevel
from filter_core.evaluation import comparison, thresholds
from filter_core.evidence_kinds import EVIDENCE, EvidenceChoice, EvidenceName
from filter_core.formats import export, manifest
from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import EXPORT_FORMATS
from filter_core.segmentation import reading
from filter_core.verdicts import Answer, Reason, ReasonLabel, Verdict, VerdictName
from unghost.wire import runs, words

JOB_STATES = get_args(words.JobState)
ANSWERS_BUT_CLEAR = [answer for answer in get_args(words.Answer) if answer != "clear"]


@pytest.mark.parametrize(
    ("hint", "table"),
    [
        (words.Verdict, [verdict.value for verdict in Verdict]),
        (VerdictName, [verdict.value for verdict in Verdict]),
        (EvidenceChoice, EVIDENCE),
        (words.Answer, [*(each.name.lower() for each in Answer if each), "clear"]),
        (words.ReviewState, REVIEW_STATES),
        (words.EvidenceName, get_args(EvidenceName)),
        (words.Reason, get_args(ReasonLabel)),
        (words.OcclusionLevel, get_args(OcclusionLevel)),
        (words.FileKind, manifest.FRAME_FILES),
        (words.Layout, LAYOUTS),
        (words.FolderLayout, LAYOUTS[1:]),
        (words.Palette, reading.FAMILY_NAMES),
        (words.Encoding, get_args(reading.Encoding)),
        (words.ChannelOrder, get_args(reading.OrderOfChannels)),
        (words.LossyPolicy, get_args(reading.Lossy)),
        (words.ExportFormat, EXPORT_FORMATS),
        (words.Include, get_args(export.Include)),
        (words.RejectedBoxes, get_args(export.Rejected)),
        (words.Rectangle, get_args(export.Boxes)),
        (words.Images, get_args(export.Images)),
        (words.WrongVerdict, get_args(comparison.WrongVerdict)),
        (words.ThresholdTarget, get_args(thresholds.Target)),
    ],
)
def test_allowed_values_equal_those_of_library_and_server(hint, table):
    assert get_args(hint) == tuple(table)


@pytest.mark.parametrize(
    ("table", "column", "taken"),
    [
        (access.Token, "role", get_args(words.Role)),
        (tables.Run, "kind", get_args(words.RunKind)),
        (tables.Run, "state", JOB_STATES),
        (tables.Export, "state", JOB_STATES),
        (tables.Review, "verdict", get_args(words.Answer)),
        (tables.Decision, "review", ANSWERS_BUT_CLEAR),
    ],
)
def test_allowed_values_equal_those_of_database_constraints(table, column, taken):
    checks = {
        str(check.name).rpartition("_")[2]: str(check.sqltext)
        for check in table.__table__.constraints
        if isinstance(check, CheckConstraint)
    }

    assert re.findall(r"'(\w+)'", checks[column]) == list(taken)


def test_reason_labels_and_limits_of_exports_equal_those_of_the_library():
    assert {reason.label for reason in Reason} == {*get_args(ReasonLabel)}
    for label in get_args(ReasonLabel):
        assert Reason[label.upper()] in Reason.with_label(label)
    for limit in ("MAX_BAND", "MAX_BANDS", "MAX_PICTURES"):
        assert getattr(runs, limit) == getattr(export, limit)
