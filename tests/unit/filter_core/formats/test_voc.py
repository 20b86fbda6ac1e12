"""Reading Pascal VOC files: corners, sizes, and messages about faults."""

import pytest

from filter_core.errors import LayoutError
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import read_source
from filter_core.formats.voc import read_voc
from tests.support.folders import annotation_of, write_files
from tests.support.shared_data import shared


def voc(corners=(1, 2, 30, 40), extra="", size="<width>80</width><height>60</height>"):
    names = ("xmin", "ymin", "xmax", "ymax")
    box = "".join(f"<{n}>{v}</{n}>" for n, v in zip(names, corners, strict=True))
    return (
        f"<annotation>\n<size>{size}</size>\n<object>\n<name>traffic light</name>"
        f"{extra}<bndbox>{box}</bndbox>\n</object></annotation>"
    ).encode()


def test_integer_voc_coordinates_are_one_based_and_texts_are_unescaped():
    annotation = read_voc(voc((1, 2, 30, 40), "<truncated>1</truncated>"), "a.xml")

    assert annotation == {
        "camera": {"width": 80, "height": 60},
        "boxes": [{"class": "traffic light", "xyxy": [0, 1, 30, 40], "truncated": 1}],
    }
    content = (
        b'<?xml version="1.0"?><!-- by hand --><annotation verified="yes"><object>'
        b"<name>car &amp; <![CDATA[van]]></name><pose>Left</pose><occluded/><bndbox>"
        b"<xmin>1</xmin><ymin>2</ymin><xmax>10</xmax><ymax>20</ymax></bndbox></object>"
        b"</annotation>"
    )

    assert read_voc(content, "a.xml") == {
        "boxes": [{"class": "car & van", "xyxy": [0, 1, 10, 20], "pose": "Left"}]
    }
    no_size = "<width>0</width><height>0</height>"
    assert "camera" not in read_voc(voc(size=no_size), "a.xml")


def read_all(folder, options=None):
    """The rectangles of each frame of a folder, and the notes about it."""
    frames = read_source(folder, options=options)
    rectangles = {
        frame.key: [box["xyxy"] for box in annotation_of(frame)["boxes"]]
        for frame in frames
    }
    return rectangles, frames.notes()


def objects(*corners):
    """A file with several boxes."""
    parts = [voc(each).split(b"<object>")[1].split(b"</object>")[0] for each in corners]
    return (
        voc().split(b"<object>")[0]
        + b"".join(b"<object>" + part + b"</object>" for part in parts)
        + b"</annotation>"
    )


@pytest.mark.parametrize(
    ("files", "origin", "why"),
    [
        ({"a": [(1, 2, 30, 40)]}, 1, "from 1, both ends included: no corner is 0"),
        ({"a": [(1, 2, 3, 4), (9.5, 1, 20, 20)]}, 1, "no corner is 0"),
        ({"a": [(1, 2, 3, 4)], "b": [(0, 2, 3, 4)]}, 0,
         "from 0: 1 of 2 boxes have a corner at 0"),
        ({"a": [(5, 6, 7, 8)] * 50, "b": [(0, 2, 3, 4)]}, 1,
         "only 1 of 51 boxes have a corner at 0, the first in Annotations/b.xml"),
        ({"a": [(5, 6, 7, 8)] * 50, "b": [(0, 2, 3, 4)] * 3}, 0,
         "from 0: 3 of 53 boxes have a corner at 0"),
        ({"a": [(1, 2.5, 30, 40)]}, 0, "from 0: 1 of 1 boxes have fractions"),
        ({"a": [(1, 2, 3, 4)], "b": [(1.5, 2, 3, 4)], "c": [(1, 2, 3.1, 4)]}, 0,
         "2 of 3 boxes"),
    ],
)  # fmt: skip
def test_first_pixel_is_decided_once_for_all_files(tmp_path, files, origin, why):
    for name, corners in files.items():
        write_files(tmp_path, {f"Annotations/{name}.xml": objects(*corners)})
    expected = {
        name: [[x - origin, y - origin, *ends] for x, y, *ends in corners]
        for name, corners in files.items()
    }

    assert read_all(tmp_path)[0] == expected
    (note,) = read_all(tmp_path)[1]
    assert why in note
    other = 1 - origin
    assert f"`boxes: {{origin: {other}}}` in recording.yaml says so" in note
    changed, notes = read_all(
        tmp_path, RecordingDescription(origin="1" if origin == 0 else "0")
    )
    assert changed != expected
    assert notes == ()


def test_utf_16_shows_the_first_pixel_too(tmp_path):
    text = objects((0, 2, 3, 4)).decode()
    content = f'<?xml version="1.0" encoding="utf-16"?>{text}'.encode("utf-16")
    write_files(tmp_path, {"a.xml": content, "b.xml": voc((5, 6, 7, 8))})

    assert read_all(tmp_path)[0] == {"a": [[0, 2, 3, 4]], "b": [[5, 6, 7, 8]]}


def test_a_fraction_moves_no_other_box():
    """The car is at the same place in both files of the case."""
    whole, _ = read_all(shared("cases/13-voc-coco-oddities/voc-int"))
    mixed, _ = read_all(shared("cases/13-voc-coco-oddities/voc-mixed"))

    assert whole["1"][0] == mixed["1"][0] == [186, 180, 260, 223]


def test_images_of_one_name_in_two_folders_are_two_frames(tmp_path):
    def named(folder):
        names = f"<folder>{folder}</folder><filename>1.png</filename><size>".encode()
        return voc().replace(b"<size>", names)

    labels = {"front_1": named("front"), "x/left_1": named("C:\\data\\left")}
    write_files(tmp_path, {f"Annotations/{key}.xml": labels[key] for key in labels})
    names = ("JPEGImages/front/1.png", "JPEGImages/left/1.png")
    tags = ("seg/front/1.png", "seg/left/1.png")
    write_files(tmp_path, dict.fromkeys((*names, *tags)))

    frames = read_source(tmp_path)

    assert frames.unmatched == ()
    expected = dict(zip(labels, (tmp_path / name for name in names), strict=True))
    assert {each.key: each.image for each in frames} == expected
    assert [each.segmentation for each in frames] == [tmp_path / name for name in tags]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (voc((1, "x", 3, 4)),
         "a.xml, line 4: expected a finite number in <ymin>, found"),
        (voc((1, "nan", 3, 4)), "found 'nan'"),
        (voc(size="<width>8.5</width><height>6</height>"), "a whole <width>"),
        (voc(size="<width>8</width>"), "line 2: expected <height> in <size>"),
        (b"<annotation>\n<object/></annotation>", "line 2: expected <bndbox>"),
        (b"<note/>", "expected <annotation>, found <note>"),
        (b"<annotation>\n<object>", "a.xml, line 2"),
        (b"", "cannot be read as XML"),
        (b"<a>\n<b></a>",
         "a.xml, line 2, column 6: cannot be read as XML: mismatched tag"),
        (b"<a b=c></a>", "a.xml, line 1"),
        (b"not xml", "a.xml, line 1, column 1: cannot be read as XML"),
        (b"<annotation>" + b"<object>" * 100_000 + b"</object>" * 100_000,
         "at most 500000 elements in 32 levels"),
        (b"<annotation>" + b"<a/>" * 500_000, "at most 500000 elements"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><annotation/>', "a DTD or entities"),
        (b'<?xml version="1.0" encoding="nope"?><annotation/>', "unknown encoding"),
        (b"<" + b"n" * 1000 + b"/>", "found <" + "n" * 40 + ">"),
    ],
)  # fmt: skip
def test_invalid_voc_file_error_names_line_and_expected_value(content, words):
    with pytest.raises(LayoutError) as caught:
        read_voc(content, "a.xml")

    assert words in caught.value.detail


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


def test_usual_xml_namespaces_are_ignored_and_xmlns_in_a_comment_is_refused():
    content = voc().replace(
        b"<annotation>",
        b'<annotation xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        b"xmlns:xsd = 'http://www.w3.org/2001/XMLSchema'>",
    )

    assert read_voc(content, "a.xml") == read_voc(voc(), "a.xml")
    content = voc().replace(b"<annotation>", b"<annotation><!-- no xmlns here -->")

    with pytest.raises(LayoutError) as refused:
        read_voc(content, "a.xml")

    assert refused.value.detail == (
        "a.xml: expected a namespace of at most 100 characters after each `xmlns`, "
        "also in comments and texts"
    )


def test_voc_folder_is_read_and_an_invalid_file_is_reported(tmp_path):
    files = {"Annotations/7.xml": voc(), "Annotations/bad.xml": b"<a"}
    others = {"JPEGImages/7.png": None, "SegmentationClass/ignored.txt": ""}

    good, bad = read_source(write_files(tmp_path, {**files, **others}))

    assert (good.key, good.image) == ("7", tmp_path / "JPEGImages/7.png")
    assert "Annotations/bad.xml, line 1" in str(bad.problem)
