"""Runs on more boxes than fit into memory have the same results, range by range."""

from dataclasses import replace

import pytest
from sqlalchemy import select

from app.catalog.frames import frame_ranges
from app.db.tables import Frame, Run
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.measuring.columns import ColumnCache
from tests.support import frames as scene
from tests.support.services import run_job

FRAMES = 7
CONFIGS = [
    pytest.param({"min_visible_pixels": 10**6}, id="decided again"),
    pytest.param({"classes": {"car": {"accept": ["Sky"]}}}, id="counted again"),
    pytest.param({"profile": "carlasimu", "min_visible_pixels": 10**6}, id="measured"),
]


def filled_dataset(services):
    """A dataset: frames with two boxes, one without, one replaced, and some answers."""
    street = services.dataset()
    for number in range(FRAMES):
        put(street, str(number), scene.annotation())
    put(street, "empty", {"boxes": []})
    put(street, "3", {**scene.annotation(), "again": True})
    boxes = street.box_ids()
    street.review(boxes[0], "reject")
    street.review(boxes[5], "unsure")
    street.review(boxes[-1], "keep")
    return street


def put(street, key, annotation):
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    street.put(key, annotation, **files)


def run_results(street, config, most_boxes, *, activate=True):
    """Drive a run; returns its results without ids, to compare datasets."""
    run_id = street.request(config, activate=activate)
    context = replace(street.context, owned={ColumnCache: ColumnCache(most_boxes)})
    drive_job(context, run_job(run_id))
    with street.context.database.read() as session:
        run = job_with_id(session, Run, run_id)
    ids = street.box_ids()
    flips = [len(street.history(box_id)) for box_id in ids]
    tallies = sorted((*key[1:], boxes) for key, boxes in street.tallies().items())
    assert run.state == "done", run.error
    assert street.tallies() == street.recounted()
    return run.changed, run.counts, list(street.reasons().values()), flips, tallies


@pytest.mark.parametrize("config", CONFIGS)
def test_run_in_ranges_equals_a_run_in_memory(services, config):
    in_memory = run_results(filled_dataset(services), config, 10**6)
    in_ranges = {
        most_boxes: run_results(filled_dataset(services), config, most_boxes)
        for most_boxes in (0, 13)
    }

    assert in_ranges == dict.fromkeys(in_ranges, in_memory)
    assert in_memory[0] > 0


def test_inactive_run_in_ranges_does_not_change_current_decisions(services):
    street = filled_dataset(services)
    before = street.reasons(), street.tallies()

    changed, *_ = run_results(street, {"min_visible_pixels": 10**6}, 3, activate=False)

    assert changed == FRAMES
    assert (street.reasons(), street.tallies()) == before


@pytest.mark.parametrize(("boxes", "ranges"), [(1, 7), (4, 4), (10**6, 1)])
def test_frame_ranges_cover_all_frames_without_overlap(services, boxes, ranges):
    street = filled_dataset(services)
    with street.context.database.read() as session:
        pairs = list(frame_ranges(session, street.id, boxes=boxes))
        of_dataset = select(Frame.id).where(Frame.dataset_id == street.id)
        frames = session.scalars(of_dataset.where(Frame.superseded_at.is_(None))).all()

    ends = [end for pair in pairs for end in pair]
    assert ends == sorted(ends)
    assert len(pairs) == ranges
    assert all(any(a <= frame <= b for a, b in pairs) for frame in frames)
