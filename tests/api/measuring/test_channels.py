"""Depth, instances and order over HTTP: once measured, switched without pixels."""

from itertools import product

import cv2
import numpy as np
import pytest

from tests.support.api import BY_TAGS
from tests.support.lidar import npy
from tests.support.pictures import pixels_of, png
from tests.support.sensors import (
    ANNOTATION,
    coarse_depth_file,
    depth_png,
    files,
    instance_png,
    scene,
    sensors,
)


@pytest.fixture
def dataset(api):
    return api.dataset_of_one_frame(ANNOTATION, config=BY_TAGS, **sensors())


def far_box(api, dataset):
    return next(box for box in api.boxes(dataset) if box["id"] == "218")


def test_channels_are_measured_once_then_switched_without_pixels(api, dataset):
    assert far_box(api, dataset)["verdict"] == "kept"

    kinds = [
        api.run(dataset, {"evidence": name})["kind"]
        for name in ("auto", "semantic", "depth", "ordered", "instance", "auto")
    ]

    assert kinds == ["measure", *["decide"] * 5]
    box = far_box(api, dataset)
    assert (box["verdict"], box["reason"]) == ("rejected", "hidden_by_instance")
    assert box["evidence"] == "instance"


def test_the_history_of_a_box_has_the_verdicts_of_its_channels(api, dataset):
    """A box that is explained by a nearer one names it."""
    api.run(dataset, {"evidence": "ordered"})
    box = far_box(api, dataset)
    for evidence in ("semantic", "depth"):
        api.run(dataset, {"evidence": evidence})

    path = f"/boxes/{box['box_id']}/history"
    said = [(entry["verdict"], entry["reason"]) for entry in api.json(path)["items"]]

    assert box["explained_by"] == "217"
    words = "rejected: its Car pixels belong to nearer boxes, above all car 217"
    assert box["explanation"] == words
    assert said == [
        ("rejected", "hidden_by_depth"),
        ("kept", "visible"),
        ("rejected", "explained_by_nearer"),
        ("kept", "visible"),
    ]


def test_frames_stored_later_are_measured_with_the_active_channel(api, dataset):
    api.run(dataset, {"evidence": "depth"})

    response = api.upload_frame(dataset, "b", ANNOTATION, **sensors())

    assert [box["evidence"] for box in response["decisions"]] == ["depth", "depth"]
    assert [box["verdict"] for box in response["decisions"]] == ["kept", "rejected"]
    assert api.boxes(dataset, reason="hidden_by_depth", limit=5)[1]["frame"] == "b"


def test_too_coarse_depth_is_stored_but_refused_once_depth_is_used(api):
    name = api.dataset(config=BY_TAGS)
    grey = cv2.imencode(".png", np.zeros(scene()[0].shape, np.uint8))[1].tobytes()
    api.upload_frame(name, "a", ANNOTATION, **files(depth=grey))

    run = api.run(name, {"evidence": "depth"})

    assert run["state"] == "failed"
    assert "3.9 m" in run["error"]["detail"]
    refused = api.dataset(config={"evidence": "depth"})
    response = api.put(refused, "a", ANNOTATION, **files(depth=grey))
    assert (response.status_code, response.json()["code"]) == (422, "depth_too_coarse")
    assert response.json()["errors"][0]["pointer"] == "/depth"


def test_notes_on_depth_and_instances_are_in_the_report_of_an_upload(api):
    name = api.dataset()
    tags, _, ids = scene()
    api.post(f"/datasets/{name}/configs", {"evidence": "auto"})
    api.run(name, {"evidence": "auto"})
    sent = files(
        depth=coarse_depth_file(), instances=instance_png(tags, ids, swapped=True)
    )

    response = api.upload_frame(name, "a", ANNOTATION, **sent)
    repeated = api.upload_frame(name, "a", ANNOTATION, **sent)
    bare = api.upload_frame(name, "b", ANNOTATION, depth=coarse_depth_file())

    swapped, unused = response["segmentation"]["notes"][-2:]
    assert swapped == "red and blue are swapped in the instance image; read as bgr"
    assert unused.startswith("depth is not used as evidence: ")
    assert [box["verdict"] for box in response["decisions"]] == ["kept", "rejected"]
    assert response["notes"] == response["segmentation"]["notes"][-2:]
    assert repeated["notes"] == []
    assert (bare["segmentation"], bare["notes"]) == (None, [unused])


def test_changed_depth_encoding_needs_the_pixels(api):
    name = api.dataset()
    swapped = png(pixels_of(depth_png(scene()[1])), "rgb")
    api.upload_frame(name, "a", ANNOTATION, **files(depth=swapped))
    api.run(name, {"evidence": "depth"})

    again = api.run(name, {"evidence": "depth", "depth_encoding": "carla-bgr"})
    wrong = api.run(name, {"evidence": "depth", "depth_encoding": "millimetres16"})

    assert (again["kind"], again["state"]) == ("measure", "done")
    # The image is not used, and the frame is named.
    assert (wrong["kind"], wrong["state"]) == ("measure", "done")
    (problem,) = api.json(f"/datasets/{name}/problems")["items"]
    assert problem["key"] == "a"
    assert "expected grey with 16 bits" in str(problem)


def test_incomplete_point_cloud_is_refused(api):
    name, cloud = api.dataset(), npy(np.zeros((3, 6)))

    for kind, content in product(
        ("lidar", "radar"), (b"ply\n", cloud[:-1], cloud + b"x")
    ):
        response = api.put(name, "a", ANNOTATION, **files(**{kind: content}))
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "bad_lidar"), (kind, content)
        assert response.json()["errors"][0]["pointer"] == f"/{kind}"
        assert f"the {kind} file" in response.json()["detail"]
    assert api.json(f"/datasets/{name}/frames")["items"] == []
