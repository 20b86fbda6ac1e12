"""Kinds of evidence compared over HTTP; the truth is instances or people's answers."""

import cv2
import numpy as np
import pytest

from tests.support.api import BY_TAGS
from tests.support.lidar import ascii_ply, npy
from tests.support.sensors import ANNOTATION, depth_png, files, scene, sensors

CHANNELS = ["ordered", "depth", "depth_center", "instance", "lidar"]


@pytest.fixture
def dataset(api):
    return api.dataset_of_one_frame(ANNOTATION, config=BY_TAGS, **sensors())


def run_evaluation(api, dataset):
    return api.wait_for_job(api.post(f"/datasets/{dataset}/evaluations"))


def test_evaluation_lists_channels_that_are_not_measured(api, dataset):
    report = api.json(f"/datasets/{dataset}/evaluations")
    quality = api.json(f"/datasets/{dataset}/quality", truth="instances")
    unknown = api.get(f"/datasets/{dataset}/evaluations", truth="guess")

    assert report["not_measured"] == CHANNELS
    assert list(report["channels"]) == ["semantic"]
    assert report["boxes"] == 0
    assert (quality["confusion"]["f1"], quality["suggested"]) == (None, [])
    assert unknown.status_code == 422


def test_every_channel_is_measured_once_and_no_verdict_changes(api, dataset):
    before = api.verdicts(dataset)

    run = run_evaluation(api, dataset)

    assert (run["kind"], run["state"], run["changed"]) == ("measure", "done", 0)
    assert api.verdicts(dataset) == before
    report = api.json(f"/datasets/{dataset}/evaluations")
    assert (report["truth"], report["frames"], report["boxes"]) == ("instances", 1, 2)
    assert report["not_measured"] == []
    kept = {name: scores["kept_hidden"] for name, scores in report["channels"].items()}
    assert kept == {**dict.fromkeys(CHANNELS, 0), "semantic": 1, "lidar": 1}
    unfiltered = report["unfiltered"]
    assert (unfiltered["kept_visible"], unfiltered["kept_hidden"]) == (1, 1)
    assert report["channels"]["lidar"]["judged"] == 0
    (worst,) = report["channels"]["semantic"]["worst"]
    ghost = next(box for box in api.boxes(dataset) if box["id"] == "218")
    assert (worst["box_id"], worst["error"]) == (ghost["box_id"], "kept_hidden")
    assert worst["frame_id"] == ghost["frame_id"]
    assert report["channels"]["depth"]["worst"] == []
    assert report["channels"]["depth"]["by_class"]["car"]["f1"]["value"] == 1

    previews = {
        evidence: api.post(
            f"/datasets/{dataset}/preview", {"config": {"evidence": evidence}}
        ).json()
        for evidence in ("semantic", "depth", "auto")
    }
    assert [preview["needs_pixels"] for preview in previews.values()] == [False] * 3
    assert previews["semantic"]["counts"]["kept"] == 2
    assert previews["depth"]["flips"]["kept_to_rejected"] == 1
    assert run_evaluation(api, dataset)["kind"] == "decide"
    assert api.run(dataset, {"evidence": "depth"})["kind"] == "decide"
    assert api.verdicts(dataset) == {"217": "kept", "218": "rejected"}


def test_preview_is_compared_with_instances_or_with_answers(api, dataset):
    run_evaluation(api, dataset)
    path = f"/datasets/{dataset}/preview"
    body = {"config": {"evidence": "depth"}, "truth": "instances"}

    preview = api.post(path, body).json()

    scores = preview["scores"]
    assert (scores["boxes"], scores["before"]["kept_reject"]) == (2, 1)
    assert scores["before"]["precision"]["value"] == 0.5
    assert scores["after"]["precision"]["value"] == 1
    (flip,) = preview["flips"]["items"]
    assert (flip["after"]["verdict"], flip["visible"]) == ("rejected", False)
    assert api.post(path, {"config": {}}).json()["scores"] is None

    ghost = next(box for box in api.boxes(dataset) if box["id"] == "218")
    assert api.review(ghost["box_id"], "keep").status_code == 201
    people = api.post(path, body | {"truth": "people"}).json()

    assert people["scores"]["boxes"] == 1
    assert people["scores"]["after"]["rejected_keep"] == 1
    assert people["flips"]["items"][0]["visible"] is True


def test_evaluation_with_answers_of_people_as_truth(api, dataset):
    run_evaluation(api, dataset)
    for box in api.boxes(dataset):
        answer = "keep" if box["id"] == "217" else "reject"
        assert api.review(box["box_id"], answer).status_code == 201

    report = api.json(f"/datasets/{dataset}/evaluations", truth="people")
    api.upload_frame(dataset, "b", ANNOTATION, **sensors())
    later = api.json(f"/datasets/{dataset}/evaluations")

    assert report["boxes"] == 2
    assert report["channels"]["semantic"]["kept_hidden"] == 1
    assert report["channels"]["ordered"]["f1"]["value"] == 1
    assert (later["frames"], later["boxes"]) == (2, 4)


def damage_png(png):
    """A PNG of the same size, with one byte of its pixels changed."""
    at = png.index(b"IDAT") + 20
    return png[:at] + bytes([png[at] ^ 0xFF]) + png[at + 1 :]


GREY = cv2.imencode(".png", np.zeros(scene()[0].shape, np.uint8))[1].tobytes()
FAULTY = {
    "NaN": ("lidar", npy(np.full((3, 6), np.nan)), "bad_lidar"),
    "word": ("lidar", ascii_ply().replace(b"8.0", b"x.0"), "bad_lidar"),
    "depth": ("depth", damage_png(sensors()["depth"]), "bad_image"),
    "instances": ("instances", damage_png(sensors()["instances"]), "bad_image"),
    "size": ("depth", depth_png(np.ones((3, 5))), "image_size_mismatch"),
}
"""By the frame's key: a file, what it has in it, and the code of the problem."""


def test_invalid_sensor_files_are_problems_and_do_not_fail_the_run(api, dataset):
    """Nor does depth that is too coarse, which is not even a problem."""
    api.upload_frame(dataset, "coarse", ANNOTATION, **files(depth=GREY))
    for key, (kind, content, _) in FAULTY.items():
        api.upload_frame(dataset, key, ANNOTATION, **{**sensors(), kind: content})

    run = run_evaluation(api, dataset)

    assert (run["state"], run["done"]) == ("done", 2 + len(FAULTY))
    problems = api.json(f"/datasets/{dataset}/problems")["items"]
    assert {problem["key"] for problem in problems} == FAULTY.keys()
    for problem in problems:
        (kind, _, code), error = FAULTY[problem["key"]], problem["error"]
        assert error["code"] == code, problem
        assert error["errors"][0]["pointer"] == f"/{kind}"
        assert error["detail"].startswith(f"frame {problem['key']}: ")
        api.upload_frame(dataset, problem["key"], ANNOTATION, **sensors(), replace=True)
    assert api.json(f"/datasets/{dataset}/problems")["items"] == []


def test_thresholds_are_suggested_from_instances_without_answers(api):
    name = api.dataset(config=BY_TAGS)
    beside = {"id": "ghost", "class": "car", "xyxy": [20, 30, 80, 100]}
    boxes = [ANNOTATION["boxes"][0], beside]
    api.upload_frame(name, "a", {**ANNOTATION, "boxes": boxes}, **sensors())
    run_evaluation(api, name)

    quality = api.json(f"/datasets/{name}/quality", truth="instances")

    said = ("instances", 0, 0)
    assert (quality["truth"], quality["reviewed"], quality["unmeasured"]) == said
    scores = quality["confusion"]
    assert quality["by_class"] == {"car": scores}
    assert (scores["kept_keep"], scores["kept_reject"]) == (1, 1)
    (car,) = quality["suggested"]
    # A sixth of the ghost's box is the car that stands beside it.
    assert (car["class"], car["current"], car["answers"]) == ("car", 10, 2)
    assert 722 / 4200 < car["suggested"] / 100 < 0.9
    assert car["f1_suggested"] == 1
    assert api.json(f"/datasets/{name}/quality")["suggested"] == []
