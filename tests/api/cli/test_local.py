"""Commands that need no server or start one: filter, convert, serve, demo."""

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import plain_http
from tests.support.command_line import CommandLine
from tests.support.folders import street_tags, write_files
from tests.support.frames import (
    FAMILY,
    HEIGHT,
    WIDTH,
    write_jpeg_segmentation,
    write_manifest,
)
from tests.support.pictures import painted, png
from tests.support.sensors import write_coarse_depth
from tests.support.servers import token_of
from tests.support.waiting import until
from unghost import Client

DONE, REFUSED, USAGE, PARTLY, INTERRUPTED = 0, 1, 2, 3, 130


def lines_of(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]


def test_filter_writes_one_line_per_frame_in_order(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 12)

    result = bare_unghost("filter", folder, "--output", "out/decisions.jsonl")

    assert result.code == DONE
    assert result.out == "12 decided\t0 failed\t12 kept\t12 rejected\t0 unmeasured\n"
    assert "class" not in result.err
    lines = lines_of(tmp_path / "out" / "decisions.jsonl")
    assert [line["key"] for line in lines] == [f"run/{n:06}" for n in range(12)]
    verdicts = {each["id"]: each["verdict"] for each in lines[0]["decisions"]}
    assert verdicts == {"real": "kept", "ghost": "rejected"}
    assert bare_unghost("filter", folder).records == lines


def test_filter_writes_through_no_link_in_the_folder_of_its_output(
    bare_unghost, tmp_path
):
    folder = write_manifest(tmp_path / "frames", 1)
    private = tmp_path / "private.txt"
    private.write_text("mine")
    for name in ("decisions.jsonl", "decisions.jsonl.part"):
        (folder / name).symlink_to(private)

    result = bare_unghost("filter", folder, "-o", folder / "decisions.jsonl")

    assert result.code == DONE
    assert private.read_text() == "mine"
    assert not (folder / "decisions.jsonl").is_symlink()
    assert len(lines_of(folder / "decisions.jsonl")) == 1


@pytest.mark.parametrize("command", ["filter", "convert"])
def test_pipe_in_place_of_a_manifest_is_refused(bare_unghost, tmp_path, command):
    """Reading it would wait without end."""
    (tmp_path / "town").mkdir()
    os.mkfifo(tmp_path / "town/manifest.jsonl")
    more = ("--to", "coco", "-o", "x.zip") if command == "convert" else ("-o", "x")

    result = bare_unghost(command, "town", *more)

    assert result.code == REFUSED
    assert "cannot be read: not a regular file" in result.err


def test_filter_with_an_invalid_frame_exits_with_3(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 3, bad=frozenset({1}))

    result = bare_unghost("filter", folder, "-o", "out.jsonl", "--json")

    assert result.code == PARTLY
    counts = {"decided": 2, "failed": 1, "kept": 2, "rejected": 2, "unmeasured": 0}
    assert result.records == [{"output": "out.jsonl", **counts, "unmatched": []}]
    assert "refused: run/000001" in result.err
    lines = lines_of(tmp_path / "out.jsonl")
    assert lines[1]["error"]["errors"][0]["pointer"].startswith("/boxes/0")


@pytest.mark.parametrize(
    "command", [("filter",), ("convert", "--to", "yolo", "--filter")]
)
def test_ten_refusals_of_a_kind_are_printed_and_then_a_number(
    bare_unghost, tmp_path, command
):
    folder = write_manifest(tmp_path / "frames", 16, bad=frozenset(range(15)))
    with (folder / "manifest.jsonl").open("a") as manifest:
        manifest.write("no JSON\n")

    result = bare_unghost(*command, folder, "-o", tmp_path / "out")

    assert result.code == PARTLY
    assert result.err.count("refused: run/") == 10
    assert result.err.count("refused: manifest.jsonl, line 17") == 1
    assert "and 5 more like this: refused (not_a_number)" in result.err


def test_convert_leaves_out_frames_without_an_image_and_says_so(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 2)
    line = {"key": "bare", "camera": {"width": 64, "height": 48}, "boxes": []}
    with (folder / "manifest.jsonl").open("a") as manifest:
        manifest.write(json.dumps(line) + "\n")

    usual = bare_unghost("convert", folder, "--to", "yolo", "-o", "usual")
    every = bare_unghost(
        *("convert", folder, "--to", "yolo", "-o", "every", "--allow-missing-images")
    )

    assert (usual.code, every.code) == (DONE, DONE)
    assert usual.out.startswith("usual\t2 frames")
    assert "left out: 1 frames without an image; --allow-missing-images" in usual.err
    assert every.out.startswith("every\t3 frames")
    assert not list(tmp_path.glob("usual/labels/*/bare.txt"))
    assert len(list(tmp_path.glob("every/labels/*/bare.txt"))) == 1


@pytest.mark.parametrize("named", ["", "manifest.jsonl"])
def test_filter_does_not_overwrite_its_source(bare_unghost, tmp_path, named):
    folder = write_manifest(tmp_path / "frames", 2)
    before = (folder / "manifest.jsonl").read_bytes()

    result = bare_unghost("filter", folder / named, "-o", folder / "manifest.jsonl")

    assert result.code == USAGE
    assert "is the source itself" in result.err
    table = bare_unghost("filter", folder, "-o", tmp_path / "decisions.csv")
    assert table.code == USAGE
    assert f"`unghost convert {folder} --to decisions-csv --filter" in table.err
    assert (folder / "manifest.jsonl").read_bytes() == before


def test_control_characters_of_file_names_are_escaped(bare_unghost, tmp_path):
    folder = tmp_path / "frames"
    hostile = "labels/a\x1b]0;OWNED\x07\n.txt"
    write_files(folder, {hostile: b"x 1 2 3", "classes.txt": b"car"})

    result = bare_unghost("convert", folder, "--to", "coco", "-o", "out")

    assert result.code == REFUSED
    assert r"a\u001b]0;OWNED\u0007\u000a" in result.err
    assert "no frame can be read (1 refused)" in result.err
    assert result.err.replace("\n", "").isprintable()
    assert not (tmp_path / "out").exists()


def test_frames_without_segmentation_and_without_boxes_are_said(bare_unghost, tmp_path):
    labels = {"labels/1.txt": "0 .5 .5 .2 .2", "labels/2.txt": "0 .5 .5 .2 .2"}
    pictures = dict.fromkeys(("images/1.png", "images/2.png", "seg/1.png"))
    town = {**labels, **pictures, "classes.txt": "car"}
    write_files(tmp_path / "town", town)
    write_files(tmp_path / "empty", town | dict.fromkeys(labels, b""))

    result = bare_unghost("filter", "town", "-o", "out.jsonl")
    convert = bare_unghost("convert", "empty", "--to", "coco", "-o", "out")

    assert (
        "unmeasured, without a segmentation: 1 of 2 frames, such as 2\n" in result.err
    )
    assert "no frame has a box (2 read, layout yolo" in convert.err


def test_folder_without_frames_says_why_its_images_are_none(bare_unghost, tmp_path):
    write_files(tmp_path / "town", {"rgb/1.png": png(painted(street_tags()))})

    result = bare_unghost("filter", tmp_path / "town")

    assert result.code == REFUSED
    assert "unghost: no frames in town (layout pairs)\n" in result.err
    assert "rgb/1.png: its name says that it is a picture, its pixels" in result.err


def test_filter_names_boxes_whose_colour_the_published_code_does_not_count(
    bare_unghost, tmp_path
):
    folder = write_manifest(tmp_path / "frames", 2)
    tags = np.full((HEIGHT, WIDTH), 15, np.uint8)  # Truck
    for file in (folder / "seg").iterdir():
        file.write_bytes(png(painted(tags)))
    manifest = folder / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"truck"'))
    (tmp_path / "boundingBox.yaml").write_text("sitting: {threshold_small_box: 10}")

    result = bare_unghost(
        "filter", folder, "--config", "boundingBox.yaml", "-o", "out.jsonl"
    )

    assert "profile carlasimu: boxes are decided as the paper's published" in result.err
    assert "one colour for each class: truck (" in result.err


def test_filter_does_not_decide_boxes_of_a_class_it_does_not_know(
    bare_unghost, tmp_path
):
    said = "caar (4; --class-map caar=car)"
    manifest = write_manifest(tmp_path / "frames", 2) / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"caar"'))
    command = ("filter", manifest, "-o", "out.jsonl")

    stopped = bare_unghost(*command)
    is_written = (tmp_path / "out.jsonl").exists()
    result = bare_unghost(*command, "--allow-unmapped")

    assert (stopped.code, is_written) == (REFUSED, False)
    assert f"nothing was written: {said}; --class-map NAME=CLASS" in stopped.err
    assert result.code == PARTLY
    assert "0 rejected\t4 unmeasured" in result.out
    assert (
        "4 boxes are unmeasured, since the filter does not know their class: "
        f"{said}; --class-map NAME=CLASS says as what a class is "
        "measured, and --class-map NAME=pass that it need not be\n"
    ) in result.err


def test_class_that_only_this_profile_lacks_is_not_called_misspelt(
    bare_unghost, tmp_path
):
    manifest = write_manifest(tmp_path / "frames", 1) / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"vehicle"'))
    (tmp_path / "filter.yaml").write_text("profile: carlasimu")

    command = ("filter", manifest, "--config", "filter.yaml", "-o", "o")
    stopped = bare_unghost(*command)
    result = bare_unghost(*command, "--allow-unmapped")

    assert "2 of 2 boxes have a class that profile carlasimu has no" in stopped.err
    assert result.code == PARTLY
    assert "since profile carlasimu drops classes without a colour: vehicle (2); " in (
        result.err
    )
    assert "version of CARLA" not in result.err


def test_filter_names_the_option_for_labels_without_a_class(bare_unghost, tmp_path):
    folder = tmp_path / "yolo"
    write_files(folder, {"a.txt": "9 9 4 4", "classes.txt": "car", "a.png": None})
    tags = segmentation_folder(tmp_path / "tags")

    result = bare_unghost("filter", folder, "--segmentation", tags, "-o", "out.jsonl")

    assert result.code == REFUSED
    assert (
        "unknown (1; labels without a class; --default-class names theirs)"
    ) in result.err


def segmentation_folder(folder: Path) -> Path:
    """A folder with the segmentation of an image a.png of 80 x 60 pixels."""
    write_files(folder, {"a.png": png(painted(street_tags(), FAMILY))})
    return folder


@pytest.mark.parametrize("part", ["image", "segmentation", "depth"])
def test_filter_names_the_part_of_a_frame_that_is_truncated(
    bare_unghost, tmp_path, part
):
    folder = write_manifest(tmp_path / "frames", 1)
    parts = {"image": "rgb/000000.png", "segmentation": "seg/000000.png", "depth": "d"}
    file = folder / parts[part]
    end = 20 if part == "image" else -9  # of an image, only the header is read
    file.write_bytes((folder / parts["image"]).read_bytes()[:end])
    manifest = folder / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('{"key"', '{"depth": "d", "key"'))
    config = tmp_path / "filter.yaml"
    config.write_text(f"evidence: {'depth' if part == 'depth' else 'semantic'}")

    result = bare_unghost("filter", folder, "--config", config, "-o", "out.jsonl")

    assert result.code == REFUSED
    assert f"refused: run/000000: {part}: PNG: the file ends too early" in result.err
    (line,) = lines_of(tmp_path / "out.jsonl")
    assert line["error"]["errors"][0]["pointer"] == f"/{part}"


@pytest.mark.parametrize("command", ["filter", "convert"])
def test_label_without_its_image_is_named(bare_unghost, tmp_path, command):
    files = {"classes.txt": "car", "images/a.png": None}
    labels = {"labels/a.txt": "0 .5 .5 .1 .1", "labels/b/c.txt": "0 .5 .5 .1 .1"}
    write_files(tmp_path / "yolo", {**files, **labels})
    more = ("--to", "coco") if command == "convert" else ()

    result = bare_unghost(command, "yolo", *more, "-o", "out")

    assert result.code == PARTLY
    assert (
        "refused: b/c: labels/b/c.txt: expected an image named c (.png, .jpg or "
        ".jpeg), found none\n"
    ) in result.err


def test_options_for_labels_without_a_list_of_classes_are_named(bare_unghost, tmp_path):
    files = {"labels/1.txt": "0 .5 .5 .1 .1", "images/1.png": None}
    write_files(tmp_path / "yolo", files)

    refused = bare_unghost("filter", "yolo")
    also_refused = bare_unghost("filter", "yolo", "--layout", "yolo")
    named = bare_unghost("filter", "yolo", "--layout", "yolo", "--classes", "car")
    images = bare_unghost("filter", "yolo", "--layout", "pairs")

    assert (refused.code, also_refused.code) == (REFUSED, REFUSED)
    assert refused.err.endswith(
        "but no list of its classes in data.yaml, data.yml, dataset.yaml, classes.txt, "
        "labels.txt or obj.names; --layout yolo --classes NAMES names them, --layout "
        "pairs reads the images alone\n"
    )
    assert also_refused.err.endswith("found none of them; --classes NAMES names them\n")
    assert named.code == DONE
    assert "not matched: labels/1.txt: labels of another layout" in images.err


@pytest.mark.parametrize("command", ["filter", "convert"])
def test_commands_that_upload_nothing_read_files_outside_the_folder(
    bare_unghost, tmp_path, command
):
    folder = write_manifest(tmp_path / "frames", 2)
    elsewhere = (folder / "seg/000000.png").rename(tmp_path / "seg.png")
    linked = folder / "seg/000001.png"
    linked.symlink_to(linked.rename(tmp_path / "1.png"))
    manifest = folder / "manifest.jsonl"
    text = manifest.read_text().replace("seg/000000.png", str(elsewhere))
    manifest.write_text(text)
    more = {"filter": (), "convert": ("--to", "coco", "--filter")}[command]

    done = bare_unghost(command, folder, *more, "-o", "out")

    assert done.code == DONE


@pytest.mark.parametrize("command", ["filter", "evaluate"])
def test_option_that_reads_jpeg_segmentations_is_named(bare_unghost, tmp_path, command):
    folder = write_jpeg_segmentation(tmp_path / "frames")
    more = {
        "filter": ("-o", "out.jsonl"),
        "evaluate": ("--channel", "semantic"),
    }[command]

    refused = bare_unghost(command, folder, *more)
    named = bare_unghost(
        "filter", folder, "--lossy-segmentation", "nearest", "-o", "out.jsonl"
    )

    assert refused.code == REFUSED
    assert (
        "expected a PNG. --lossy-segmentation nearest (lossy_segmentation: nearest) "
        "reads it by the nearest colour"
    ) in refused.err
    assert named.code == DONE


def test_option_that_reads_raw_tags_is_named(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 1)
    tags = np.full((HEIGHT, WIDTH, 3), 1, np.uint8)
    (folder / "seg/000000.png").write_bytes(png(tags))

    result = bare_unghost("filter", folder, "-o", "out.jsonl")

    assert "Raw tags need --encoding raw (encoding: raw)" in result.err


def test_notes_on_depth_that_is_no_evidence_are_in_the_summary(bare_unghost, tmp_path):
    folder, config = write_coarse_depth(tmp_path)
    (tmp_path / "truth.jsonl").write_text('{"key": "a", "id": "217", "visible": true}')
    measured = (folder, "--config", config)

    results = [
        bare_unghost("filter", *measured, "-o", "out.jsonl"),
        bare_unghost("convert", *measured, "--filter", "--to", "coco", "-o", "coco"),
        bare_unghost("evaluate", *measured, "--truth", tmp_path / "truth.jsonl"),
    ]
    named = bare_unghost(
        *("filter", *measured, "-o", "named.jsonl"),
        *("--depth-encoding", "millimetres16"),
    )

    note = "depth is not used as evidence: the depth image: "
    for result in results:
        assert f"2 frames: {note}" in result.err
        assert result.err.count(note) == 1
    assert f"2 frames: {note}expected grey with 16 bits" in named.err


OPTIONS = "--layout names another layout, --labels the folder of the labels"


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"Left/1.png": None, "Right/1.png": None},
         "no frame has a box (2 read, layout pairs, which expects the boxes of an "
         f"image NAME.png in NAME.json); {OPTIONS}, --segmentation that of the "
         "segmentations\n"),
        ({"a.txt": "", "classes.txt": "car", "a.png": None},
         "no frame has a box (1 read, layout yolo, whose labels were found, and are "
         f"empty); {OPTIONS}\n"),
        ({"manifest.jsonl": '{"key": "1", "image": "1.png", "boxes": []}',
          "1.png": None},
         "no boxes); --layout names another layout\n"),
        ({"a.txt": "", "b.txt": "0 .5 .5 .1 .1", "classes.txt": "car", "a.png": None,
          "b.png": None},
         ""),
    ],
)  # fmt: skip
def test_filter_says_that_no_frame_has_a_box_and_which_options_may_help(
    bare_unghost, tmp_path, files, said
):
    write_files(tmp_path / "town", files)

    result = bare_unghost("filter", "town", "-o", "out.jsonl")

    assert result.code == DONE
    assert result.err.endswith(said)
    assert ("has a box" in result.err) == (said != "")


def test_folder_of_no_layout_or_of_two_is_refused_by_its_name(bare_unghost, tmp_path):
    (tmp_path / "empty").mkdir()
    labels = {"a.xml": "<annotation/>", "labels/1.txt": "", "data.yaml": "names: [car]"}
    write_files(tmp_path / "both", {**labels, "images/1.png": None})

    both = bare_unghost("filter", "both")
    results = [
        bare_unghost("filter", "empty"),
        CommandLine(tmp_path / "empty", {})("filter", "."),
    ]

    for result in results:
        assert result.code == REFUSED
        assert "empty: no layout recognised" in result.err
        assert "Traceback" not in result.err
    assert both.code == REFUSED
    assert "choose one, for example with --layout voc" in both.err


def test_filter_lists_unmatched_files(bare_unghost, tmp_path):
    labels = {"labels/a.txt": "0 0.5 0.5 0.1 0.1\n", "classes.txt": "car\n"}
    images = dict.fromkeys(("images/a.png", "images/b.png"))
    write_files(tmp_path / "yolo", {**labels, **images})

    result = bare_unghost("filter", "yolo", "-o", "out.jsonl")
    as_json = bare_unghost("filter", "yolo", "-o", "out.jsonl", "--json")

    assert result.code == PARTLY
    assert "not matched: images/b.png" in result.err
    assert "1 unmeasured" in result.out
    why = "no label file for this image"
    unmatched = [{"path": "images/b.png", "why": why}]
    assert as_json.records[0]["unmatched"] == unmatched


def test_version_is_printed(bare_unghost):
    result = bare_unghost("--version")

    assert result.code == DONE
    assert result.out.startswith("unghost 0.")


def test_serve_prints_the_login_link_and_exits_on_sigint(bare_unghost, tmp_path):
    serve = ("serve", "--data", "here", "--port", "0", "--json")
    with bare_unghost.running(*serve) as process:
        link = json.loads(process.stdout.readline())["login_link"]
        url, _, code = link.partition("/#code=")
        token = token_of(tmp_path / "here")
        with Client(url, token) as client:
            # Seldom: the server logs each request to a pipe that is not read yet.
            until(client.ready, every_s=1)
        opened = plain_http.post(f"{url}/api/v1/session", json={"code": code})
        listed = CommandLine(tmp_path, {"UNGHOST_SERVER": url})("dataset", "list")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)

    assert token not in link
    assert (opened.status_code, opened.json()["name"]) == (201, "admin")
    assert listed.code == DONE
    assert process.returncode == DONE
    assert "Traceback" not in err
    assert (tmp_path / "here" / "token").stat().st_mode & 0o077 == 0


def test_serve_for_other_machines_says_how_a_host_name_is_allowed(bare_unghost):
    serve = ("serve", "--data", "here", "--port", "0", "--host", "0.0.0.0", "--json")
    with bare_unghost.running(*serve) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)

    assert "under a host name they are refused (421) until it is in UNGHOST_ALL" in err


@pytest.mark.parametrize("command", [("serve",), ("demo", "--frames", "1")])
def test_port_in_use_is_refused_before_anything_is_rendered(
    bare_unghost, server, tmp_path, command
):
    port = server.url.rpartition(":")[2]

    result = bare_unghost(*command, "--data", "here", "--port", port)

    assert result.code == REFUSED
    assert "cannot listen" in result.err
    assert "--port chooses another port" in result.err
    assert "Traceback" not in result.err
    assert not (tmp_path / "here" / "demo").exists()


def test_serve_on_an_address_of_another_machine_is_refused(bare_unghost):
    result = bare_unghost(
        "serve", "--data", "here", "--host", "192.0.2.1", "--port", "0"
    )

    assert result.code == REFUSED
    assert "--host takes an address of this machine" in result.err
    assert "another server" not in result.err


@pytest.mark.long
def test_demo_renders_once_filters_and_prints_a_login_link(bare_unghost, tmp_path):
    words = ("demo", "--frames", 2, "--port", 0, "--exit-when-ready", "--json")

    first, again = bare_unghost(*words), bare_unghost(*words)

    assert (first.code, again.code) == (DONE, DONE)
    record = first.records[-1]
    assert record["stats"]["frames"] == 2
    assert record["stats"]["rejected"] > 0
    assert record["stats"]["kept"] > 0
    assert "/#code=" in first.records[0]["login_link"]
    assert "render" in first.err
    assert "render" not in again.err
    assert again.records[-1]["stats"] == record["stats"]


def test_convert_without_a_server_writes_every_box(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 3)

    result = bare_unghost("convert", folder, "--to", "coco", "-o", "made", "--json")

    assert result.code == DONE
    assert result.records == [
        {
            "output": "made",
            "frames": 3,
            "failed": 0,
            "boxes": {"in": 6, "out": 6, "dropped": 0},
        }
    ]
    assert "classes in this order: car" in result.err
    parts = [tmp_path / f"made/annotations/instances_{part}.json" for part in PARTS]
    made = [json.loads(part.read_text("utf-8")) for part in parts]
    assert sum(len(labels["annotations"]) for labels in made) == 6


PARTS = ("train", "val")


def test_convert_says_the_shares_of_parts_before_and_after(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 3)

    result = bare_unghost(
        *("convert", folder, "--to", "coco", "-o", "made", "--split", "0,0.5,0.5")
    )

    shares, came = (line for line in result.err.splitlines() if "3 (100%)" in line)
    assert shares.startswith("asked for train 0%: 0 (0%), val 50%: ")
    assert came.startswith("parts: ")
    assert "; sequences: " in came
    assert "3 frames are split by whole sequences" in came
    again = bare_unghost("convert", folder, "--to", "coco", "-o", "o", "--split", "1,1")
    assert again.code == USAGE
    assert "split: expected shares whose sum is 1, found 2" in again.err


def test_convert_with_filter_drops_rejected_boxes(bare_unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 3, bad=frozenset({1}))
    config = tmp_path / "filter.yaml"
    config.write_text("threshold_small_box: 99.9\n")

    for options, kept in (((), 2), (("--config", config), 2)):
        target = tmp_path / f"made-{len(options)}"
        result = bare_unghost(
            "convert", folder, "--to", "yolo", "-o", target, "--filter", *options
        )
        assert result.code == PARTLY
        assert "refused: run/000001" in result.err
        labels = sorted((target / "labels").rglob("*.txt"))
        assert sum(len(file.read_text().splitlines()) for file in labels) == kept
        manifest = json.loads((target / "manifest.json").read_text("utf-8"))
        assert [row["reason"] for row in manifest["boxes"]] == ["no_visible_pixels"] * 2


@pytest.mark.parametrize("keeps", [True, False])
def test_convert_with_filter_says_what_becomes_of_unmeasured_boxes(
    bare_unghost, tmp_path, keeps
):
    lines = write_manifest(tmp_path / "frames", 3) / "manifest.jsonl"
    first, *others = map(json.loads, lines.read_text("utf-8").splitlines())
    del first["segmentation"]
    lines.write_text("\n".join(map(json.dumps, (first, *others))), "utf-8")
    option = () if keeps else ("-O", "include_unmeasured=false")

    result = bare_unghost(
        *("convert", tmp_path / "frames", "--to", "yolo", "-o", "made"),
        *("--filter", "--json", *option),
    )

    (record,) = result.records
    images = list((tmp_path / "made/images").rglob("*.png"))
    labels = [text.read_text() for text in (tmp_path / "made/labels").rglob("*.txt")]
    written = sum(len(text.splitlines()) for text in labels)
    if keeps:
        assert "2 unmeasured boxes written as they came" in result.err
        assert (record["frames"], len(images), written) == (3, 3, 4)
    else:
        assert "1 frames left out with their 2 unmeasured boxes" in result.err
        assert (record["frames"], len(images), written) == (2, 2, 2)
    assert all(labels)


def test_convert_refuses_the_current_folder_or_one_that_is_not_empty_as_output(
    bare_unghost, tmp_path
):
    folder = write_manifest(tmp_path / "frames", 1)
    (tmp_path / "empty").mkdir()
    convert = ("convert", folder, "--to", "yolo", "-o")

    current = CommandLine(tmp_path / "empty", {})(*convert, ".")
    filled = bare_unghost(*convert, folder)

    assert (current.code, filled.code) == (REFUSED, REFUSED)
    assert "empty: expected a new folder, found this one" in current.err
    assert "expected a new or an empty folder" in filled.err
    assert (folder / "manifest.jsonl").is_file()


def test_convert_stops_before_it_writes_and_counts_what_the_list_has_too_many_of(
    bare_unghost, tmp_path
):
    """YOLO lists classes that no box has: the boxes decide, not the list."""
    folder = tmp_path / "yolo"
    files = {"a.png": None, "classes.txt": "car\ndragon\nelf", "a.txt": LABELS}
    write_files(folder, files)
    tags = segmentation_folder(tmp_path / "tags")
    convert = ("convert", folder, "--segmentation", tags, "--filter", "--to", "kitti")

    result = bare_unghost(*convert, "-o", "one")
    write_files(folder, {"a.txt": LABELS.replace("0 ", "2 ", 1)})
    stopped = bare_unghost(*convert, "-o", "two")
    unfiltered = bare_unghost(*convert[:4], *convert[5:], "-o", "three")

    assert result.code == PARTLY
    assert "1 box is unmeasured and written as it came" in result.err
    assert "dragon (1); --class-map" in result.err
    assert (stopped.code, (tmp_path / "two").exists()) == (REFUSED, False)
    assert "2 of 3 boxes have a class that the filter does not know" in stopped.err
    assert unfiltered.code == DONE, unfiltered.err


LABELS = "0 .5 .5 .2 .2\n0 .1 .1 .1 .1\n1 .5 .5 .2 .2\n"
