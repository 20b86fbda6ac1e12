"""What all kinds of jobs have in common: how they start, fail and end."""

import time

import pytest

from app.db.tables import Chunk, Export, Run
from app.engine.chunk import Job, JobStopped
from app.errors import Conflict
from app.exports.service import EXPORTS, ExportJobs, request_export
from app.jobs.chunks import ChunkRepository, PlannedChunk
from app.jobs.driver import drive_job
from app.jobs.kind import register
from app.jobs.leases import UNDRIVEN_FOR_S
from app.jobs.queries import close
from app.jobs.service import start
from app.runs.service import RUNS, RunJobs
from filter_core.errors import ConfigError
from tests.support.leases import HOLDER_ELSEWHERE, ended_process, give_lease
from tests.support.services import run_job
from tests.support.waiting import until
from unghost.wire.runs import ExportIn


@pytest.fixture
def street(services):
    return services.dataset()


@pytest.fixture
def register_jobs():
    """Lets a test replace the kinds of jobs; afterwards the service's are restored."""
    yield register
    register(RUNS, EXPORTS)


def queued(street, kind):
    """Request a job that is not started by the service; returns it."""
    if kind == "run":
        return run_job(street.request({}))
    request = ExportIn(format="yolo")
    with street.context.database.write() as session:
        row = request_export(
            street.idle_context, session, street.row(session), request, "ada"
        )
    return Job("export", row.id)


def row_of(street, job):
    table = {"run": Run, "export": Export}[job.kind]
    with street.context.database.read() as session:
        return session.get_one(table, job.id)


def state_of(street, job):
    return row_of(street, job).state


def is_undriven_since(begun):
    """Whether a job without a lease may be started, since nobody has begun it."""
    return time.monotonic() - begun >= UNDRIVEN_FOR_S


@pytest.mark.parametrize("kind", ["run", "export"])
def test_abandoned_job_is_started_and_no_other_of_its_kind(services, kind):
    streets, died = (services.dataset(), services.dataset()), ended_process()
    begun = time.monotonic()
    abandoned, other = (queued(street, kind) for street in streets)
    with services.context.database.write() as session:
        give_lease(session, abandoned, died)

    until(lambda: state_of(streets[0], abandoned) == "done")

    streets[0].wait(abandoned.id) if kind == "run" else None
    assert state_of(streets[1], other) == "queued" or is_undriven_since(begun)


@pytest.mark.parametrize("kind", ["run", "export"])
def test_end_of_a_job_starts_the_waiting_run_of_its_dataset(services, street, kind):
    begun = time.monotonic()
    job, waiting = queued(street, kind), queued(street, "run")
    elsewhere = queued(services.dataset(), "run")

    start(services.context, [job])

    until(lambda: state_of(street, waiting) == "done")
    assert state_of(street, job) == "done"
    assert state_of(street, elsewhere) == "queued" or is_undriven_since(begun)


class _FailsAtBegin:
    """A part of a kind of job: to begin such a job raises this error."""

    def __init__(self, error):
        self._error = error

    def begin(self, session, row):
        raise self._error


class FailingRun(_FailsAtBegin, RunJobs):
    pass


class FailingExport(_FailsAtBegin, ExportJobs):
    pass


@pytest.mark.parametrize(
    "error",
    [Conflict("it is so", code="so"), ConfigError("it is so", code="so")],
    ids=["of the service", "of the library"],
)
@pytest.mark.parametrize("kind", [FailingRun, FailingExport])
def test_job_fails_with_the_code_and_detail_of_its_error(
    street, register_jobs, kind, error
):
    register_jobs(kind(error))
    job = queued(street, kind.table.job_kind)

    assert drive_job(street.context, job)

    row = row_of(street, job)
    assert (row.state, row.error["detail"]) == ("failed", "it is so")
    assert row.error["code"] == error.kind
    assert row.finished_at is not None


def test_job_with_an_internal_error_starts_the_waiting_run_of_its_dataset(
    services, street, register_jobs
):
    register_jobs(FailingExport(RuntimeError("a fault of the program")))
    job, waiting = queued(street, "export"), queued(street, "run")

    start(services.context, [job])

    street.wait(waiting.id)  # by now the export has ended
    assert row_of(street, job).error["code"] == "internal"
    assert street.wait(waiting.id).state == "done"


def test_failure_of_a_driver_that_lost_its_lease_does_not_end_the_job(
    street, register_jobs
):
    class LosesItsLease(ExportJobs):
        def work(self, task):
            with street.context.database.write() as session:
                give_lease(session, task.job, HOLDER_ELSEWHERE)
            raise Conflict("it is so", code="so")

    register_jobs(LosesItsLease())
    job = queued(street, "export")

    assert not drive_job(street.context, job)
    assert state_of(street, job) == "running"


@pytest.mark.parametrize("kind", ["run", "export"])
@pytest.mark.parametrize(
    ("end", "left"), [("done", []), ("cancelled", []), ("failed", ["quarantined"])]
)
def test_job_is_closed_once_together_with_its_chunks(street, kind, end, left):
    job = queued(street, kind)
    with street.context.database.write() as session:
        chunks = ChunkRepository(session)
        first, _ = chunks.plan(job, [PlannedChunk(1, 1, 1), PlannedChunk(2, 2, 1)])
        session.get_one(Chunk, (*job, first)).state = "quarantined"
        session.flush()
        table = {"run": Run, "export": Export}[kind]
        row = session.get_one(table, job.id)
        close(session, row, end, {"code": "so"} if end == "failed" else None)
        rows = session.query(Chunk).filter_by(kind=job.kind, job_id=job.id)
        assert [chunk.state for chunk in rows] == left

        with pytest.raises(JobStopped):
            close(session, row, "done")

    row = row_of(street, job)
    assert (row.state, row.finished_at is not None) == (end, True)
