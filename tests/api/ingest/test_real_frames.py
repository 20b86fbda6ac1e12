"""Real CARLA frames that others have made, uploaded over HTTP."""

from __future__ import annotations

import json
from collections import Counter

import cv2
import numpy as np
import pytest

from filter_core.formats.reading import ReadOptions
from filter_core.formats.registry import read_source
from tests.support.shared_data import shared

AUTHORS = "data/Mofeed-Chaar_base-repo-sample"
VOC = "data/ee267-trojanhorsepower"
SWAPPED = "data/ee267-litian-gong/report/Part5_output"


def send(api, dataset, frame):
    assert frame.image is not None
    return api.upload_frame(
        dataset, frame.key, frame.annotation, image=frame.image.read_bytes()
    )


def test_authors_frame_without_segmentation_is_unmeasured(api):
    source = read_source(
        shared(f"{AUTHORS}/samples"), options=ReadOptions(default_class="car")
    )
    oracle = json.loads(
        shared(f"{AUTHORS}/kept_rejected_oracle.DERIVED.json").read_text()
    )
    dataset = api.dataset()

    (stored,) = [send(api, dataset, frame) for frame in source]

    decisions = stored["decisions"]
    assert Counter((one["verdict"], one["reason"]) for one in decisions) == {
        ("rejected", "outside_image"): 12,
        ("unmeasured", "no_segmentation"): 20,
    }
    for decision, expected in zip(decisions, oracle, strict=True):
        assert (decision["xyxy"] is not None) == expected["inside"]
        if expected["inside"]:
            assert decision["xyxy"] == pytest.approx(expected["box"], abs=0.006)
    effective = api.json(f"/datasets/{dataset}/stats")["effective"]
    assert effective == {"kept": 0, "rejected": 12, "unmeasured": 20}


def test_frames_without_segmentation_are_unmeasured_and_to_review(api):
    source = read_source(shared(VOC))
    dataset = api.dataset()

    for frame in source:
        send(api, dataset, frame)

    stats = api.json(f"/datasets/{dataset}/stats")
    assert (stats["frames"], stats["boxes"]) == (13, 117)
    assert stats["effective"] == {"kept": 0, "rejected": 0, "unmeasured": 117}
    assert stats["to_review"] == 117
    waiting = api.boxes(dataset, review="undecided", sort="doubt", limit=1000)
    assert len(waiting) == 117
    kept = api.review(waiting[0]["box_id"], "keep")
    assert kept.json()["effective_verdict"] == "kept"
    assert api.json(f"/datasets/{dataset}/stats")["effective"]["kept"] == 1


def test_tags_in_the_blue_channel_are_recognised(api):
    """The tags are in the blue channel, as if the writer had swapped red and blue."""
    rgb = cv2.imread(str(shared(f"{SWAPPED}/instance_segmentation.png")))
    assert rgb is not None
    swapped = np.zeros_like(rgb)
    swapped[..., 0] = rgb[..., 0]
    boxes = json.loads(
        shared(f"{SWAPPED}/instance_segmentation.modal_boxes.DERIVED.json").read_text()
    )["objects"]
    sent = [
        {"class": one["cls"], "xyxy": one["modal_box_xyxy"]}
        for one in boxes
        if one["cls"] in ("car", "truck", "bus", "traffic_light")
    ]
    segmentation = cv2.imencode(".png", swapped)[1].tobytes()

    stored = api.upload_frame(
        api.dataset(),
        "a",
        {"carla_version": "0.9.15", "boxes": sent},
        segmentation=segmentation,
    )

    report = stored["segmentation"]
    assert (report["channel_order"], report["encoding"]) == ("bgr", "raw")
    assert report["palette"] == "carla-0.9.14"
    assert {one["verdict"] for one in stored["decisions"]} <= {"kept", "rejected"}
    assert "kept" in {one["verdict"] for one in stored["decisions"]}
