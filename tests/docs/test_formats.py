"""docs/formats.md lists every layout, every format of exports and every option."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from tests.support.documents import read
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


def test_the_table_has_every_layout():
    found = rows_with("read, recognised by")

    assert found == [name for name in LAYOUTS if name != "auto"]


def test_the_table_has_every_format_that_the_api_exports():
    formats = get_args(ExportIn.model_fields["format"].annotation)

    assert rows_with("written") == list(formats)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_a_title_and_a_description(name):
    assert FORMATS[name].title
    assert FORMATS[name].docs_row
    assert bool(FORMATS[name].brief) == (FORMATS[name].write is not None)
    assert "|" not in FORMATS[name].docs_row + FORMATS[name].recognised_by


@pytest.mark.parametrize("option", ExportOptions.model_fields)
def test_every_export_option_is_described_with_its_default(option):
    default = ExportOptions.model_fields[option].default
    row = re.search(rf"^\| `{option}` \| (.*?) \|", GOING_OUT, re.MULTILINE)

    assert row is not None
    assert f"`{str(default).lower()}`" in row[1]
    for choice in get_args(ExportOptions.model_fields[option].annotation):
        assert not isinstance(choice, str) or f"`{choice}`" in row[1]


@pytest.mark.parametrize("option", ExportOptions.model_fields)
def test_every_export_option_lists_the_formats_that_support_it(option):
    row = re.search(rf"^\| `{option}` \|.*\| (.*?) \|$", GOING_OUT, re.MULTILINE)

    assert row is not None
    has_it = {name for name in EXPORT_FORMATS if option in FORMATS[name].options}
    assert named(row[1]) == has_it


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
