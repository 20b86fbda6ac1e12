"""Previews, histograms and comparisons give the same results if computed in parts."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from app.boxes.counts import count_boxes
from app.boxes.filter import BoxFilter
from app.jobs.driver import drive_job
from app.measuring.columns import ColumnCache
from app.quality.service import evaluation, quality, request_evaluation
from app.runs.flips import (
    compared_runs,
    current_histogram,
    preview,
    run_diff,
)
from filter_core.evaluation.thresholds import Goal
from tests.support import frames as scene
from tests.support.sensors import ANNOTATION, cube, sensors
from tests.support.services import run_job
from unghost.wire.runs import Diff, PreviewIn

FRAMES = 9
MOST_BOXES = 40
"""Fewer than the dataset has, so that it is read in parts: one frame at a time."""
STRICTER = {"min_visible_pixels": 400}


@pytest.fixture(scope="module")
def street(services):
    """Frames of five boxes with every channel measured, and some answers."""
    street = services.dataset()
    for number in range(FRAMES):
        boxes = [cube("near", 10.0), cube("behind", 25.0 + number / 4)]
        boxes += [cube_beside(place, 12.0 + number / 4 + place) for place in range(3)]
        boxes[number % 5]["class"] = "truck"
        street.put(str(number), {**ANNOTATION, "boxes": boxes}, **sensors())
    with street.context.database.write() as session:
        run = request_evaluation(
            street.idle_context, session, street.row(session), "ada"
        ).id
    drive_job(street.context, run_job(run))
    for place, verdict in enumerate(("keep", "reject", "keep", "unsure")):
        street.review(street.box_ids()[place * 7], verdict)
    return street


@pytest.fixture(scope="module")
def street_with_histograms(services):
    """Frames with a histogram of tags, so that a preview can accept other tags."""
    street = services.dataset()
    for number in range(FRAMES):
        street.put(str(number), scene.annotation(), segmentation=scene.segmentation())
    return street


def cube_beside(place, distance):
    box = cube(str(place), distance)
    box["box3d"]["transform"]["y"] = 1.0 + place
    return box


def asked(street, most_boxes, question):
    context = replace(street.context, owned={ColumnCache: ColumnCache(most_boxes)})
    with context.database.read() as session:
        return question(context, session, street.row(session))


def preview_question(config):
    return partial(preview, request=PreviewIn(config=config, limit=4, bins=20))


COMPUTATIONS: Mapping[str, Callable[..., Any]] = {
    "preview": preview_question(STRICTER),
    "histogram": partial(current_histogram, bins=20),
    "evaluation by instances": partial(evaluation, truth="instances"),
    "evaluation by people": partial(evaluation, truth="people"),
    "quality by instances": partial(quality, truth_and_goal=("instances", Goal())),
    "quality by people": partial(quality, truth_and_goal=("people", Goal())),
}


@pytest.mark.parametrize("question", COMPUTATIONS.values(), ids=list(COMPUTATIONS))
def test_result_computed_in_parts_equals_the_result_at_once(street, question):
    whole = asked(street, 10**6, question)

    assert asked(street, MOST_BOXES, question) == whole


def test_preview_with_other_accept_sets_is_equal_in_parts(street_with_histograms):
    question = preview_question(
        {"profile": "paper", "classes": {"car": {"accept": ["Sky"]}}}
    )
    whole = asked(street_with_histograms, 10**6, question)

    assert whole.flips.total == 2 * FRAMES
    assert asked(street_with_histograms, 16, question) == whole


def test_every_tested_question_has_a_nonempty_result(street):
    results = {
        name: asked(street, 10**6, question) for name, question in COMPUTATIONS.items()
    }

    assert results["preview"].flips.total > 4
    assert results["evaluation by instances"].frames == FRAMES
    assert results["evaluation by people"].boxes == 3
    assert results["quality by instances"].confusion.kept_reject > 0
    assert sum(map(sum, results["histogram"].classes.values())) == 5 * FRAMES


@pytest.mark.parametrize("config", [STRICTER, {"profile": "carlasimu"}])
def test_run_diff_computed_in_parts_is_equal_on_every_page(street, config):
    """With the profile carlasimu, the second run is measured anew."""
    first = street.run({}, activate=False).id
    second = street.run({**config, "min_visible_pixels": 400}, activate=False).id

    def pages(context, session, _):
        diffs: list[Diff] = []
        cursor = None
        while cursor is not None or not diffs:
            runs = compared_runs(session, second, first)
            diffs.append(run_diff(context, session, runs, 10, cursor))
            cursor = diffs[-1].next_cursor
        return diffs

    whole = asked(street, 10**6, pages)

    assert len(whole) > 1
    assert len({flip.box_id for page in whole for flip in page.items}) == (
        whole[0].total
    )
    assert asked(street, MOST_BOXES, pages) == whole


def test_classes_of_a_run_diff_keep_their_order_in_parts(services):
    street = services.dataset()
    for number, seen in enumerate(("truck", "car")):
        boxes = [cube_beside(4, 10.0), cube("near", 10.0)]
        boxes[1]["class"] = seen
        street.put(str(number), {**ANNOTATION, "boxes": boxes}, **sensors())
    first = street.run({}, activate=False).id
    second = street.run({"min_visible_pixels": 40_000}, activate=False).id

    def classes(context, session, _):
        runs = compared_runs(session, second, first)
        return list(run_diff(context, session, runs, 10).by_class)

    assert asked(street, 10**6, classes) == ["car", "truck"]
    assert asked(street, 1, classes) == ["car", "truck"]


@pytest.mark.parametrize("review", ["", "undecided", "none", "any"])
def test_boxes_of_a_match_range_are_counted_in_parts(street, review):
    def counted(context, session, dataset):
        box_filter = BoxFilter(dataset.id, review=review, match_min=20, distance_max=30)
        return count_boxes(context, session, dataset, box_filter)

    whole = asked(street, 10**6, counted)

    assert asked(street, MOST_BOXES, counted) == whole > 0


def test_at_most_one_part_is_read_at_a_time(street):
    def most_at_once(context, session, dataset):
        parts = context.one(ColumnCache).parts(
            session, dataset.id, dataset.active_measurement_id
        )
        return [len(numbers) for (numbers,) in parts]

    assert asked(street, MOST_BOXES, most_at_once) == [5] * FRAMES
    assert asked(street, 10**6, most_at_once) == [5 * FRAMES]
