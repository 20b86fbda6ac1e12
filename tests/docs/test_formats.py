"""docs/formats.md lists every layout, every format of exports and every option."""

import json
import re
from typing import get_args

import pytest

from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from filter_core.formats.same import STORED
from tests.support.documents import read
from tests.support.exporting import box, export, frame
from tools.reference import part_pattern
from unghost.wire.runs import ExportIn, ExportOptions

DOCUMENT = read("docs/formats.md")
_, GOING_OUT = DOCUMENT.split("## Writing")


def rows_with(column):
    """The formats that have text in this column of the document's table of formats."""
    part = part_pattern("formats").search(DOCUMENT)
    assert part is not None
    header, _, *rows = (line.strip("| ").split(" | ") for line in part[2].splitlines())
    assert header == [
        "format",
        "title",
        "what it holds",
        "read, recognised by",
        "written",
    ]
    at = header.index(column)
    padded = ([*row, *[""] * len(header)] for row in rows)
    return [row[0].strip("`") for row in padded if row[at].strip()]


def test_the_table_has_every_layout_and_format_of_exports():
    formats = get_args(ExportIn.model_fields["format"].annotation)

    assert rows_with("written") == list(formats)
    layouts = [name for name in LAYOUTS if name != "auto"]
    assert rows_with("read, recognised by") == layouts


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_a_title_and_a_description(name):
    assert FORMATS[name].title
    assert FORMATS[name].docs_row
    assert bool(FORMATS[name].brief) == (FORMATS[name].write is not None)
    assert "|" not in FORMATS[name].docs_row + FORMATS[name].recognised_by


@pytest.mark.parametrize("option", ExportOptions.model_fields)
def test_every_export_option_has_its_default_and_the_formats_that_support_it(option):
    default = ExportOptions.model_fields[option].default
    row = re.search(rf"^\| `{option}` \| (.*?) \|.*\| (.*?) \|$", GOING_OUT, re.M)

    assert row is not None
    shown = str(default).lower() if default != "" else '""'
    assert f"`{shown}`" in row[1]
    for choice in get_args(ExportOptions.model_fields[option].annotation):
        assert not isinstance(choice, str) or f"`{choice}`" in row[1]
    has_it = {name for name in EXPORT_FORMATS if option in FORMATS[name].options}
    assert named(row[2]) == has_it


def rows_of_the_same_format():
    """The rows of the table of what is read, kept and lost."""
    head = "\n| format | what is read | in the same format |"
    _, _, table = GOING_OUT.partition(head)
    lines = table.split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines]
    return {row[0].strip("`"): row[1:] for row in cells}


def test_the_table_of_what_is_kept_says_which_formats_are_written_as_they_came():
    able = {
        name: "as it came" if form.box_spans else "no"
        for name, form in FORMATS.items()
        if form.read
    }

    assert {name: row[1] for name, row in rows_of_the_same_format().items()} == able
    written = {name for name, form in FORMATS.items() if form.write and form.box_spans}
    assert written - {"manifest"} == STORED


RICH = frame(
    "a",
    box(
        0,
        given={
            "id": "7",
            "instance_id": 9,
            "vertices": [[x, y, z] for x in (5, 9) for y in (0, 2) for z in (0, 2)],
            "distance": 7.5,
            "kitti": {"truncated": 0.5},
            "occluded": 1,
            "pose": "Left",
            "truncated": 1,
            "difficult": 1,
            "track": 3,
        },
    ),
    annotation={
        "map": "Town01",
        "camera": {"width": 100, "height": 80, "fov": 90},
        "dontcare": [[1, 2, 3, 4]],
        "weather": {"rain": 1.5},
        "captured_at": "2026-11-30T01:00:00Z",
    },
)


@pytest.mark.parametrize("name", sorted(rows_of_the_same_format()))
def test_the_table_of_what_is_kept_lists_what_has_no_place(name):
    without_place = rows_of_the_same_format()[name][2]
    if name not in EXPORT_FORMATS:
        assert without_place == "not written"
        return

    manifest = json.loads(export(name, [RICH])["manifest.json"])

    losses = manifest.get("without_place", {})
    if isinstance(losses, str):
        assert without_place == "all but class and rectangle"
        return
    keys = [*losses.get("boxes", {}), *losses.get("frames", {})]
    assert set(re.findall("`(.*?)`", without_place)) == set(keys)
    assert keys or without_place == "nothing"


def named(text: str) -> set[str]:
    """The formats that a cell stands for: "`yolo`, `coco`", or "labels but `cvat`"."""
    some, _, others = text.partition(" but ")
    return members(some) - members(others)


def members(text: str) -> set[str]:
    """The formats of a group, such as "labels", or those named in backticks."""
    groups = {
        "all": EXPORT_FORMATS,
        "labels": [name for name in FORMATS if "boxes" in FORMATS[name].options],
        "decisions": [name for name in FORMATS if name.startswith("decisions-")],
    }
    return set(groups.get(text, re.findall("`(.*?)`", text)))
