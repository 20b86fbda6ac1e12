"""Scores of detections are those of pycocotools, and intervals are of what they say."""

import io
from contextlib import redirect_stdout
from dataclasses import replace

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from filter_core.evaluation.detections import (
    Detections,
    Objects,
    match,
    mean_precisions,
    operating_point,
    score_detections,
)

CLASSES = ("car", "walker", "bus")
NOTHING = np.empty(0, np.int64)
NO_GHOSTS = Objects(NOTHING, NOTHING, np.empty((0, 4)), NOTHING > 0, np.empty(0))


def random_case(seed, frames=12, *, rounded=False):
    """Objects, a fifth of them doubtful, and detections near them and elsewhere.

    `rounded`: many equal rectangles, overlaps and scores.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    corner = rng.uniform(0, 80, (count, 2))
    xyxy = np.hstack([corner, corner + rng.uniform(2, 40, (count, 2))])
    objects = Objects(
        np.sort(rng.integers(0, frames, count)),
        rng.integers(0, 2, count),
        np.round(xyxy, -1) if rounded else xyxy,
        rng.random(count) < 0.2,
        rng.uniform(0, 220, count),
    )
    near = rng.integers(0, count, 150)
    moved = objects.xyxy[near] + rng.normal(0, 4, (150, 4))
    moved = np.sort(moved.reshape(-1, 2, 2), axis=1).reshape(-1, 4)
    detections = Detections(
        np.where(rng.random(150) < 0.8, objects.frame[near], 0),
        np.where(rng.random(150) < 0.9, objects.label[near], 2),
        np.round(moved, -1) if rounded else moved,
        np.round(rng.random(150), 1 if rounded else 9),
    )
    return objects, detections, frames


def by_pycocotools(objects, detections, frames):
    """mAP50 and mAP50-95; doubtful objects are those outside of the range of areas."""
    sizes = objects.xyxy[:, 2:] - objects.xyxy[:, :2]
    truth = {
        "images": [{"id": number + 1} for number in range(frames)],
        "categories": [{"id": number + 1} for number in range(len(CLASSES))],
        "annotations": [
            {
                "id": row + 1,
                "image_id": int(objects.frame[row]) + 1,
                "category_id": int(objects.label[row]) + 1,
                "bbox": [*objects.xyxy[row, :2], *sizes[row]],
                "area": -1 if objects.ignored[row] else 1,
                "iscrowd": 0,
            }
            for row in range(len(sizes))
        ],
    }
    results = [
        {
            "image_id": int(frame) + 1,
            "category_id": int(label) + 1,
            "bbox": [*xyxy[:2], *(xyxy[2:] - xyxy[:2])],
            "score": float(score),
        }
        for frame, label, xyxy, score in zip(*vars(detections).values(), strict=True)
    ]
    with redirect_stdout(io.StringIO()):
        coco = COCO()
        coco.dataset = truth
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(results), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation.stats[1], evaluation.stats[0]


def degenerate_cases():
    objects, detections, frames = random_case(3)
    flat = detections.xyxy.copy()
    flat[:, 2] = flat[:, 0]
    wrong = replace(detections, xyxy=flat)
    frame, label = np.full(300, objects.frame[0]), np.full(300, objects.label[0])
    everywhere = np.tile(objects.xyxy[:1], (300, 1))
    many = Detections(frame, label, everywhere, np.linspace(1, 0, 300))
    count = len(objects.frame)
    exact = Detections(objects.frame, objects.label, objects.xyxy, np.ones(count))
    doubtful = replace(objects, ignored=np.arange(count) > 0)
    yield pytest.param(objects, wrong, frames, id="detections without area")
    yield pytest.param(objects, detections[np.array([0])], frames, id="one detection")
    yield pytest.param(objects[np.array([0])], detections, frames, id="one object")
    yield pytest.param(objects, many, frames, id="more than 100 in a frame")
    yield pytest.param(objects, exact, frames, id="the objects themselves")
    yield pytest.param(doubtful, detections, frames, id="one object is no doubt")


RANDOM = [random_case(seed, rounded=coarse) for seed in range(12) for coarse in (0, 1)]


@pytest.mark.parametrize(
    ("objects", "detections", "frames"), [*RANDOM, *degenerate_cases()]
)
def test_scores_are_those_of_pycocotools(objects, detections, frames):
    scores = score_detections(objects, detections, NO_GHOSTS, CLASSES, frames)

    means = scores["map50"], scores["map50_95"]
    assert means == pytest.approx(by_pycocotools(objects, detections, frames), abs=1e-6)


def test_without_detections_or_objects_all_scores_are_0():
    objects, detections, frames = random_case(1)

    missed = score_detections(objects, detections[NOTHING], NO_GHOSTS, CLASSES, frames)
    empty = score_detections(objects[NOTHING], detections, NO_GHOSTS, CLASSES, frames)

    assert (missed["map50"], missed["recall"]) == (0, 0)
    assert (empty["map50"], empty["by_class"], empty["by_distance"]) == (0, {}, {})


def test_resample_of_frames_is_scored_like_the_frames_drawn():
    objects, detections, frames = random_case(5)
    drawn = np.random.default_rng(0).integers(0, frames, frames)
    weights = np.bincount(drawn, minlength=frames)[None].astype(float)

    def repeated(table):
        rows = [np.flatnonzero(table.frame == frame) for frame in drawn]
        again = table[np.concatenate(rows)]
        numbers = np.repeat(np.arange(frames), [len(row) for row in rows])
        return type(table)(**{**vars(again), "frame": numbers})

    weighted = mean_precisions(match(objects, detections, frames), weights)
    again = mean_precisions(
        match(repeated(objects), repeated(detections), frames), np.ones((1, frames))
    )

    assert np.concatenate(weighted) == pytest.approx(np.concatenate(again), abs=1e-9)


def rows(*lines):
    """Tables from lines of frame, x, and score or distance; all are 10 px wide."""
    frame, x, last = map(np.array, zip(*lines, strict=True))
    xyxy = np.stack([x, 0 * x, x + 10, 0 * x + 10], axis=1).astype(float)
    return frame, np.zeros(len(frame), np.int64), xyxy, last.astype(float)


def test_operating_point_bands_and_false_positives_on_ghosts():
    frame, label, xyxy, distance = rows((0, 0, 20), (0, 50, 80), (1, 0, 20))
    objects = Objects(frame, label, xyxy, np.zeros(3, np.bool_), distance)
    frame, label, xyxy, distance = rows((0, 100, 0))
    ghosts = Objects(frame, label, xyxy, np.zeros(1, np.bool_), distance)
    # Two right, one on the ghost, one elsewhere, and a right one of a low score.
    detections = Detections(
        *rows((0, 0, 0.9), (1, 0, 0.8), (0, 100, 0.7), (1, 50, 0.6), (0, 50, 0.5))
    )

    scores = score_detections(objects, detections, ghosts, CLASSES, 2)

    assert (scores["precision"], scores["recall"]) == (1.0, 2 / 3)
    assert (scores["false_positives"], scores["on_ghosts"]) == (0, 0)
    bands = {name: band["recall"] for name, band in scores["by_distance"].items()}
    assert bands == {"0-50": 1.0, "50-100": 0.0}
    later = detections[np.arange(2, 5)]
    low = operating_point(list(match(objects, later, 2).values()))
    assert low.score == 0.5
    lower = score_detections(objects, later, ghosts, CLASSES, 2)
    assert (lower["false_positives"], lower["on_ghosts"]) == (1.0, 0.5)
