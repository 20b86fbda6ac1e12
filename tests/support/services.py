"""Calls the service's functions over a real database, without HTTP in between."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from itertools import count
from pathlib import Path
from typing import Any, Final

from sqlalchemy import func, select, update

from app.access.audit import AuditTrail
from app.boxes import frames
from app.boxes.current import TallyRepository
from app.boxes.filter import TallyKey
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.datasets import service as datasets
from app.db.tables import Dataset, Decision, Review, Run
from app.engine.chunk import Job
from app.engine.local import LocalEngine
from app.ingest.frame import AcceptedFrame, UploadedFrame, UploadRequest
from app.ingest.service import add_frame
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.jobs.service import cancel
from app.measuring.active import active_config, active_version, config_of
from app.measuring.plan import DatasetReading
from app.process.lifespan import running
from app.review.bulk import review_many, undo_batch
from app.review.history import history
from app.review.service import review_box
from app.runs.flips import preview
from app.runs.service import RUNS, RunRequest, request_run
from app.security import Principal
from app.settings import Settings
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin
from tests.support import frames as scene
from tests.support.databases import give_tables, settings_of
from tests.support.statements import interrupted_at
from tests.support.waiting import until
from unghost.wire.boxes import BulkIn, ReviewIn
from unghost.wire.runs import PreviewIn

FLIPS = "INSERT INTO flips "
"""The beginning of a statement of the transaction that ends a run."""

_numbers = count(1)


@contextmanager
def running_services(folder: Path, **chosen: Any) -> Iterator[Services]:
    """Yield the services of a data folder, with database, storage, engine and pools."""
    give_tables(folder, chosen)
    chosen = {**settings_of(folder), **chosen}
    with running(Settings(data=folder, workers=2, **chosen)) as context:
        yield Services(context)


def filled_folder(data: Path, **chosen: Any) -> Path:
    """Make a data folder with two frames, each with an image and a segmentation."""
    with running_services(data, **chosen) as services:
        street = services.dataset()
        for number in range(2):
            street.put(
                f"f/{number}",
                scene.annotation(),
                image=scene.image(number),
                segmentation=scene.segmentation(number),
            )
    return data


class IdleEngine(LocalEngine):
    """An engine that never begins a job."""

    def submit(
        self, work: Callable[[], None], job: Job | None = None, *, is_long: bool = False
    ) -> None:
        """Do nothing: a test carries the job out, or nobody."""


def run_job(run_id: int) -> Job:
    """The job of a run."""
    return Job("run", run_id)


ANSWERED_AT: Final = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
"""The time of answers whose exports are to have the same bytes everywhere."""


@dataclass(frozen=True)
class Services:
    """The context of a service, and an author for what tests do with it."""

    context: ServiceContext
    author: str = "ada"

    def dataset(
        self, name: str = "", config: FilterConfig | None = None, **reading: Any
    ) -> ServiceDataset:
        """Create a dataset; without a name it gets an unused one.

        By default it is decided by tags, as in the paper.
        """
        name = name or f"road-{next(_numbers)}"  # `Api.dataset` makes streets
        new = datasets.NewDataset(
            DatasetReading(name, **reading),
            "",
            None,
            config or FilterConfig(profile="paper"),
            self.author,
        )
        with self.context.database.write() as session:
            dataset = datasets.create_dataset(session, new)
            return ServiceDataset(self, name, dataset.id)


@dataclass(frozen=True)
class ServiceDataset:
    """One dataset of a service: each method does one thing that a user can do."""

    services: Services
    name: str
    id: int
    config: Mapping[str, Any] = field(default_factory=dict)

    @property
    def context(self) -> ServiceContext:
        return self.services.context

    @property
    def idle_context(self) -> ServiceContext:
        """The context with an engine that leaves jobs for the test to carry out."""
        return replace(self.context, engine=IdleEngine(1))

    @property
    def by(self) -> Principal:
        return Principal(1, self.services.author, "reviewer")

    def put(
        self, key: str, annotation: Mapping[str, Any], **files: bytes
    ) -> AcceptedFrame:
        content = json.dumps(annotation).encode()
        request = UploadRequest(self.name, self.by, replace=True)
        return add_frame(self.context, request, UploadedFrame(key, content, files))

    def delete(self, key: str) -> None:
        with self.context.database.write() as session:
            audit = AuditTrail(session, self.by)
            frames.remove_frame(audit, self.by, self.row(session), key)

    def review(self, box_id: int, verdict: str, *, at: datetime | None = None) -> None:
        """Answer a box; `at` is the time of the answer, if it is not now."""
        seen = self.revisions([box_id]).get(box_id, 0)
        answer = ReviewIn.model_validate({"verdict": verdict, "seen_revision": seen})
        with self.context.database.write() as session:
            audit = AuditTrail(session, self.by)
            review_box(audit, box_id, answer, self.by, most=1_000)
            if at is not None:
                change = update(Review).where(Review.box_id == box_id)
                session.execute(change.values(created_at=at))

    def bulk(self, box_ids: Sequence[int], verdict: str) -> int:
        """Give one answer on several boxes as they are now; the batch's id."""
        seen = self.revisions(box_ids)
        answer = BulkIn.model_validate(
            {
                "dataset": self.name,
                "verdict": verdict,
                "box_ids": list(seen),
                "seen_revisions": list(seen.values()),
            }
        )
        with self.context.database.write() as session:
            audit = AuditTrail(session, self.by)
            return review_many(self.context, audit, answer, self.by).id

    def revisions(self, box_ids: Sequence[int]) -> dict[int, int]:
        """The revision of each of these boxes that has a current decision."""
        rows = select(Decision.box_id, Decision.revision)
        with self.context.database.read() as session:
            revisions = session.execute(rows.where(Decision.box_id.in_(box_ids)))
            return {row[0]: row[1] for row in revisions}

    def undo(self, batch_id: int) -> None:
        with self.context.database.write() as session:
            audit = AuditTrail(session, self.by)
            undo_batch(self.context, audit, batch_id, self.by)

    def request(
        self,
        config: Mapping[str, Any],
        *,
        activate: bool = True,
        measure_again: bool = False,
        **reading: Any,
    ) -> int:
        """Queue a run that is not carried out yet; its id."""
        with self.context.database.write() as session:
            dataset = self.row(session)
            request = RunRequest(
                load_config(config).after(active_config(session, dataset)),
                self.services.author,
                activate,
                DatasetReading(self.name, **reading) if reading else None,
                measure_again=measure_again,
            )
            return request_run(self.idle_context, session, dataset, request).id

    def run(
        self, config: Mapping[str, Any], *, activate: bool = True, **more: Any
    ) -> Run:
        """Request a run and carry it out to its end."""
        run_id = self.request(config, activate=activate, **more)
        drive_job(self.context, run_job(run_id))
        with self.context.database.read() as session:
            return job_with_id(session, Run, run_id)

    def change(self, **reading: Any) -> int:
        """Change how segmentations are read; the id of the run that applies it."""
        with self.context.database.write() as session:
            run = datasets.change_dataset(
                self.idle_context,
                session,
                self.row(session),
                reading,
                self.services.author,
            )
            assert run is not None
            return run.id

    def wait(self, run_id: int) -> Run:
        """Wait until the engine has done all jobs submitted so far; returns the run."""
        over = threading.Event()
        self.context.engine.submit(over.set)
        assert over.wait(60)
        with self.context.database.read() as session:
            return job_with_id(session, Run, run_id)

    def cancelled_while_it_ends(self, run_id: int) -> str:
        """Carry out a run, and cancel it during its last transaction.

        Returns the state that the one who cancels gets. In a database with a single
        writer, cancelling has to wait for that transaction.
        """
        job, engine = run_job(run_id), self.context.engine
        states = []

        def told() -> str:
            with self.context.database.write() as session:
                return cancel(self.context, session, RUNS, run_id).state

        def interrupt() -> None:
            states.append(pool.submit(told))
            until(lambda: job in engine.interrupted())

        with (
            ThreadPoolExecutor(1) as pool,
            interrupted_at(self.context.database.engine, FLIPS, interrupt),
        ):
            drive_job(self.context, job)
        return str(states[0].result(10))

    def history(self, box_id: int) -> list[dict[str, Any]]:
        with self.context.database.read() as session:
            entries, _ = history(session, box_id, limit=1_000)
            return [entry.model_dump(exclude_unset=True) for entry in entries]

    def active_config(self) -> dict[str, Any]:
        with self.context.database.read() as session:
            return config_of(active_version(session, self.row(session))).as_dict()

    def preview(self, config: Mapping[str, Any]) -> dict[str, Any]:
        with self.context.database.read() as session:
            request = PreviewIn.model_validate(
                {"config": config, "limit": 1000, "bins": 10}
            )
            counts = preview(self.context, session, self.row(session), request)
        return counts.model_dump()

    def row(self, session) -> Dataset:
        return DatasetRepository(session).named(self.name)

    def box_ids(self) -> list[int]:
        with self.context.database.read() as session:
            rows = select(Decision.box_id).where(Decision.dataset_id == self.id)
            return list(session.scalars(rows.order_by(Decision.box_id)))

    def reasons(self) -> dict[int, int]:
        """The current reason of each box."""
        with self.context.database.read() as session:
            rows = select(Decision.box_id, Decision.reason)
            rows = rows.where(Decision.dataset_id == self.id).order_by(Decision.box_id)
            return {row[0]: row[1] for row in session.execute(rows)}

    def tallies(self) -> dict[TallyKey, int]:
        with self.context.database.read() as session:
            return TallyRepository(session).of_dataset(self.id)

    def recounted(self) -> Counter[TallyKey]:
        """The tallies counted anew from all decisions, to compare with the stored."""
        review = func.coalesce(Decision.review, "")
        columns = (Decision.class_id, Decision.reason, Decision.toss_up, Decision.doubt)
        rows = select(*columns, review)
        with self.context.database.read() as session:
            tallies = session.execute(rows.where(Decision.dataset_id == self.id))
            return Counter(
                TallyKey(row[0], row[1], row[2], min(row[3], Bin.ASK), row[4])
                for row in tallies
            )
