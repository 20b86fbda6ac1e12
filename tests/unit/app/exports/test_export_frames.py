"""What an export reads of a dataset: all that its format needs, and nothing else."""

from typing import get_args

import numpy as np
import pytest

from app.catalog.datasets import DatasetRepository
from app.exports.writer import ExportFrames
from filter_core.formats.export import ExportHead, ExportOptions
from filter_core.formats.format import Need
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export
from filter_core.verdicts import VERDICTS


@pytest.fixture(scope="module")
def street(make_street):
    return make_street()


def export_frames(street, session, needs):
    context, dataset = street.context, street.row(session)
    return ExportFrames(context.storage.read, session, dataset, needs, context.drawers)


@pytest.mark.parametrize("form", EXPORT_FORMATS)
def test_format_declares_all_data_that_it_needs(street, form):
    with street.context.database.read() as session:
        classes = tuple(DatasetRepository(session).classes(street.id))
        declared, all_data = (
            files_of(form, export_frames(street, session, needs), classes)
            for needs in (FORMATS[form].needs, get_args(Need))
        )

    assert declared == all_data


def test_label_columns_equal_the_complete_decisions(street):
    with street.context.database.read() as session:
        frames = list(export_frames(street, session, ["decisions"]))

    for frame in frames:
        boxes, whole = frame.boxes, frame.decisions
        rows = range(len(boxes))
        told = {
            "id": list(boxes.ids),
            "class": [boxes.class_name(row) for row in rows],
            "verdict": [VERDICTS[code].value for code in boxes.verdict],
            "effective_verdict": [boxes.effective_verdict(row) for row in rows],
            "reason": [boxes.reason_label(row) for row in rows],
            "lossy": boxes.lossy.tolist(),
            "occluded": boxes.occlusion.tolist(),
            "xyxy": as_json_values(boxes.xyxy),
            "amodal_xyxy": as_json_values(boxes.amodal_xyxy),
            "visible_xyxy": as_json_values(boxes.visible_xyxy),
            "tight_xyxy": as_json_values(boxes.tight_xyxy),
            "distance": as_json_values(boxes.distance),
            "match_percent": as_json_values(boxes.match_percent),
        }
        assert told == {key: [line[key] for line in whole] for key in told}
        reviewed = [bool(line["review"]) for line in whole]
        assert (boxes.answer > 0).tolist() == reviewed
    assert sum(len(frame.boxes) for frame in frames) > 0


def as_json_values(column):
    """The values of a column as in JSON: None instead of NaN."""
    return [
        None if np.isnan(value).any() else value.tolist()
        for value in np.asarray(column)
    ]


def files_of(form, frames, classes):
    """The files of an export by name."""
    files = {}

    def collect_file(name, pieces):
        files[name] = b"".join(pieces)

    write_export(form, frames, collect_file, ExportHead(classes), ExportOptions())
    return files
