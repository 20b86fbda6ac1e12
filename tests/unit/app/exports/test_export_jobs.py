"""Exports that are repeated, interrupted, cancelled, or whose dataset is deleted."""

import logging
import threading

import pytest

from app.datasets.service import remove_dataset
from app.db.tables import Export
from app.engine.chunk import Job
from app.exports.service import EXPORTS, request_export
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.jobs.service import cancel, start
from unghost.wire.runs import ExportIn


@pytest.fixture
def street(make_street):
    return make_street()


def request_unstarted_export(street):
    """Request an export that is not started by the service; returns its job."""
    request = ExportIn(format="yolo")
    with street.context.database.write() as session:
        dataset = street.row(session)
        export = request_export(street.idle_context, session, dataset, request, "ada")
        return Job("export", export.id)


def export_of(street, job):
    with street.context.database.read() as session:
        return job_with_id(session, Export, job.id)


def temporary_files(street):
    return list(street.context.storage.temporary_folder().iterdir())


def test_interrupted_export_leaves_no_files_and_can_be_resumed(street):
    job, engine = request_unstarted_export(street), street.context.engine
    engine.interrupt(job)

    drive_job(street.context, job)
    interrupted = export_of(street, job)
    left = temporary_files(street)
    engine.clear_cancel(job)
    drive_job(street.context, job)

    assert (interrupted.state, interrupted.done, left) == ("running", 0, [])
    finished = export_of(street, job)
    assert (finished.state, finished.done, finished.total) == ("done", 3, 3)


def test_export_cancelled_while_it_is_written_stays_cancelled(street):
    job = request_unstarted_export(street)
    with street.context.database.write() as session:
        job_with_id(session, Export, job.id).state = "running"
        session.flush()
        start(street.context, [job])
        cancel(street.context, session, EXPORTS, job.id)
    # Until all jobs that were queued before are over.
    street.run({}, activate=False)
    over = threading.Event()
    street.context.engine.submit(over.set)
    assert over.wait(60)

    export = export_of(street, job)
    assert (export.state, export.sha256) == ("cancelled", None)
    assert export.finished_at is not None
    assert temporary_files(street) == []
    assert street.context.engine.interrupted() == set()


def test_export_interrupted_by_a_crash_is_rewritten(street):
    job = request_unstarted_export(street)
    half = street.context.storage.temporary_folder() / f"export-{job.id}"
    half.mkdir()
    (half / "export.zip").write_bytes(b"PK half of it")
    with street.context.database.write() as session:
        job_with_id(session, Export, job.id).state = "running"

    drive_job(street.context, job)

    export = export_of(street, job)
    content = street.context.storage.read(export.sha256)
    assert (export.state, content[:2]) == ("done", b"PK")
    assert len(content) == export.size_bytes
    assert temporary_files(street) == []


def test_export_of_a_deleted_dataset_logs_no_error(street, caplog):
    job = request_unstarted_export(street)
    with street.context.database.write() as session:
        remove_dataset(street.context, session, street.name, street.name)

    with caplog.at_level(logging.ERROR):
        drive_job(street.context, job)

    assert caplog.records == []


def test_export_with_invalid_options_fails_once_with_an_error(street):
    job = request_unstarted_export(street)
    with street.context.database.write() as session:
        job_with_id(session, Export, job.id).options = {"split": 7}

    drive_job(street.context, job)
    failed = export_of(street, job)
    drive_job(street.context, job)

    export = export_of(street, job)
    assert export.state == "failed"
    assert export.error is not None
    assert "split" in export.error["detail"]
    assert export.finished_at == failed.finished_at
