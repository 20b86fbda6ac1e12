"""The wire's words are those of the library's and of the service's own tables."""

from __future__ import annotations

from typing import get_args

import pytest

from app.verdicts import REVIEW_STATES
from filter_core.config.keys import EvidenceName
from filter_core.decisions.record import OcclusionLevel
from filter_core.evaluation import comparison, thresholds
from filter_core.formats import export, manifest
from filter_core.formats.registry import EXPORT_FORMATS, LAYOUTS
from filter_core.segmentation import reading
from filter_core.types import Answer, ReasonLabel, Verdict
from unghost.wire import runs, words


@pytest.mark.parametrize(
    ("hint", "table"),
    [
        (words.Verdict, [one.value for one in Verdict]),
        (words.Answer, [*(one.name.lower() for one in Answer if one), "clear"]),
        (words.ReviewState, REVIEW_STATES),
        (words.EvidenceName, get_args(EvidenceName)),
        (words.Reason, get_args(ReasonLabel)),
        (words.OcclusionLevel, get_args(OcclusionLevel)),
        (words.FileKind, manifest.FRAME_FILES),
        (words.Layout, LAYOUTS),
        (words.FolderLayout, LAYOUTS[1:]),
        (words.Palette, reading.PALETTES),
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
def test_words_are_those_of_the_table(hint, table):
    assert get_args(hint) == tuple(table)


def test_an_export_has_as_many_bands_as_the_library_takes():
    assert (runs.MAX_BAND, runs.MAX_BANDS) == (export.MAX_BAND, export.MAX_BANDS)
