"""A batch stores and decides the same as single uploads of its frames."""

import asyncio
import json
from contextlib import suppress

from anyio import CapacityLimiter
from hypothesis import given
from hypothesis import strategies as st

from app.boxes import frames as described
from app.boxes.queries import FrameRepository
from app.errors import FrameConflict, NotFound
from app.ingest.batch import BatchIntake
from app.ingest.frame import RefusedFrame, UploadedFrame, UploadRequest
from app.ingest.rows import NewFrame
from app.ingest.service import add_frame
from filter_core.errors import FilterError
from tests.support import frames as scene
from tests.support.threads import in_thread

DIFFERING_KEYS = {
    *("id", "box_id", "frame_id", "run", "created_at", "dataset", "url"),
    *("previous_id", "next_id"),
}

spans = st.tuples(st.integers(-10, 70), st.integers(-10, 70)).map(sorted)
rectangles = st.tuples(spans, spans).map(
    lambda sides: [sides[0][0], sides[1][0], sides[0][1], sides[1][1]]
)
boxes = st.lists(
    st.fixed_dictionaries(
        {"class": st.sampled_from(["car", "walker", "vase"]), "xyxy": rectangles},
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


def upload_one_by_one(street, frames, replace):
    for key, boxes, has_segmentation, number in frames:
        files = files_of(number, has_segmentation)
        request = UploadRequest(street.name, street.by, replace)
        upload = UploadedFrame(key, annotation_of(boxes), files)
        try:
            yield expected_status(add_frame(street.context, request, upload))
        except FrameConflict:
            yield 409
        except FilterError:
            yield 422


async def upload_as_batch(street, frames, replace):
    async def incoming():
        for key, boxes, has_segmentation, number in frames:
            files = files_of(number, has_segmentation)
            yield UploadedFrame(key, annotation_of(boxes), files, may_rename=True)

    request = UploadRequest(street.name, street.by, replace)
    intake = BatchIntake(street.context, request, CapacityLimiter(1))
    return [frame async for some in intake.ended(incoming()) for frame in some]


def expected_status(frame):
    if isinstance(frame, RefusedFrame):
        return 409 if isinstance(frame.error, FrameConflict) else 422
    return 201 if isinstance(frame, NewFrame) else 200


def without_ids(value):
    if isinstance(value, dict):
        return {k: without_ids(v) for k, v in value.items() if k not in DIFFERING_KEYS}
    return [without_ids(item) for item in value] if isinstance(value, list) else value


def described_frames(street):
    frames = {}
    with street.context.database.read() as session:
        for key in "abcd":
            with suppress(NotFound):
                stored = FrameRepository(session).current(street.id, key)
                frame = described.describe_frame(session, stored.id)
                frames[key] = without_ids(frame)
    return frames


@given(frames=uploads, replace=st.booleans())
def test_batch_gives_the_same_results_as_single_uploads(services, frames, replace):
    alone, together = services.dataset(), services.dataset()

    statuses = list(upload_one_by_one(alone, frames, replace))
    ended = in_thread(asyncio.run, upload_as_batch(together, frames, replace))

    assert [expected_status(frame) for frame in ended] == statuses
    assert described_frames(together) == described_frames(alone)
    assert together.tallies() == together.recounted()
