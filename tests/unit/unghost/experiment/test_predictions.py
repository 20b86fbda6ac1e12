"""What a trainer has detected: how images may be called; errors name the result."""

import json

import numpy as np
import pytest

from filter_core.evaluation.trials import TrialKey
from unghost.experiment.trials import Experiment, TrialError

IMAGE = {"id": 7, "file_name": "a__1.png", "key": "a/1", "sequence": "a"}
RESULT = {"image_id": 7, "category_id": 2, "bbox": [1, 2, 10, 20], "score": 0.5}


@pytest.fixture
def experiment(tmp_path):
    """One frame and two classes, with a trial whose predictions are still to come."""
    truth = {
        "images": [IMAGE],
        "categories": [{"id": 1, "name": "car"}, {"id": 2, "name": "bus"}],
        "annotations": [],
        "ghosts": [],
    }
    made = Experiment(tmp_path)
    arm = made.data / "arms" / "raw"
    arm.mkdir(parents=True)
    made.trial_folder("raw", 0).mkdir(parents=True)
    (made.data / "truth.json").write_text(json.dumps(truth))
    (arm / "own_val.json").write_text(json.dumps({"annotations": []}))
    return made


def detections(experiment, results):
    path = experiment.trial_folder("raw", 0) / "predictions.json"
    path.write_text(json.dumps(results))
    return experiment.trial(TrialKey(0, "raw", 0)).detections


@pytest.mark.parametrize("name", [7, "a__1.png", "a__1"])
def test_images_are_called_by_number_or_by_file(experiment, name):
    table = detections(experiment, [{**RESULT, "image_id": name}])

    assert table.frame.tolist() == [0]
    assert table.label.tolist() == [1]
    assert table.xyxy == pytest.approx(np.array([[1.0, 2.0, 11.0, 22.0]]))


def test_no_detection_is_a_result(experiment):
    assert detections(experiment, []).xyxy.shape == (0, 4)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"image_id": 8}, "result 0: expected an image_id of the part val"),
        ({"category_id": 0}, "category_id from 1 to 2, found 7 and 0"),
        (
            {"bbox": [1, 2, -3, 4]},
            "result 0: expected a bbox as x, y, width and height",
        ),
        ({"bbox": [1, 2, 3]}, "expected a bbox"),
        ({"bbox": "none"}, "expected results as COCO has them"),
        ({"score": None}, "expected results as COCO has them"),
    ],
)
def test_wrong_result_is_named(experiment, wrong, said):
    with pytest.raises(TrialError, match=said):
        detections(experiment, [{**RESULT, **wrong}])
