"""`unghost evaluate` on a folder: tables, JSON, a picture, and what it refuses."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from filter_core.config.file import load_config
from tests.support.pictures import painted, png
from tests.support.sensors import ANNOTATION, depth_png, instance_png, scene

pytestmark = pytest.mark.long

DONE, REFUSED, USAGE, PARTLY = 0, 1, 2, 3


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two frames of a car and a ghost behind it, and a third whose depth is broken."""
    tags, metres, ids = scene()
    files = {
        "segmentation": png(painted(tags)),
        "depth": depth_png(metres),
        "instances": instance_png(tags, ids),
    }
    root = tmp_path / "frames"
    root.mkdir()
    lines = []
    for key in ("a", "b", "broken"):
        paths = {kind: f"{key}-{kind}.png" for kind in files}
        for kind, content in files.items():
            cut = len(content) // 2 if (key, kind) == ("broken", "depth") else None
            (root / paths[kind]).write_bytes(content[:cut])
        lines.append(json.dumps({"key": key, **paths, **ANNOTATION}))
    (root / "manifest.jsonl").write_text("\n".join(lines))
    return root


def write_truth(folder: Path) -> Path:
    lines = [
        {"key": key, "id": box_id, "visible": box_id == "217"}
        for key in ("a", "b")
        for box_id in ("217", "218")
    ]
    path = folder / "truth.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    return path


def test_channels_are_compared_with_a_truth_file(bare_unghost, folder):
    result = bare_unghost("evaluate", folder, "--truth", write_truth(folder), "--json")

    assert result.code == PARTLY
    assert "refused: broken" in result.err
    (record,) = result.records
    assert (record["frames"], record["boxes"]) == (2, 4)
    kept = {name: scores["kept_hidden"] for name, scores in record["channels"].items()}
    assert (kept["semantic"], kept["depth"], kept["instance"]) == (2, 0, 0)


def test_instances_are_the_truth_without_a_truth_file(bare_unghost, folder):
    result = bare_unghost(
        "evaluate", folder, "--channel", "semantic", "--channel", "ordered"
    )

    assert result.code == DONE
    first, second = (line.split("\t") for line in result.out.splitlines()[:2])
    assert first[0] == "semantic"
    assert first[6:9] == ["3", "0", "6"]
    assert second[:4] == ["ordered", "1.0", "1.0", "1.0"]
    assert "metres\t0-50\tordered" in result.out
    assert "class\tcar\tsemantic" in result.out


def test_plot_names_the_evaluated_channel(bare_unghost, folder, tmp_path):
    bare_unghost("evaluate", folder, "--channel", "ordered", "--plot", "scores.svg")

    root = ElementTree.fromstring((tmp_path / "scores.svg").read_text("utf-8"))
    texts = [node.text for node in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "ordered" in texts


@pytest.mark.parametrize(
    ("text", "message"),
    [("nonsense", "truth.jsonl, line 1"), ("", "nothing was compared")],
)
def test_invalid_or_empty_truth_is_refused(bare_unghost, folder, text, message):
    truth = folder / "truth.jsonl"
    truth.write_text(text)

    result = bare_unghost("evaluate", folder, "--truth", truth, "--suggest")

    assert result.code == REFUSED
    assert message in result.err
    assert "no threshold can be suggested" not in result.err


@pytest.fixture
def folder_with_partial_box(folder: Path) -> Path:
    """Instead of the ghost, a box next to the car, a sixth of which is the car."""
    manifest = folder / "manifest.jsonl"
    frames = [json.loads(line) for line in manifest.read_text().splitlines()]
    beside = {"id": "beside", "class": "car", "xyxy": [20, 30, 80, 100]}
    for frame in frames:
        frame["boxes"] = [frame["boxes"][0], beside]
    manifest.write_text("\n".join(map(json.dumps, frames[:2])))
    return folder


def test_suggested_thresholds_are_written_as_a_valid_config(
    bare_unghost, folder_with_partial_box, tmp_path
):
    (told,) = bare_unghost(
        "evaluate",
        folder_with_partial_box,
        "--suggest",
        "--config-out",
        "new.yaml",
        "--json",
    ).records
    after = bare_unghost(
        "evaluate", folder_with_partial_box, "--config", "new.yaml", "--json"
    )

    (car,) = told["suggested"]
    assert (car["class"], car["current"], car["answers"]) == ("car", 10, 4)
    assert 17.2 < car["suggested"] < 90
    written = load_config((tmp_path / "new.yaml").read_bytes()).config
    assert written.limits_of("car").threshold_small_box == car["suggested"]
    assert told["channels"]["semantic"]["kept_hidden"] == 2
    assert after.records[0]["channels"]["semantic"]["f1"]["value"] == 1


def test_written_files_take_the_place_of_links(bare_unghost, folder_with_partial_box):
    private = folder_with_partial_box / "private.txt"
    private.write_text("mine")
    config, plot = (folder_with_partial_box / name for name in ("a.yaml", "b.svg"))
    config.symlink_to(private)
    plot.symlink_to(private)

    result = bare_unghost(
        *("evaluate", folder_with_partial_box, "--suggest"),
        *("--config-out", config, "--plot", plot),
    )

    assert result.code == DONE
    assert private.read_text() == "mine"
    written = load_config(config.read_bytes()).config
    assert written.limits_of("car").threshold_small_box > 10
    assert ElementTree.fromstring(plot.read_text("utf-8")).tag.endswith("svg")


def test_suggested_thresholds_are_printed_as_a_table(
    bare_unghost, folder_with_partial_box
):
    result = bare_unghost(
        "evaluate", folder_with_partial_box, "--suggest", "--recall", "1"
    )

    (row,) = [
        line.split("\t")
        for line in result.out.splitlines()
        if line.startswith("threshold\t")
    ]
    assert row[1:3] == ["car", "10.0"]
    assert row[-2:] == ["0.667", "1.0"]


def test_truth_of_other_frames_is_counted_and_exits_with_3(bare_unghost, folder):
    truth = write_truth(folder)
    truth.write_text(truth.read_text().replace('"b"', '"x"'))

    result = bare_unghost("evaluate", folder, "--truth", truth, "--channel", "semantic")

    assert result.code == PARTLY
    assert "frames without a box of known truth: 2 of 3" in result.err
    assert (
        "lines of the ground truth about no box here: 2, such as those of frame 'x'"
        in result.err
    )


def test_recall_option_without_suggest_is_refused(bare_unghost, folder):
    assert bare_unghost("evaluate", folder, "--recall", "0.9").code == USAGE
