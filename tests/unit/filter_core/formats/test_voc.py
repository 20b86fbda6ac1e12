"""Reading Pascal VOC files: corners, sizes, and messages about faults."""

from __future__ import annotations

import pytest

from filter_core.errors import LayoutError
from filter_core.formats.registry import read_source
from filter_core.formats.voc import read_voc
from tests.support.folders import write_files


def voc(corners=(1, 2, 30, 40), extra="", size="<width>80</width><height>60</height>"):
    names = ("xmin", "ymin", "xmax", "ymax")
    box = "".join(f"<{n}>{v}</{n}>" for n, v in zip(names, corners, strict=True))
    return (
        f"<annotation>\n<size>{size}</size>\n<object>\n<name>traffic light</name>"
        f"{extra}<bndbox>{box}</bndbox>\n</object></annotation>"
    ).encode()


def test_integer_voc_coordinates_are_one_based_and_inclusive():
    annotation = read_voc(voc((1, 2, 30, 40), "<truncated>1</truncated>"), "a.xml")

    assert annotation == {
        "camera": {"width": 80, "height": 60},
        "boxes": [
            {"class": "traffic light", "xyxy": [0, 1, 30, 40], "truncated": 1},
        ],
    }


def test_fractional_voc_coordinates_are_not_changed():
    annotation = read_voc(voc((1, 2.5, 30, 40)), "a.xml")

    expected = [{"class": "traffic light", "xyxy": [1, 2.5, 30, 40]}]
    assert annotation["boxes"] == expected


def test_xml_text_is_unescaped_and_comments_are_ignored():
    content = (
        b'<?xml version="1.0"?><!-- by hand --><annotation verified="yes"><object>'
        b"<name>car &amp; <![CDATA[van]]></name><pose>Left</pose><occluded/><bndbox>"
        b"<xmin>1</xmin><ymin>2</ymin><xmax>10</xmax><ymax>20</ymax></bndbox></object>"
        b"</annotation>"
    )

    assert read_voc(content, "a.xml") == {
        "boxes": [{"class": "car & van", "xyxy": [0, 1, 10, 20], "pose": "Left"}]
    }


def test_image_size_of_zero_is_ignored():
    size = "<width>0</width><height>0</height>"

    assert "camera" not in read_voc(voc(size=size), "a.xml")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            voc((1, "x", 3, 4)),
            "a.xml, line 4: expected a finite number in <ymin>, found",
        ),
        (voc((1, "nan", 3, 4)), "found 'nan'"),
        (voc(size="<width>8.5</width><height>6</height>"), "a whole <width>"),
        (voc(size="<width>8</width>"), "line 2: expected <height> in <size>"),
        (b"<annotation>\n<object/></annotation>", "line 2: expected <bndbox>"),
        (b"<note/>", "expected <annotation>, found <note>"),
        (b"<annotation>\n<object>", "a.xml, line 2"),
        (b"", "cannot be read as XML"),
        (
            b"<a>\n<b></a>",
            "a.xml, line 2, column 6: cannot be read as XML: mismatched tag",
        ),
        (b"<a b=c></a>", "a.xml, line 1"),
        (b"not xml", "a.xml, line 1, column 1: cannot be read as XML"),
        (
            b"<annotation>" + b"<object>" * 100_000 + b"</object>" * 100_000,
            "at most 500000 elements in 32 levels",
        ),
        (b"<annotation>" + b"<a/>" * 500_000, "at most 500000 elements"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><annotation/>', "a DTD or entities"),
        (b'<?xml version="1.0" encoding="nope"?><annotation/>', "unknown encoding"),
        (b"<" + b"n" * 1000 + b"/>", "found <" + "n" * 40 + ">"),
    ],
)
def test_invalid_voc_file_error_names_line_and_expected_value(content, words):
    with pytest.raises(LayoutError) as caught:
        read_voc(content, "a.xml")

    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("content", "detail"),
    [
        (b"<a>\n<b></a>", "line 2, column 6: cannot be read as XML: mismatched tag"),
        (b"", "line 1, column 1: cannot be read as XML: no element found"),
        (
            b"<a>&b;</a>",
            "line 1, column 4: cannot be read as XML: undefined entity",
        ),
    ],
)
def test_xml_fault_names_its_place_once(content, detail):
    with pytest.raises(LayoutError) as caught:
        read_voc(content, "a.xml")

    assert caught.value.detail == f"a.xml, {detail}"


LONG = "u" * 101


@pytest.mark.parametrize(
    "declaration",
    [
        f'xmlns="{LONG}"',
        f"xmlns:p='{LONG}'",
        f"xmlns:p\n= '{LONG}'",
        f'xmlns:{LONG}="u"',
        f'xmlns:a="u" xmlns:b="{LONG}"',
        f'xmlns:b="xmlns{LONG}"',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_long_xml_namespace_is_refused_before_it_is_written_out(declaration, encoding):
    # The parser puts the namespace before each name: 8 MB before 500,000 of them.
    text = f'<?xml version="1.0" encoding="{encoding}"?><annotation {declaration}/>'

    with pytest.raises(LayoutError, match="a namespace of at most 100 characters"):
        read_voc(text.encode(encoding), "a.xml")


def test_file_with_xmlns_in_a_comment_is_refused_with_the_reason():
    content = voc().replace(b"<annotation>", b"<annotation><!-- no xmlns here -->")

    with pytest.raises(LayoutError) as refused:
        read_voc(content, "a.xml")

    assert refused.value.detail == (
        "a.xml: expected a namespace of at most 100 characters after each `xmlns`, "
        "also in comments and texts"
    )


def test_usual_xml_namespaces_are_ignored():
    content = voc().replace(
        b"<annotation>",
        b'<annotation xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        b"xmlns:xsd = 'http://www.w3.org/2001/XMLSchema'>",
    )

    assert read_voc(content, "a.xml") == read_voc(voc(), "a.xml")


def test_voc_folder_is_read_and_an_invalid_file_is_reported(tmp_path):
    write_files(
        tmp_path,
        {
            "JPEGImages/7.png": None,
            "Annotations/7.xml": voc(),
            "Annotations/bad.xml": b"<a",
            "SegmentationClass/ignored.txt": "",
        },
    )

    good, bad = read_source(tmp_path)

    assert (good.key, good.image) == ("7", tmp_path / "JPEGImages/7.png")
    assert "Annotations/bad.xml, line 1" in str(bad.problem)
