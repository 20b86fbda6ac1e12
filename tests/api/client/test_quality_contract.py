"""The client against a real server: quality, and kinds of evidence compared."""

from __future__ import annotations

import pytest

import unghost
from tests.support import frames
from tests.support.sensors import ANNOTATION, files, sensors
from unghost import OutgoingFrame


@pytest.fixture
def reviewed(client, filled) -> str:
    """Answers on four boxes: two agree with the filter, one does not, one is unsure."""
    boxes = list(client.boxes(filled, sort="id"))
    kept = [box for box in boxes if box.verdict == "kept"]
    rejected = [box for box in boxes if box.verdict == "rejected"]
    for box, answer in (
        (kept[0], "keep"),
        (kept[1], "unsure"),
        (rejected[0], "reject"),
        (rejected[1], "keep"),
    ):
        client.review(box.box_id, answer, seen_revision=0)
    return str(filled)


def test_quality_compares_the_filter_with_the_answers(client, reviewed):
    quality = client.quality(reviewed)

    assert (quality.reviewed, quality.unsure, quality.unmeasured) == (3, 1, 0)
    assert quality.confusion.kept_keep == 1
    assert quality.confusion.rejected_keep == 1
    assert quality.confusion.recall.value == 0.5
    assert quality.by_class["car"] == quality.confusion
    assert sum(band.rejected_reject for band in quality.by_distance) == 1
    assert quality.by_distance[-1].band == "unknown"
    (reviewer,) = quality.reviewers
    assert (reviewer.answers, reviewer.keep, reviewer.unsure) == (4, 2, 1)


@pytest.fixture
def dataset_with_answers(client, dataset) -> str:
    """A visible car, and a box with a part of a car, which people reject."""
    partly = {"id": "partly", "class": "car", "xyxy": [36, 24, 52, 40]}
    boxes = [{"id": "real", "class": "car", "xyxy": frames.ON_THE_CAR}, partly]
    client.put_frame(
        dataset,
        "a",
        {**frames.annotation(), "boxes": boxes},
        image=frames.image(),
        segmentation=frames.segmentation(),
    )
    for box in client.boxes(dataset):
        answer = "keep" if box.id == "real" else "reject"
        client.review(box.box_id, answer, seen_revision=0)
    return str(dataset)


def test_thresholds_are_suggested_with_their_curves(client, dataset_with_answers):
    (found,) = client.quality(dataset_with_answers).suggested

    assert (found.class_name, found.current, found.answers) == ("car", 10, 2)
    assert found.interval[0] <= found.suggested <= found.interval[1]
    curve = {point.threshold: point for point in found.curve}
    assert curve[found.suggested].recall == 1


def test_suggested_thresholds_follow_the_requested_target(client, dataset_with_answers):
    (found,) = client.quality(
        dataset_with_answers, target="recall", recall=0.5
    ).suggested

    assert found.suggested > 10
    with pytest.raises(unghost.Invalid):
        client.quality(dataset_with_answers, recall=2.0)


@pytest.fixture
def dataset_with_sensors(client, dataset, tmp_path) -> str:
    """A dataset of one frame with depth and instances."""
    paths = {}
    for name, content in {**files(), **sensors()}.items():
        paths[name] = tmp_path / f"{name}.png"
        paths[name].write_bytes(content)
    frame = OutgoingFrame("a", ANNOTATION, paths)
    (sent,) = client.push(dataset, [frame])
    assert isinstance(sent, unghost.Sent), sent
    return str(dataset)


def test_channels_are_measured_and_compared_with_instances(
    client, dataset_with_sensors
):
    before = client.evaluations(dataset_with_sensors)
    run = client.wait(client.evaluate(dataset_with_sensors))
    found = client.evaluations(dataset_with_sensors)

    assert "depth" in before.not_measured
    assert (run.kind, run.changed) == ("measure", 0)
    assert (found.truth, found.frames, found.boxes) == ("instances", 1, 2)
    assert found.not_measured == ()
    depth = found.channels["depth"]
    assert (depth.judged, depth.kept_visible, depth.f1.value) == (2, 1, 1)
    assert depth.by_class["car"].rejected_hidden == 1
    (ghost,) = found.channels["semantic"].worst
    assert (depth.worst, ghost.error) == ((), "kept_hidden")
    assert client.box(ghost.box_id).id == "218"
    assert sum(band.kept_visible for band in depth.by_distance) == 1
