"""`unghost draw`, pictures before and after the filter, and `unghost replay`."""

import json
import re
from pathlib import Path
from urllib.parse import unquote

import cv2
import numpy as np

from filter_core.images.drawing import COLORS
from tests.support.frames import HEIGHT, IN_THE_SKY, ON_THE_CAR, WIDTH, write_manifest

PARTLY = 3
BY_TAGS = "evidence: semantic\n"
NOTHING = "evidence: semantic\nmin_visible_pixels: 1000\n"


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path))
    assert picture is not None, path
    return picture


def is_drawn(picture: np.ndarray, xyxy: list[int], verdict: str) -> bool:
    """Whether the upper edge of a box has the colour of a verdict somewhere."""
    x0, y0, x1, _ = xyxy
    edge = picture[y0 - 1 : y0 + 2, x0:x1].astype(int)
    return bool((np.abs(edge - np.array(COLORS[verdict])).sum(axis=2) <= 12).any())


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_pictures_sheet_and_page_are_written(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 3)

    result = bare_unghost("draw", source, "-o", "out")

    assert (result.code, result.out) == (0, "3 drawn\t0 failed\n"), result.err
    out = tmp_path / "out"
    assert names(out) == ["after", "before", "index.html", "sheet.png", "side"]
    before, after = (
        read(out / each / "run__000000.png") for each in ("before", "after")
    )
    assert before.shape == after.shape == (HEIGHT, WIDTH, 3)
    for box, kept in ((ON_THE_CAR, True), (IN_THE_SKY, False)):
        assert is_drawn(before, box, "kept")
        assert is_drawn(after, box, "kept") is kept
    # Before and after, the segmentation and the reasons, in two columns.
    side = read(out / "side/run__000000.png")
    assert (side.shape[0] > 2 * HEIGHT, side.shape[1]) == (True, 2 * WIDTH)
    assert read(out / "sheet.png").shape[1] == 3 * 480
    page = (out / "index.html").read_text()
    shown = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert len(shown) == 3 * 3 + 1
    assert all((out / unquote(name)).is_file() for name in shown)
    assert page.count("rejected: none of its pixels are Car") == 3


def test_only_flips_draws_frames_that_a_rival_decides_otherwise(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 2)
    (tmp_path / "tags.yaml").write_text(BY_TAGS)
    (tmp_path / "nothing.yaml").write_text(NOTHING)
    command = ("draw", source, "--only", "flips", "--config", "tags.yaml")

    alike = bare_unghost(*command, "--against", "tags.yaml", "-o", "alike")
    flipped = bare_unghost(*command, "--against", "nothing.yaml", "-o", "flipped")

    assert (alike.out, flipped.out) == ("0 drawn\t0 failed\n", "2 drawn\t0 failed\n")
    page = (tmp_path / "flipped/index.html").read_text()
    assert page.count("1 rejected, 1 flips") == 2


def test_worst_frames_come_first_and_no_others_are_drawn(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 3)
    manifest = source / "manifest.jsonl"
    first, second, third = manifest.read_text().splitlines()
    more = second.replace(
        '"boxes": [', '"boxes": [{"class": "car", "xyxy": [1, 1, 9, 9]}, '
    )
    manifest.write_text("\n".join([first, more, third]))

    result = bare_unghost("draw", source, "-o", "out", "--worst", "1")

    assert result.code == 0, result.err
    assert names(tmp_path / "out/side") == ["run__000001.png"]


def test_frame_that_cannot_be_read_does_not_stop_the_others(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 2)
    (source / "seg/000000.png").write_bytes(b"no image")

    result = bare_unghost("draw", source, "-o", "out")

    assert (result.code, result.out) == (PARTLY, "1 drawn\t1 failed\n")
    assert "run/000000" in result.err


def test_frame_without_an_image_is_drawn_on_grey(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 1)
    (source / "rgb/000000.png").unlink()
    manifest = source / "manifest.jsonl"
    manifest.write_text(re.sub(r'"image": "[^"]*",? ?', "", manifest.read_text()))

    result = bare_unghost("draw", source, "-o", "out")

    assert result.code == 0, result.err
    assert read(tmp_path / "out/before/run__000000.png")[-1, -1].tolist() == [96] * 3


def test_replay_counts_what_paper_code_and_best_evidence_decide(bare_unghost, tmp_path):
    source = write_manifest(tmp_path / "frames", 2)
    manifest = source / "manifest.jsonl"
    # The code drops a class that it does not know, the paper's text says nothing of it.
    manifest.write_text(
        manifest.read_text().replace('"class": "car"', '"class": "boat"')
    )
    command = ("replay", source, "-o", "boxes.jsonl", "--pictures", "wrong")

    result = bare_unghost(*command, "--worst", "1")

    assert result.code == 0, result.err
    first, head, kind = (line.split("\t") for line in result.out.splitlines())
    assert first == ["2 frames", "4 boxes", "0 failed", "4 differ"]
    assert head == ["# kind", "boxes", "paper", "code", "best"]
    assert kind == [
        *("kind", "4", "unmeasured: unmapped class"),
        *("rejected: unmapped class", "unmeasured: unmapped class"),
    ]
    assert "its code: keeps 0 boxes that the best evidence rejects" in result.err
    records = [
        json.loads(line) for line in (tmp_path / "boxes.jsonl").read_text().splitlines()
    ]
    assert [(record["key"], record["id"]) for record in records] == [
        (f"run/00000{number}", box) for number in (0, 1) for box in ("real", "ghost")
    ]
    assert {record["code"]["verdict"] for record in records} == {"rejected"}
    assert names(tmp_path / "wrong/side") == ["run__000000.png"]
