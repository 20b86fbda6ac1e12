"""`unghost worth-it` on a folder: label noise, data sets, trials, reports."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.support.experiments import parrot, write_recording

DONE, REFUSED, USAGE = 0, 1, 2


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "frames")


@pytest.fixture
def trainer(tmp_path: Path) -> str:
    """A trainer that notes its runs in `runs.txt`."""
    return parrot(tmp_path)


def test_label_noise_is_counted_and_drawn(bare_unghost, folder, tmp_path):
    result = bare_unghost(
        *("worth-it", folder, "--no-train", "--json"), "--html", tmp_path / "noise.html"
    )

    assert result.code == DONE
    (record,) = result.records
    assert (record["frames"], record["objects"], record["ghosts"]) == (8, 8, 8)
    ghosts = {name: arm["kept_hidden"] for name, arm in record["arms"].items()}
    assert (ghosts["raw"], ghosts["paper"], ghosts["auto"]) == (8, 8, 0)
    page = (tmp_path / "noise.html").read_text()
    assert "8 frames have 16 boxes: 8 objects, 8 ghosts, 0 doubtful." in page
    assert page.count("<svg") == 1


def test_result_is_kept_with_a_dataset_of_the_server(unghost, api, folder, trainer):
    dataset = api.dataset()
    words = ("worth-it", folder, "--arms", "raw,depth", "--dataset", dataset)

    counted = unghost(*words, "--no-train")
    noise = api.json(f"/datasets/{dataset}/experiment")
    trained = unghost(*words, "--seeds", "1", "--trainer", trainer, "-o", folder / "x")
    report = api.json(f"/datasets/{dataset}/experiment")
    elsewhere = unghost("worth-it", folder, "--no-train", "--dataset", "no-dataset")

    assert (counted.code, trained.code) == (DONE, DONE), counted.err + trained.err
    assert f"the page Quality of {dataset} shows it" in counted.err
    counts = {"labels": 16, "ghosts": 8, "doubtful": 0, "lost": 0}
    assert noise["arms"]["raw"]["labels"] == counts
    assert (noise["arms"]["raw"]["map50"], noise["verdict"]) == (None, "")
    assert report["arms"]["depth"]["labels"] == {**counts, "labels": 8, "ghosts": 0}
    assert report["arms"]["depth"]["difference"]["value"] == pytest.approx(
        0.5, abs=0.01
    )
    assert report["verdict"].startswith("mAP50 against raw")
    assert elsewhere.code == REFUSED
    assert "there is no dataset 'no-dataset'" in elsewhere.err


def test_experiment_trains_each_arm_and_continues(
    bare_unghost, folder, trainer, tmp_path
):
    output = tmp_path / "experiment"
    words = ("worth-it", folder, "--arms", "raw,depth,random", "--trainer", trainer)

    first = bare_unghost(*words, "-o", output, "--seeds", "1")
    on_this_machine = ("--engine", "LOCAL")
    second = bare_unghost(
        *words, "-o", output, "--seeds", "2", *on_this_machine, "--json"
    )

    assert (first.code, second.code) == (DONE, DONE), first.err + second.err
    runs = (tmp_path / "runs.txt").read_text().splitlines()
    assert runs == [
        f"{arm} {seed}" for seed in (0, 1) for arm in ("raw", "depth", "random")
    ]
    (result,) = second.records
    scores = {name: arm["map50"]["value"] for name, arm in result["arms"].items()}
    assert (scores["raw"], scores["depth"]) == (pytest.approx(0.5, abs=0.01), 1.0)
    assert result["arms"]["raw"]["means"]["on_ghosts"] == 1.0
    assert result["differences"]["depth"]["map50"]["shown"]
    assert result["verdict"].startswith("mAP50 against raw: better: depth +0.5")
    assert result["verdict"] in (output / "report.txt").read_text()
    assert (output / "report.html").read_text().count("<svg") == 3
    assert json.loads((output / "report.json").read_text()) == result


def test_label_files_of_an_arm_hold_its_boxes_in_both_formats(
    bare_unghost, folder, trainer, tmp_path
):
    output = tmp_path / "experiment"
    words = ("--arms", "raw,auto", "--trainer", trainer, "--seeds", "1")
    assert bare_unghost("worth-it", folder, *words, "-o", output).code == DONE

    for arm, boxes in (("raw", 2), ("auto", 1)):
        place = output / "data" / "arms" / arm
        for part, expected in (("train", boxes), ("val", 1)):
            texts = sorted((place / "labels" / part).glob("*.txt"))
            images = sorted((place / "images" / part).glob("*.png"))
            assert [path.stem for path in texts] == [path.stem for path in images]
            assert [len(path.read_text().splitlines()) for path in texts] == [
                expected
            ] * 4
            coco = json.loads(
                (place / f"annotations/instances_{part}.json").read_text()
            )
            assert len(coco["annotations"]) == 4 * expected
            assert images[0].stat().st_ino == (folder / "image.png").stat().st_ino
        line = (place / "labels/train/train__0000.txt").read_text().splitlines()[0]
        number, *numbers = line.split()
        x, y, width, height = (float(number) for number in numbers)
        box = json.loads((place / "annotations/instances_train.json").read_text())
        assert number == "0"
        assert box["annotations"][0]["bbox"] == pytest.approx(
            [
                *((x - width / 2) * 160, (y - height / 2) * 120),
                *(width * 160, height * 120),
            ],
            abs=0.001,
        )


def test_experiments_of_several_machines_are_joined(
    bare_unghost, folder, trainer, tmp_path
):
    words = ("worth-it", folder, "--trainer", trainer)
    one, other = tmp_path / "one", tmp_path / "other"
    first = bare_unghost(*words, "--arms", "raw,depth", "--seeds", "1", "-o", one)

    second = bare_unghost(
        *(*words, "--arms", "raw,depth,auto", "--seeds", "1-2", "-o", other),
        *("--join", one, "--json"),
    )

    assert (first.code, second.code) == (DONE, DONE), second.err
    (result,) = second.records
    assert (result["tests"], result["seeds"]) == (["other"], [0, 1, 2])
    trials = {name: arm["trials"] for name, arm in result["arms"].items()}
    assert trials == {"raw": 3, "depth": 3, "auto": 2}


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), USAGE, "--output DIR is needed"),
        (("-o", "new", "--arms", "best"), USAGE, "--arms: expected raw, clipped"),
        (("-o", "new", "--seeds", "0"), USAGE, "--seeds: 0 has no seed"),
        (("-o", "new", "--trainer", "train {data}"), REFUSED, "found none of {seed}"),
        (("--no-train", "--engine", "bad"), USAGE, "--engine: 'bad' is not an engine"),
        (("--no-train", "--truth", "no.jsonl"), USAGE, "--truth: expected instances"),
        (
            ("--no-train", "--truth", "reviews"),
            REFUSED,
            "no box is known to be an object: SOURCE",
        ),
    ],
)
def test_refusals_say_what_helps(bare_unghost, folder, words, code, said):
    result = bare_unghost("worth-it", folder, *words)

    assert result.code == code
    assert said in " ".join(result.err.replace("│", " ").split())


@pytest.mark.skipif(find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_the_built_in_trainer_names_the_remedy(bare_unghost, folder):
    result = bare_unghost("worth-it", folder, "-o", "new")

    assert result.code == REFUSED
    assert "pip install 'unghost[train]'" in result.err
    assert not (bare_unghost.folder / "new").exists()


def test_failed_trainer_and_other_settings_are_refused(
    bare_unghost, folder, trainer, tmp_path
):
    stops = "'raise SystemExit(\"no GPU\")'"
    fails = f"{sys.executable} -c {stops} {{data}} {{seed}} {{output}}"
    words = ("worth-it", folder, "--seeds", "1", "-o", tmp_path / "out", "--arms")

    failed = bare_unghost(*words, "raw,auto", "--trainer", fails)
    other_trainer = bare_unghost(*words, "raw,auto", "--trainer", trainer)
    other_arm = bare_unghost(*words, "raw,depth", "--trainer", fails)

    codes = (failed.code, other_trainer.code, other_arm.code)
    assert codes == (REFUSED, REFUSED, REFUSED)
    assert "expected the trainer of its other trials" in other_trainer.err
    assert "arm raw, seed 0: the trainer ended with exit code 1" in failed.err
    assert "no GPU" in failed.err
    assert "made with no arm depth; choose another --output" in other_arm.err
