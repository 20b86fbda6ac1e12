"""docs/formats.md lists the layouts, formats and options that there are."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from app.schemas.runs import ExportIn, ExportOptions
from filter_core.formats.registry import LAYOUTS
from tests.docs.documents import read

COMING_IN, GOING_OUT = read("docs/formats.md").split("## What goes out")


def rows(text, header):
    """First cells of the table below a header row that starts so."""
    table = text.split(f"| {header} |")[1].split("\n\n")[0]
    return re.findall(r"^\| `([\w-]+)` \|", table, re.MULTILINE)


def test_every_layout_is_described():
    assert rows(COMING_IN, "layout") == [name for name in LAYOUTS if name != "auto"]


def test_every_export_format_is_described():
    formats = get_args(ExportIn.model_fields["format"].annotation)

    assert rows(GOING_OUT, "format") == list(formats)


@pytest.mark.parametrize("option", ExportOptions.model_fields)
def test_every_export_option_is_described_with_its_default(option):
    default = ExportOptions.model_fields[option].default
    row = re.search(rf"^\| `{option}` \| (.*?) \|", GOING_OUT, re.MULTILINE)

    assert row is not None
    assert f"`{str(default).lower()}`" in row[1]
    for choice in get_args(ExportOptions.model_fields[option].annotation):
        assert not isinstance(choice, str) or f"`{choice}`" in row[1]
