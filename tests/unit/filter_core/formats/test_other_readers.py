"""Exports are readable by other tools: pycocotools, and rules of larger tools.

Tools that are too large to install here are replaced by their rules. `make readers`
runs Ultralytics, supervision and Datumaro themselves on an export.
"""

import csv
import io
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet
import pytest
import yaml
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from filter_core.formats.export import ExportError
from tests.support.exporting import CLASSES, box, export, frame, write_exported_files

KEYS = ["Town05_1.5km", "a/000001", "a/000002", "straße 7", "empty", "IMG.v2"]


def street(*, empty="empty"):
    """Six frames with boxes of every class; the frame `empty` has none."""
    generator = np.random.default_rng(5)
    for number, key in enumerate(KEYS):
        corners = generator.uniform(0, 60, (0 if key == empty else 5, 2))
        sizes = generator.uniform(8, 40, corners.shape)
        boxes = [
            box(index, (*low, *(low + size)), class_name=CLASSES[index % 3])
            for index, (low, size) in enumerate(zip(corners, sizes, strict=True))
        ]
        yield frame(key, *boxes, map=f"Town0{number % 2}")


def scored(tmp_path, capsys, files, detected):
    """The truth of a COCO file as pycocotools reads it, and the mean precision."""
    truth = tmp_path / "truth.json"
    truth.write_bytes(files["annotations/instances_train.json"])
    loaded = COCO(str(truth))
    rows = detected(loaded)
    scores = COCOeval(loaded, loaded.loadRes(rows), "bbox")
    scores.evaluate()
    scores.accumulate()
    scores.summarize()
    capsys.readouterr()
    return loaded, scores.stats[0]


def test_pycocotools_scores_perfect_detections_with_1(tmp_path, capsys):
    files = export("coco", street(), images="none", split=1.0)

    def perfect(loaded):
        keys = ("image_id", "category_id", "bbox")
        return [
            {"score": 0.9, **{key: row[key] for key in keys}}
            for row in loaded.anns.values()
        ]

    loaded, precision = scored(tmp_path, capsys, files, perfect)

    assert len(loaded.anns) == 25
    assert precision == pytest.approx(1.0)
    assert [row["name"] for row in loaded.loadCats(loaded.getCatIds())] == list(CLASSES)
    assert len(loaded.getImgIds()) == len(KEYS)


def test_pycocotools_ignores_dontcare_boxes(tmp_path, capsys):
    ghost = box("ghost", (50, 10, 70, 30), "rejected")
    files = export("coco", [frame("a", box(0), ghost)], split=1.0, rejected="dontcare")
    detected = [
        {"image_id": 1, "category_id": 1, "bbox": bbox, "score": score}
        for bbox, score in (([10, 20, 20, 40], 0.5), ([50, 10, 20, 20], 0.9))
    ]

    _, precision = scored(tmp_path, capsys, files, lambda _: detected)

    # If it counted as an object, the ghost would be a false positive.
    assert precision == pytest.approx(1.0)


def ultralytics_labels(root):
    """Check a YOLO dataset by the rules of Ultralytics; yields each label's values.

    They are those of its `check_det_dataset` and `verify_image_label`.
    """
    data = yaml.safe_load((root / "data.yaml").read_text("utf-8"))
    assert "path" not in data
    assert list(data["names"]) == list(range(len(data["names"])))
    for part in ("train", "val"):
        folder = (root / data[part]).resolve()
        assert folder.is_dir()
        for image in sorted(folder.rglob("*.*")):
            content = np.frombuffer(image.read_bytes(), np.uint8)
            assert cv2.imdecode(content, 1) is not None
            # The last images/ in the path becomes labels/, the suffix .txt.
            before, _, after = str(image).rpartition("/images/")
            label = Path(f"{before}/labels/{after}").with_suffix(".txt")
            rows = [line.split() for line in label.read_text("utf-8").splitlines()]
            values = np.array(rows, np.float32).reshape(-1, 5)
            assert (values >= 0).all()
            assert (values[:, 1:] <= 1).all()
            assert (values[:, 0] < len(data["names"])).all()
            assert len(np.unique(values, axis=0)) == len(values)
            yield part, image.stem, values


def test_yolo_export_passes_the_rules_of_ultralytics(tmp_path):
    root = write_exported_files(
        tmp_path / "my data", export("yolo", street(), split=0.5)
    )

    read = list(ultralytics_labels(root))

    assert {part for part, _, _ in read} == {"train", "val"}
    assert sorted(stem for _, stem, _ in read) == sorted(
        key.replace("/", "__") for key in KEYS
    )
    assert sum(len(values) for _, _, values in read) == 25
    assert [len(values) for _, stem, values in read if stem == "empty"] == [0]


def test_csv_export_has_a_row_per_box_and_escapes_formulas():
    evil = box("=1+1", comment=None, class_name="car")
    said = {"verdict": "reject", "reviewer": "@me", "comment": '=HYPERLINK("x"),\n"y"'}
    odd = box(1, review=said, effective_verdict="rejected", margin=-3.5)
    files = export("decisions-csv", [frame("-key", evil, odd, map="+Town")])

    rows = list(
        csv.DictReader(io.StringIO(files["decisions.csv"].decode(), newline=""))
    )

    assert [row["frame"] for row in rows] == ["'-key", "'-key"]
    assert [row["box"] for row in rows] == ["'=1+1", "1"]
    assert rows[1]["comment"] == "'" + said["comment"]
    assert (rows[1]["reviewer"], rows[1]["map"]) == ("'@me", "'+Town")
    assert float(rows[1]["margin"]) == -3.5
    assert (rows[0]["verdict"], rows[1]["effective_verdict"]) == ("kept", "rejected")


@pytest.mark.parametrize("form", ["decisions-csv", "decisions-parquet"])
def test_table_export_without_decision_columns_is_refused(form):
    without = frame("town/7", box(1), columns=None)
    empty = frame("town/8", columns=None)

    with pytest.raises(ExportError, match=r"^town/7: the columns of its decisions"):
        export(form, [empty, without])

    assert export(form, [empty])


def test_parquet_export_is_typed():
    files = export("decisions-parquet", street())
    table = pyarrow.parquet.read_table(io.BytesIO(files["decisions.parquet"]))

    assert table.num_rows == 25
    assert str(table.schema.field("x_min").type) == "double"
    assert table.column("class").to_pylist()[:3] == list(CLASSES)
