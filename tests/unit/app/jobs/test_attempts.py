"""Attempts at chunks are stored, so that a later process knows which ones kill it.

Here the process that drives a job also works on its chunks, without workers.
"""

import threading
from contextlib import closing, contextmanager
from dataclasses import replace

from sqlalchemy import event, exc, select

from app.db.base import utc_now
from app.db.tables import Chunk, Frame, Run
from app.engine.children import PixelPool
from app.engine.chunk import DONE, JobStopped
from app.engine.local import LocalEngine
from app.jobs.attempts import MOST_ATTEMPTS, Attempt
from app.jobs.chunks import FINAL_STEP, ChunkRepository, PlannedChunk
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.jobs.work import work_on_chunk
from tests.support import frames as scene
from tests.support.chunks import (
    FRAMES,
    FROM_PIXELS,
    check_run_is_complete,
    context_with_engine,
    measured,
    put,
    read,
    remaining_rows,
    run_of,
)
from tests.support.services import run_job

NOTHING_VISIBLE = {"min_visible_pixels": 10**6}


class ObservedEngine(LocalEngine):
    """The local engine with three frames per chunk; calls `look` before each frame."""

    def __init__(self, look) -> None:
        super().__init__(2)
        self._look = look

    def chunk_frames(self, total):
        return 3

    def start(self, work, item):
        self._look(self, item)
        return super().start(work, item)


def frame_ids(street):
    rows = select(Frame.id).where(Frame.dataset_id == street.id).order_by(Frame.id)
    return read(street, lambda session: list(session.scalars(rows)))


def attempts(street, run_id):
    rows = select(Chunk.number, Chunk.attempts).where(Chunk.job_id == run_id)
    rows = rows.where(Chunk.kind == "run", Chunk.state == "waiting")
    waiting = read(street, lambda session: session.execute(rows).all())
    return dict(waiting)


def request_run_with_attempts(street, *spans):
    """Prepare a run that has ended processes; returns its id.

    Each span is a chunk: its first and last frame, and how many processes it ended.
    """
    run_id, ids = street.request(FROM_PIXELS), frame_ids(street)
    with street.context.database.write() as session:
        run = job_with_id(session, Run, run_id)
        run.state, run.started_at, run.total = "running", utc_now(), FRAMES
        chunks, job = ChunkRepository(session), run_job(run_id)
        for first, last, ended in spans:
            planned = PlannedChunk(ids[first], ids[last], last - first + 1)
            (number,) = chunks.plan(job, [planned])
            session.get_one(Chunk, (*job, number)).attempts = ended
    return run_id


def drive_run(street, run_id, look=lambda _engine, _frame_id: None, **others):
    """Drive a run and return it; `others` replace attributes of the context."""
    with context_with_engine(street, ObservedEngine(look)) as context:
        drive_job(replace(context, **others), run_job(run_id))
    return run_of(street, run_id)


def test_attempt_is_stored_when_a_chunk_begins_and_not_before(street):
    seen = []
    run_id = street.request(FROM_PIXELS)

    run = drive_run(street, run_id, lambda *_: seen.append(attempts(street, run_id)))

    check_run_is_complete(street, run)
    assert len(seen) == FRAMES
    assert {sum(counts.values()) for counts in seen} == {1}
    assert [number for counts in seen for number in counts if counts[number]] == [
        *(1, 1, 1, 2, 2, 2),
        *(3, 3, 3, 4, 4, 4),
    ]
    # The second chunk was queued then, but not yet counted as an attempt.
    assert {1: 1, 2: 0} in seen


def test_chunk_that_killed_processes_is_measured_singly_and_its_count_reset(street):
    seen = []
    run_id = request_run_with_attempts(street, (0, FRAMES - 1, MOST_ATTEMPTS - 1))
    ids = frame_ids(street)

    def look(_engine, frame_id):
        done = sum(measured(street, run_of(street, run_id)).values())
        seen.append((ids.index(frame_id), done, *attempts(street, run_id).values()))

    run = drive_run(street, run_id, look)

    check_run_is_complete(street, run)
    # A frame begins after the one before it was stored, which resets the count.
    forgiven = [(place, place, 0) for place in range(1, FRAMES)]
    assert seen == [(0, 0, MOST_ATTEMPTS), *forgiven]


def test_frame_that_killed_processes_is_quarantined_and_no_other(street):
    run_id = request_run_with_attempts(street, (0, 5, MOST_ATTEMPTS), (6, 11, 0))

    run = drive_run(street, run_id)

    assert run.state == "failed"
    assert run.error == {
        "code": "quarantined",
        "detail": "frame '00' crashed the process that worked on it 3 times; the "
        "log of the process may show the cause",
    }
    assert (run.done, len(measured(street, run))) == (FRAMES - 1, FRAMES - 1)
    (chunk,) = remaining_rows(street, Chunk, run)
    assert (chunk.state, chunk.attempts, chunk.frames) == ("quarantined", 3, 1)
    again = street.run(FROM_PIXELS)
    check_run_is_complete(street, run_of(street, again.id))


def test_consecutive_killing_frames_are_quarantined_together(services):
    """Frames of another dataset, stored at the same time, have the ids in between."""
    street, other = services.dataset(), services.dataset()
    for number in range(FRAMES):
        put(street, number)
        put(other, number)
    run_id = request_run_with_attempts(
        street, (0, 0, MOST_ATTEMPTS), (1, 5, MOST_ATTEMPTS), (6, 11, 0)
    )

    run = drive_run(street, run_id)

    assert detail_of(run).startswith("frames '00', '01' to '05' crashed")
    assert run.done == FRAMES - 6


def detail_of(run):
    assert run.error is not None
    return run.error["detail"]


def test_measured_frame_separates_killing_frames(street):
    """The first chunk is in quarantine, but all frames after its first are measured."""
    run_id = request_run_with_attempts(
        street, (1, 2, 0), (3, 5, MOST_ATTEMPTS), (6, 11, 0)
    )
    assert work_on_chunk(street.context, "run", run_id, 1) == DONE
    with street.context.database.write() as session:
        chunk = session.get_one(Chunk, ("run", run_id, 1))
        chunk.state, chunk.first_frame_id = "quarantined", frame_ids(street)[0]

    run = drive_run(street, run_id)

    assert detail_of(run).startswith("frames '00', '03' crashed the process")


def test_unreadable_frame_does_not_separate_killing_frames(street):
    run_id = request_run_with_attempts(
        street, (0, 0, MOST_ATTEMPTS), (1, 1, 0), (2, 5, MOST_ATTEMPTS)
    )
    with street.context.database.write() as session:
        chunk = session.get_one(Chunk, ("run", run_id, 2))
        chunk.state, chunk.error = "quarantined", {"code": "so", "detail": "it is so"}

    run = drive_run(street, run_id)

    assert detail_of(run).startswith("frames '00', '02' to '05' crashed")
    assert detail_of(run).endswith("frame '01' cannot be read: it is so")


def test_unreadable_frame_is_not_counted_as_killing_its_process(services):
    """It is put into quarantine before the next frame is measured and kills it."""
    street = services.dataset()
    put_large(street, "00")
    for number in range(1, FRAMES):
        put(street, number)
    run_id = request_run_with_attempts(street, (0, FRAMES - 1, MOST_ATTEMPTS - 1))
    (large, second, *_) = frame_ids(street)

    def stop(engine, frame_id):
        if frame_id == second:
            engine.stopping.set()
            raise JobStopped(run_job(run_id))

    with closing(PixelPool(1, memory_bytes=16 * 2**20)) as pixels:
        drive_run(street, run_id, stop, pixels=pixels)
        chunks = {
            chunk.state: (chunk.first_frame_id, chunk.frames, chunk.attempts)
            for chunk in remaining_rows(street, Chunk, run_of(street, run_id))
        }
        assert chunks["quarantined"][:2] == (large, 1)
        assert chunks["waiting"] == (large + 1, FRAMES - 1, 0)
        with street.context.database.write() as session:
            chunk = session.get_one(Chunk, ("run", run_id, 1))
            chunk.attempts = MOST_ATTEMPTS
        run = drive_run(street, run_id, pixels=pixels)

    detail = detail_of(run)
    assert detail.startswith("frame '01' crashed the process that worked")
    assert "; frame '00' cannot be read: " in detail
    assert run.done == FRAMES - 2


def test_unreadable_last_frame_is_quarantined_when_measured_singly(services):
    street = services.dataset()
    for number in range(FRAMES - 1):
        put(street, number)
    put_large(street, "last")
    run_id = request_run_with_attempts(street, (0, FRAMES - 1, MOST_ATTEMPTS - 1))

    with closing(PixelPool(1, memory_bytes=16 * 2**20)) as pixels:
        run = drive_run(street, run_id, pixels=pixels)

    assert detail_of(run).startswith("frame 'last' cannot be read: ")
    assert (run.state, run.done) == ("failed", FRAMES - 1)


def put_large(street, key):
    """Store a frame whose decoded segmentation needs much memory."""
    annotation, segmentation = scene.large(3000)
    street.put(key, annotation, segmentation=segmentation)


def test_deleted_quarantined_frame_does_not_fail_the_run(street):
    run_id = request_run_with_attempts(street, (0, 5, MOST_ATTEMPTS), (6, 11, 0))
    deleted: list[str] = []

    def look(_engine, _frame_id):
        if not deleted:
            deleted.append("00")
            street.delete("00")

    run = drive_run(street, run_id, look)

    assert (run.state, run.error) == ("done", None)
    assert len(measured(street, run)) == FRAMES - 1


def test_attempt_interrupted_by_shutdown_is_not_counted(street):
    run_id = request_run_with_attempts(street, (0, FRAMES - 1, 1))
    seen = []

    def stop(engine, _frame_id):
        seen.append(attempts(street, run_id))
        engine.stopping.set()

    run = drive_run(street, run_id, stop)

    assert run.state == "running"
    assert (seen[0], attempts(street, run_id)) == ({1: 2}, {1: 0})
    check_run_is_complete(street, drive_run(street, run_id))


class ObservedDecisionEngine(LocalEngine):
    """The local engine; calls `look` when a decision reports its progress."""

    def __init__(self, look) -> None:
        super().__init__(2)
        self._look = look

    def report(self, job, done):
        super().report(job, done)
        self._look(self)


def request_run_with_decision_attempts(street, ended):
    """Prepare a run whose decision has ended so many processes; returns its id."""
    run_id = street.request(NOTHING_VISIBLE)
    with street.context.database.write() as session:
        chunks, job = ChunkRepository(session), run_job(run_id)
        chunks.plan_final_step(job, FRAMES)
        session.get_one(Chunk, (*job, FINAL_STEP)).attempts = ended
    return run_id


def drive_decision(street, run_id, look=lambda _engine: None):
    with context_with_engine(street, ObservedDecisionEngine(look)) as context:
        drive_job(context, run_job(run_id))
    return run_of(street, run_id)


def test_decision_attempt_is_stored_before_it_begins(street):
    seen, run_id = [], request_run_with_decision_attempts(street, MOST_ATTEMPTS - 1)

    run = drive_decision(
        street, run_id, lambda _: seen.append(attempts(street, run_id))
    )

    assert (run.state, run.changed > 0) == ("done", True)
    assert seen
    assert {counts[FINAL_STEP] for counts in seen} == {MOST_ATTEMPTS}
    assert remaining_rows(street, Chunk, run) == []


def test_decision_that_killed_processes_fails_as_quarantined(street):
    before = street.reasons()
    run_id = request_run_with_decision_attempts(street, MOST_ATTEMPTS)

    run = drive_decision(street, run_id)

    assert run.state == "failed"
    assert run.error == {
        "code": "quarantined",
        "detail": "deciding its boxes crashed the process that worked on it 3 times; "
        "the log of the process may show the cause",
    }
    assert street.reasons() == before
    # It stays on record, also if a cancellation comes too late.
    with street.context.database.write() as session:
        ChunkRepository(session).withdraw_final_step(run_job(run_id))
    chunks = remaining_rows(street, Chunk, run)
    assert [chunk.state for chunk in chunks] == ["quarantined"]
    assert street.run(NOTHING_VISIBLE).state == "done"


def test_decision_interrupted_by_shutdown_is_not_counted_as_an_attempt(street):
    run_id = request_run_with_decision_attempts(street, 1)

    run = drive_decision(street, run_id, lambda engine: engine.stopping.set())

    assert run.state == "running"
    assert attempts(street, run_id) == {FINAL_STEP: 0}
    assert drive_decision(street, run_id).state == "done"


def test_end_of_an_attempt_is_retried_if_the_database_is_unavailable(street):
    run_id = request_run_with_attempts(street, (0, FRAMES - 1, 0))
    attempt = Attempt(street.context, run_job(run_id), 1)

    begun = attempt.begin()
    noted = attempts(street, run_id)
    with fail_next_transaction(street):
        attempt.end()

    assert (begun, noted, attempts(street, run_id)) == (True, {1: 1}, {1: 0})


@contextmanager
def fail_next_transaction(street):
    """Let the next transaction of this thread fail for lack of a connection."""
    thread, failed = threading.get_ident(), list[bool]()

    def fail(_connection):
        if threading.get_ident() == thread and not failed:
            failed.append(True)
            raise exc.TimeoutError("no connection is free")

    event.listen(street.context.database.engine, "begin", fail)
    try:
        yield
    finally:
        event.remove(street.context.database.engine, "begin", fail)
    assert failed
