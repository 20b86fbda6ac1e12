"""`unghost inspect`: what it prints and writes, and its exit code."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.support.folders import LAYOUT_FILES, mixed_recording, write_files
from tests.support.frames import write_manifest
from tests.support.pictures import png

DONE, REFUSED, PARTLY = 0, 1, 3


def test_inspect_shows_a_folder_and_what_helps(bare_unghost, tmp_path):
    folder = mixed_recording(tmp_path / "street")

    result = bare_unghost("inspect", folder)

    assert result.code == PARTLY
    lines = result.out.splitlines()
    assert lines[0] == "# recording\trecording\tis"
    assert "# images\trole\timages\ttold by\tsuch as" in lines
    assert "recording\tholds\t21 frames, 108 boxes" in lines
    assert "recording\tsplit (folder)\ttrain: 14 frames" in lines
    assert "images\tpicture\t46\tname\ttrain/images/000.png" in lines
    assert "class\tcar\t42\tcar\t42\t42\t0\t0\t2.5\ttag 100 (5,376 px)" in lines
    assert any("\tCaar\t21\tunknown; is it car?\t" in line for line in lines)
    assert "file\tand 15 more like this\tno label file for this image" in lines
    assert "! 42 boxes are unmeasured" in result.err
    assert "--class-map Caar=car" in result.err
    assert "unknown inside boxes of: car (2.5 %)" in result.err


def test_inspect_writes_a_description_that_filter_carries_out(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 2)
    written = folder / "recording.yaml"

    result = bare_unghost("inspect", folder, "--write", written)

    assert result.code == DONE
    assert "palette: carla-0.9.14" in written.read_text()
    assert bare_unghost("filter", folder).code == DONE
    again = bare_unghost("inspect", folder, "--write", written)
    assert (again.code, again.out) == (REFUSED, "")
    assert f"{written} exists already" in again.err
    elsewhere = tmp_path / "other.yaml"
    assert bare_unghost("inspect", folder, "--write", elsewhere).code == DONE
    assert elsewhere.read_text() == written.read_text()


WRAPPED_YOLO = {
    "town/data.yaml": "names: [car]\n",
    "town/images/1.png": None,
    "town/labels/1.txt": "0 0.5 0.5 0.1 0.2\n",
}


def test_folder_around_the_one_folder_of_a_recording_is_entered(bare_unghost, tmp_path):
    outer = write_files(tmp_path / "download", {**WRAPPED_YOLO, ".hidden": ""})
    beside = write_files(tmp_path / "two", {**WRAPPED_YOLO, "other/a.txt": ""})

    inspected = bare_unghost("inspect", outer, "--json")
    converted = bare_unghost("convert", outer, "--to", "kitti", "-o", tmp_path / "out")
    ambiguous = bare_unghost("inspect", beside, "--json")

    (record,) = inspected.records
    assert (record["layout"], record["frames"]) == ("yolo", 1), inspected.err
    assert converted.code == DONE, converted.err
    assert (tmp_path / "out/training/label_2/000000.txt").exists()
    assert ambiguous.records[0]["layout"] is None


def test_folder_that_is_read_itself_is_not_entered(bare_unghost, tmp_path):
    pictures = write_files(tmp_path / "pictures", {"town/1.png": None})
    tracks = {
        "a run/image_02/0001/000000.png": None,
        "a run/label_02/0001.txt": "0 3 Car 0 0 -1.6 10 5 20 16 1.5 1.6 3.9 1 1.5 9 0",
        "a run/calib/0001.txt": "P2: 1 0 0 0 0 1 0 0 0 0 1 0",
    }
    tracking = write_files(tmp_path / "tracking", tracks)

    keys = [
        [record["key"] for record in bare_unghost("filter", folder).records]
        for folder in (pictures, tracking)
    ]

    assert keys == [["town/1"], ["a run/0001/000000"]]


def test_description_has_a_line_for_each_class_that_a_person_has_to_name(
    bare_unghost, tmp_path
):
    folder = mixed_recording(tmp_path / "street")
    written = tmp_path / "written.yaml"
    bare_unghost("inspect", folder, "--write", written)
    text = written.read_text()

    assert '# classes:\n#   "Kasten": pass\n#   "Caar": car\n' in text

    named = text.replace("\n# classes:", "\nclasses:").replace("\n#   ", "\n  ")
    written.write_text(named)
    result = bare_unghost("inspect", folder, "--recording", written, "--json")
    (record,) = result.records
    assert {row["name"]: row["measured_as"] for row in record["classes"]} == {
        "car": "car",
        "walker": "walker",
        "Kasten": "pass",
        "Caar": "car",
        "bus": "bus",
    }


def test_record_has_everything_but_the_pictures(bare_unghost, tmp_path):
    result = bare_unghost("inspect", mixed_recording(tmp_path / "street"), "--json")

    (record,) = result.records
    assert result.code == PARTLY
    assert record["left_over"][0]["count"] == 25
    assert [len(frame["boxes"]) >= 5 for frame in record["drawn"]] == [True] * 3
    assert record["drawn"][0].keys() == {"key", "wh", "boxes", "outside"}
    assert record["segmentation"]["readings"][0]["encoding"] == "raw"
    assert record["streams"][0]["told_by"] == ["name"]
    assert [note["is_serious"] for note in record["remarks"]] == [True] * 4 + [False]
    assert "layout: yolo" in record["description"]


FOLDERS = {
    "labels of VOC": {"data.yaml": b"names: [car]", **LAYOUT_FILES["voc"]},
    "unreadable segmentation": {**LAYOUT_FILES["pairs"], "1.png": None},
    "no class list": {"images/1.png": None, "labels/1.txt": b"0 .5 .5 .1 .1"},
    "picture without a label": {
        "data.yaml": b"names: [car]",
        "a/labels/1.txt": b"0 .5 .5 .1 .1",
        "a/images/1.png": None,
        "a/images/2.png": None,
    },
    "unknown class": {
        "data.yaml": b"names: [Kasten]",
        "labels/1.txt": b"0 .5 .5 .1 .1",
        "images/1.png": None,
    },
    "nothing wrong": {
        "data.yaml": b"names: [car]",
        "labels/1.txt": b"0 .5 .5 .1 .1",
        "images/1.png": None,
    },
}


@pytest.mark.parametrize("name", FOLDERS)
def test_inspect_succeeds_where_filter_does(bare_unghost, tmp_path, name):
    folder = write_files(tmp_path / "folder", FOLDERS[name])

    inspected = bare_unghost("inspect", folder)
    filtered = bare_unghost("filter", folder, "--allow-unmapped", "-o", "d.jsonl")

    assert inspected.code in (DONE, PARTLY)
    assert (inspected.code == DONE) == (filtered.code == DONE)
    assert (inspected.code == DONE) == ("! " not in inspected.err)
    is_refused = name in ("labels of VOC", "unreadable segmentation")
    assert is_refused == ("\nrefused\t" in inspected.out)
    assert (name == "nothing wrong") == (inspected.code == DONE)


class _Page(HTMLParser):
    """The tags of a page, and all addresses that it names."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [v for name, v in attrs if name in ("src", "href")]


def test_page_is_one_file_whatever_names_files_and_classes_have(bare_unghost, tmp_path):
    evil = '<script>alert(1)</script>"&'
    picture = png(np.zeros((60, 80, 3), np.uint8))
    files = {
        "data.yaml": json.dumps({"names": [evil]}).encode(),
        f"images/{evil.replace('/', ' ')}.png": picture,
        f"labels/{evil.replace('/', ' ')}.txt": b"0 .5 .5 .1 .1\n",
    }
    folder = write_files(tmp_path / "<b>folder", files)

    result = bare_unghost("inspect", folder, "--html", "page.html")

    assert result.code == PARTLY
    page = _Page((tmp_path / "page.html").read_text("utf-8"))
    assert "script" not in page.tags
    assert page.tags.count("figure") == page.tags.count("image") == 1
    assert page.addresses
    assert all(url.startswith("data:image/jpeg;base64,") for url in page.addresses)


def test_page_has_the_colours_of_the_review_page():
    from tests.support.sources import CHECKOUT
    from unghost.cli.inspect_page import COLORS

    css = (CHECKOUT / "static/css/tokens.css").read_text("utf-8")
    pattern = re.compile(r"(--[\w-]+): ([^;]+);")
    in_light, in_dark = (
        dict(pattern.findall(re.sub(r"light-dark\((.+), (.+)\);", theme, css)))
        for theme in (r"\1;", r"\2;")
    )
    for own, tokens in zip(COLORS, (in_light, in_dark, in_light), strict=True):
        values = dict(pattern.findall(own))
        assert values
        assert values == {name: tokens[name] for name in values}


def test_folders_of_options_are_in_the_source_or_as_the_shell_has_them(
    bare_unghost, tmp_path
):
    files = {"a.png": png(np.zeros((60, 80, 3), np.uint8)), "a.json": '{"boxes": []}'}
    folder = write_files(tmp_path / "run", {**files, "gt/a.png": files["a.png"]})
    write_files(tmp_path / "elsewhere", {"a.png": files["a.png"]})

    for named in ("gt", folder / "gt", tmp_path / "elsewhere"):
        result = bare_unghost("inspect", folder, "--segmentation", named)
        assert "\nimages\tsegmentation\t1\t" in result.out, result.err

    result = bare_unghost("inspect", folder, "--segmentation", "nowhere")
    assert result.code == 2
    assert "--segmentation: expected a folder, found none named nowhere" in result.err


def test_inspect_foresees_what_other_commands_refuse(bare_unghost, tmp_path):
    table = "image,label,xmin,ymin,xmax,ymax\na,car,1,2,30,40\n"
    picture = png(np.zeros((60, 80, 3), np.uint8))
    folder = write_files(tmp_path, {"a.png": picture, "b.png": b"", "t.csv": table})

    result = bare_unghost("inspect", folder)

    assert "`convert --to same` is refused" in result.err
    assert "refused\tb\tb.png has 0 bytes" in result.out
