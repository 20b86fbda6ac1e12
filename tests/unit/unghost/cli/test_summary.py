"""The summary of boxes: what is noted, and what makes the exit code 3."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from filter_core.config.filter import FilterConfig
from filter_core.inspection.remarks import BoxSummary, RecordingAdvice
from filter_core.local import ClassCount
from unghost.cli.screen import Refused, Screen
from unghost.cli.summary import (
    DatasetAdvice,
    UnmappedOptions,
    note_boxes,
    unmapped_names,
)


def noted(capsys, classes, advice=None):
    """Whether the summary asks for exit code 3, and its lines."""
    summary = BoxSummary(advice or RecordingAdvice())
    summary.add(classes)
    return note_boxes(Screen(), summary), capsys.readouterr().err.splitlines()


@pytest.mark.parametrize(
    ("classes", "is_serious", "said"),
    [
        ({"car": ClassCount(50, 49)}, False, None),
        ({"car": ClassCount(50), "bus": ClassCount(19, 19)}, False, "of: bus (19)"),
        ({"car": ClassCount(50), "bus": ClassCount(20, 20)}, True,
         "of: bus (20); look"),
        ({"bus": ClassCount(19, 19)}, False, "every box is rejected (19); look"),
        ({"van": ClassCount(10, 10), "bus": ClassCount(10, 10)}, True,
         "rejected (20);"),
        ({"car": ClassCount(9, 0, 0, 1000, 10)}, False, None),
        ({"car": ClassCount(9, 0, 0, 1000, 11)}, True, "inside boxes of: car (1.1 %)"),
        ({"Misc": ClassCount(1, 0, 1), "car": ClassCount(9)}, True, "1 box is unm"),
        ({"Misc": ClassCount(9), "car": ClassCount(9)}, False, None),
    ],
)  # fmt: skip
def test_summary_notes_what_was_probably_not_understood(
    capsys, classes, is_serious, said
):
    serious, lines = noted(capsys, classes)

    assert serious is is_serious
    assert (said is None) == (lines == [])
    assert said is None or said in lines[0]


def test_counts_of_frames_add_up(capsys):
    summary = BoxSummary(RecordingAdvice())
    for _ in range(20):
        summary.add({"car": ClassCount(1, 1, 0, 100, 2), "bus": ClassCount(1)})

    assert summary.boxes == {"car": 20, "bus": 20}
    assert note_boxes(Screen(), summary)
    said = capsys.readouterr().err
    assert "car (20)" in said
    assert "car (2.0 %)" in said


def test_names_of_one_class_are_noted_and_a_dataset_can_join_them(capsys):
    classes = {
        name: ClassCount(2)
        for name in ("Car", "car", "street_light", "traffic_light", "bus", "Misc")
    }

    serious, lines = noted(capsys, classes)
    _, of_dataset = noted(capsys, classes, DatasetAdvice(dataset="town"))
    _, frozen = noted(capsys, classes, DatasetAdvice(dataset="town", are_frozen=True))

    assert not serious
    assert frozen == [
        "names of one class, which are measured alike and kept apart: Car (2), car (2) "
        "(car); street_light (2), traffic_light (2) (traffic_light)"
    ]
    assert (
        "traffic_light (2) (traffic_light; `classes: {street_light: {name: "
        "traffic_light}}` in recording.yaml joins two)"
    ) in lines[0]
    joined = "Car (2), car (2) (car; `unghost classes merge town Car car` joins two); "
    assert joined in of_dataset[0]


def test_remedy_for_a_misspelt_class_of_a_dataset(capsys):
    classes = {"Caar": ClassCount(1, 0, 1), "buss": ClassCount(1, 0, 1)}
    town = DatasetAdvice(dataset="town", classes=("Caar", "car", "buss"))

    _, (said,) = noted(capsys, classes, town)
    _, (frozen,) = noted(capsys, classes, replace(town, are_frozen=True))

    assert "Caar (1; `unghost classes merge town Caar car`)" in said
    assert "buss (1; `unghost classes rename town buss bus`)" in said
    assert "Caar (1; did you mean 'car'?)" in frozen
    assert "`unghost config set town FILE`" in frozen


def test_class_map_decides_which_names_are_unknown():
    config = FilterConfig.from_mapping(
        {"classes": {"Misc": "pass", "Sign": {"accept": ["TrafficSign"]}, "Box": "car"}}
    )

    names = unmapped_names(["Misc", "Sign", "Box", "Pedestrian", "dragon"], config)

    assert names == ["dragon"]


@pytest.mark.parametrize(
    ("dragons", "outcome"),
    [
        (5, nullcontext()),
        (6, pytest.raises(Refused, match=r"6 of 11 boxes .* dragon \(6\); --class-m")),
    ],
)
def test_command_stops_if_more_than_half_of_the_boxes_are_unknown(dragons, outcome):
    boxes = {"car": 5, "dragon": dragons}
    others = FilterConfig(), RecordingAdvice()

    UnmappedOptions(allow_unmapped=True).require_known(boxes, *others)
    UnmappedOptions().require_known({}, *others)
    with outcome:
        UnmappedOptions().require_known(boxes, *others)
