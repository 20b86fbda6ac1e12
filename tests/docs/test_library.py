"""The examples of docs/library.md are run in order, in a folder with a recording."""

import json

import cv2
import numpy as np
import pytest

from tests.support.documents import blocks, read

EXAMPLES = blocks(read("docs/library.md"), "python")
CAR_COLOR_BGR = (142, 0, 0)


@pytest.fixture
def recording(tmp_path, monkeypatch):
    """A folder to run in, with one frame: a car that fills the left half of its box."""
    colors = np.full((120, 160, 3), 70, np.uint8)
    colors[30:90, 40:80] = CAR_COLOR_BGR
    (tmp_path / "seg").mkdir()
    assert cv2.imwrite(str(tmp_path / "seg" / "000001.png"), colors)
    boxes = [{"id": "7", "class": "car", "xyxy": [40, 30, 120, 90]}]
    frame = {
        "key": "000001",
        "segmentation": "seg/000001.png",
        "carla_version": "0.9.15",
        "boxes": boxes,
    }
    (tmp_path / "manifest.jsonl").write_text(json.dumps(frame) + "\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("recording")
def test_library_examples_run_in_order_and_print_the_expected_output(capsys):
    namespace = {"__name__": "__main__"}

    printed = []
    for example in EXAMPLES:
        exec(compile(example, "library.md", "exec"), namespace)
        printed.append(capsys.readouterr().out.splitlines())

    single, often, folder, config, wrong = printed
    assert single == ["7 kept 50.0"]
    assert often == ["10 1 [40.]", "40 1 [10.]", "60 0 [-10.]"]
    assert folder == ["000001 ['visible']"]
    assert config[0].endswith("{'threshold_small_box': 2}")
    assert [line.split()[0] for line in wrong] == ["/boxes/0/xyxy", "/boxes/1"]
