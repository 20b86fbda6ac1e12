"""A batch stores what uploads one by one would have stored, and decides alike."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress

from anyio import CapacityLimiter
from hypothesis import given, settings
from hypothesis import strategies as st

from app.boxes import frames as described
from app.errors import FrameConflict, NotFound
from app.ingest.batch import BatchIntake
from app.ingest.service import BatchOf, UploadedFrame, prepare_frame, store_frame
from app.ingest.tar import IncomingFrame
from filter_core.errors import FilterError
from tests.api import frames as scene

OWN = {
    *("id", "box_id", "frame_id", "run", "created_at", "dataset", "url"),
    *("previous_id", "next_id"),
}

boxes = st.lists(
    st.fixed_dictionaries(
        {
            "class": st.sampled_from(["car", "walker", "vase"]),
            "xyxy": st.lists(st.integers(-10, 70), min_size=4, max_size=4),
        },
        optional={"distance": st.sampled_from([5.0, 80.0, "far"])},
    ),
    max_size=4,
)
uploads = st.lists(
    st.tuples(st.sampled_from("abcd"), boxes, st.booleans(), st.integers(0, 2)),
    min_size=1,
    max_size=7,
)


def files_of(number, has_segmentation):
    files = {"image": scene.image(number)}
    return files | ({"segmentation": scene.segmentation()} if has_segmentation else {})


def annotation_of(boxes):
    return json.dumps({**scene.annotation(), "boxes": boxes}).encode()


def one_by_one(street, frames, replace):
    for key, boxes, has_segmentation, number in frames:
        files = files_of(number, has_segmentation)
        upload = UploadedFrame(key, annotation_of(boxes), files, street.by, replace)
        try:
            ready = prepare_frame(street.context, street.name, upload)
            stored = store_frame(street.context, street.name, ready)
            yield 201 if stored.created else 200
        except FrameConflict:
            yield 409
        except FilterError:
            yield 422


async def at_once(street, frames, replace):
    async def incoming():
        for key, boxes, has_segmentation, number in frames:
            files = files_of(number, has_segmentation)
            yield IncomingFrame(key, annotation_of(boxes), files)

    batch = BatchOf(street.name, street.by, replace)
    intake = BatchIntake(street.context, batch, CapacityLimiter(1))
    return [line async for lines in intake.lines(incoming()) for line in lines]


def status(line):
    if isinstance(line.error, FrameConflict):
        return 409
    if line.error is not None:
        return 422
    return 201 if line.created else 200


def without_ids(value):
    if isinstance(value, dict):
        return {k: without_ids(v) for k, v in value.items() if k not in OWN}
    return [without_ids(one) for one in value] if isinstance(value, list) else value


def stored(street):
    found = {}
    with street.context.database.read() as session:
        for key in "abcd":
            with suppress(NotFound):
                frame_id = described.frame_id_of(session, street.name, key)
                frame = described.describe_frame(session, frame_id)
                found[key] = without_ids(frame)
    return found


@settings(max_examples=25)
@given(frames=uploads, replace=st.booleans())
def test_a_batch_is_like_its_frames_one_by_one(services, frames, replace):
    alone, together = services.dataset(), services.dataset()

    statuses = list(one_by_one(alone, frames, replace))
    lines = asyncio.run(at_once(together, frames, replace))

    assert [status(line) for line in lines] == statuses
    assert stored(together) == stored(alone)
    assert together.tallies() == together.recounted()
