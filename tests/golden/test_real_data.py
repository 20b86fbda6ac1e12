"""Real CARLA data that others have published, filtered by the library."""

import json
from collections import Counter

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import read_source
from filter_core.geometry.boxes import to_xyxy
from filter_core.local import filter_source
from filter_core.pipeline import filter_frame
from tests.support.shared_data import shared

AUTHORS = "data/Mofeed-Chaar_base-repo-sample"
VOC = "data/ee267-trojanhorsepower"
SWAPPED = "data/ee267-litian-gong"
THREE_FORMS = "data/DanielHfnr_Carla-Object-Detection-Dataset"


@pytest.mark.parametrize("profile", ["paper", "carlasimu"])
def test_the_authors_own_frame_is_imported_and_corrected(profile):
    file = shared(f"{AUTHORS}/kept_rejected_oracle.DERIVED.json")
    oracle = json.loads(file.read_text())
    cars = RecordingDescription(default_class="car")
    frames = read_source(shared(f"{AUTHORS}/samples"), options=cars)

    (outcome,) = filter_source(frames, FilterConfig(profile=profile))

    assert (frames.layout, outcome.key) == ("carlasimu", "00000993")
    decisions = outcome.decisions or []
    reasons = Counter(box["reason"] for box in decisions)
    assert reasons == {"outside_image": 12, "no_segmentation": 20}
    for decision, expected in zip(decisions, oracle, strict=True):
        xyxy = decision["xyxy"]
        assert (xyxy is not None) == expected["inside"]
        if xyxy is not None:
            np.testing.assert_allclose(xyxy, expected["box"], atol=0.006)
            area = pytest.approx(expected["area_pct"], abs=0.006)
            assert decision["area_percent"] == area


def test_labels_without_a_class_get_the_reason_unmapped_class():
    frames = read_source(shared(f"{AUTHORS}/samples"))

    (outcome,) = filter_source(frames, FilterConfig())

    reasons = Counter(box["reason"] for box in outcome.decisions or ())
    assert reasons == {"outside_image": 12, "unmapped_class": 20}


def test_boxes_of_frames_without_a_segmentation_are_unmeasured():
    frames = read_source(shared(VOC))

    outcomes = list(filter_source(frames, FilterConfig()))

    assert [outcome.error for outcome in outcomes] == [None] * 13
    boxes = [box for outcome in outcomes for box in outcome.decisions or ()]
    assert Counter(box["verdict"] for box in boxes) == {"unmeasured": 117}
    whys = [file.why for file in frames.unmatched]
    assert whys == ["no label file for this instance image"]


def annotation_by_key(frames):
    return {frame.key: frame.annotation for frame in frames}


def test_voc_and_yolo_labels_of_a_dataset_give_the_same_boxes():
    root = shared(THREE_FORMS)
    labels = RecordingDescription(labels=root / "labels_yolo_format")
    voc = annotation_by_key(read_source(root, "voc"))
    yolo = annotation_by_key(read_source(root, "yolo", labels))

    assert len(voc) == 12
    assert voc.keys() == yolo.keys()
    for key, annotation in voc.items():
        camera = annotation["camera"]
        wh = (camera["width"], camera["height"])
        shares = [box["cxcywhn"] for box in yolo[key]["boxes"]]
        corners = np.reshape([box["xyxy"] for box in annotation["boxes"]], (-1, 4))
        # The author's converter takes the last pixel off: 388..392 is 4 px wide.
        np.testing.assert_allclose(
            to_xyxy("cxcywhn", shares, wh), corners - [0, 0, 1, 1], atol=1e-6
        )


def test_segmentation_with_swapped_channels_is_measured_correctly():
    folder = shared(f"{SWAPPED}/report/Part5_output")
    name = "instance_segmentation.modal_boxes.DERIVED.json"
    objects = json.loads((folder / name).read_text())["objects"]
    accept = {row["cls"]: {"accept": [row["tag"]]} for row in objects}
    boxes = [{"class": row["cls"], "xyxy": row["modal_box_xyxy"]} for row in objects]

    # Red and green are instance ids there, so only the config can say where tags are.
    mapping = {"encoding": "raw", "channel_order": "bgr", "classes": accept}
    content = (folder / "instance_segmentation.png").read_bytes()
    annotation = {"carla_version": "0.9.15", "boxes": boxes}

    result = filter_frame(annotation, content, FilterConfig.from_mapping(mapping))

    fills = [row["class_fill"] * 100 for row in objects]
    matches = [box["match_percent"] or 0.0 for box in result.decisions]
    np.testing.assert_allclose(matches, fills, atol=0.006)
    assert {box["verdict"] for box in result.decisions} <= {"kept", "rejected"}
