"""Config versions, runs, exports and problems: what happened to a dataset."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Final

from sqlalchemy import bindparam, delete, func, insert, select, update
from sqlalchemy.orm import Session

from app.db.bulk import NewestPage, newest, run
from app.db.engine import once_committed
from app.db.flip_record import BOXES_PER_ROW, find_flip, pack_flips
from app.db.tables import ConfigVersion, Dataset, Export, Flips, Problem, Run
from app.errors import NotFound
from app.metrics import REFUSED
from app.repositories.datasets import is_deleted, is_there
from filter_core.types import IntArray

_FORGET_PROBLEMS: Final = delete(Problem).where(
    Problem.dataset_id == bindparam("dataset"), Problem.key == bindparam("frame")
)


class ConfigRepository:
    """Rows of `config_versions`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def find(self, dataset_id: int, digest: str) -> ConfigVersion | None:
        """A dataset's version with this digest."""
        return self._session.scalar(
            select(ConfigVersion).where(
                ConfigVersion.dataset_id == dataset_id, ConfigVersion.digest == digest
            )
        )

    def with_id(self, config_id: int) -> ConfigVersion:
        """A version that another row refers to."""
        found = self._session.get(ConfigVersion, config_id)
        if found is None:
            raise NotFound("config", config_id)
        return found

    def with_digest(self, digest: str) -> ConfigVersion:
        """Any dataset's version with this digest; they are equal."""
        rows = (
            select(ConfigVersion)
            .join(Dataset, Dataset.id == ConfigVersion.dataset_id)
            .where(ConfigVersion.digest == digest, is_there())
        )
        found = self._session.scalar(rows.order_by(ConfigVersion.id).limit(1))
        if found is None:
            raise NotFound("config", digest)
        return found

    def add(self, version: ConfigVersion) -> ConfigVersion:
        """Insert."""
        self._session.add(version)
        self._session.flush()
        return version

    def page(self, dataset_id: int, page: NewestPage) -> list[ConfigVersion]:
        """Versions, newest first."""
        return newest(self._session, ConfigVersion, dataset_id, page)

    def digests(self, config_ids: Iterable[int]) -> dict[int, str]:
        """Digests by id."""
        rows = select(ConfigVersion.id, ConfigVersion.digest).where(
            ConfigVersion.id.in_(set(config_ids))
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}


class RunRepository:
    """Rows of `runs`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, run: Run) -> Run:
        """Insert."""
        self._session.add(run)
        self._session.flush()
        return run

    def find(self, run_id: int) -> Run | None:
        """A run, unless it was deleted with its dataset."""
        found = self._session.get(Run, run_id)
        if found is None or is_deleted(self._session, found.dataset_id):
            return None
        return found

    def with_id(self, run_id: int) -> Run:
        """A run; NotFound."""
        found = self.find(run_id)
        if found is None:
            raise NotFound("run", run_id)
        return found

    def page(self, dataset_id: int, page: NewestPage) -> list[Run]:
        """Runs, newest first."""
        return newest(self._session, Run, dataset_id, page)

    def tell(self, run_id: int, done: int) -> None:
        """Say how far a run is, beside the transaction that ends it."""
        self._session.execute(
            update(Run)
            .where(Run.id == run_id, Run.state == "running", Run.done < done)
            .values(done=done)
        )

    def unfinished(self) -> list[Run]:
        """Runs that are queued, or were interrupted, oldest first."""
        rows = select(Run).where(Run.state.in_(("queued", "running")))
        return list(self._session.scalars(rows.order_by(Run.id)))

    def last_to_activate(self, dataset_id: int) -> Run | None:
        """The open run after which no other one will change what is active."""
        rows = select(Run).where(
            Run.dataset_id == dataset_id,
            Run.state.in_(("queued", "running")),
            Run.activate.is_(True),
        )
        return self._session.scalar(rows.order_by(Run.id.desc()).limit(1))

    def has_to_wait(self, run: Run) -> bool:
        """Whether an earlier run of the dataset is to become active before this one.

        Each was asked for as a change of what those before it will have made active.
        """
        if not run.activate:
            return False
        rows = select(Run.id).where(
            Run.dataset_id == run.dataset_id,
            Run.state.in_(("queued", "running")),
            Run.activate.is_(True),
            Run.id < run.id,
        )
        return self._session.scalar(rows.limit(1)) is not None

    def open_count(self, author: str | None = None) -> int:
        """How many runs wait or work: all, or those of one token."""
        rows = (
            select(func.count())
            .select_from(Run)
            .where(Run.state.in_(("queued", "running")))
        )
        if author is not None:
            rows = rows.where(Run.created_by == author)
        return self._session.scalar(rows) or 0

    def that_flipped(self, dataset_id: int, box_id: int) -> list[Run]:
        """Runs that changed a box, oldest first."""
        rows = (
            select(Run, Flips.boxes)
            .join(Flips, Flips.run_id == Run.id)
            .where(
                Run.dataset_id == dataset_id,
                Flips.first_box_id <= box_id,
                Flips.last_box_id >= box_id,
            )
            .order_by(Run.id)
        )
        return [
            row[0]
            for row in self._session.execute(rows)
            if find_flip(row[1], box_id) is not None
        ]

    def record_flips(
        self, run_id: int, box_ids: IntArray, before: IntArray, after: IntArray
    ) -> None:
        """Store for ever what a run changed; ids are in order."""
        portions = [
            slice(start, start + BOXES_PER_ROW)
            for start in range(0, len(box_ids), BOXES_PER_ROW)
        ]
        rows = [
            {
                "run_id": run_id,
                "first_box_id": int(box_ids[part][0]),
                "last_box_id": int(box_ids[part][-1]),
                "boxes": pack_flips(box_ids[part], before[part], after[part]),
            }
            for part in portions
        ]
        if rows:
            self._session.execute(insert(Flips), rows)


class ExportRepository:
    """Rows of `exports`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, export: Export) -> Export:
        """Insert."""
        self._session.add(export)
        self._session.flush()
        return export

    def find(self, export_id: int) -> Export | None:
        """An export, unless it was deleted with its dataset."""
        found = self._session.get(Export, export_id)
        if found is None or is_deleted(self._session, found.dataset_id):
            return None
        return found

    def with_id(self, export_id: int) -> Export:
        """An export; NotFound."""
        found = self.find(export_id)
        if found is None:
            raise NotFound("export", export_id)
        return found

    def page(self, dataset_id: int, page: NewestPage) -> list[Export]:
        """Exports, newest first."""
        return newest(self._session, Export, dataset_id, page)

    def unfinished(self) -> list[Export]:
        """Exports that are queued, or were interrupted, oldest first."""
        rows = select(Export).where(Export.state.in_(("queued", "running")))
        return list(self._session.scalars(rows.order_by(Export.id)))

    def open_count(self, author: str | None = None) -> int:
        """How many exports wait or work: all, or those of one token."""
        rows = (
            select(func.count())
            .select_from(Export)
            .where(Export.state.in_(("queued", "running")))
        )
        if author is not None:
            rows = rows.where(Export.created_by == author)
        return self._session.scalar(rows) or 0


class ProblemRepository:
    """Rows of `problems`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def forget(self, dataset_id: int, key: str) -> None:
        """The frame came in after all."""
        run(self._session, _FORGET_PROBLEMS, dataset=dataset_id, frame=key)

    def add(self, problem: Problem) -> None:
        """Insert."""
        self._session.add(problem)
        self._session.flush()
        once_committed(self._session, partial(REFUSED.add, 1))

    def page(self, dataset_id: int, page: NewestPage) -> list[Problem]:
        """Problems, newest first."""
        return newest(self._session, Problem, dataset_id, page)

    def count(self, dataset_id: int) -> int:
        """How many frames of a dataset were refused and have not come since."""
        rows = (
            select(func.count())
            .select_from(Problem)
            .where(Problem.dataset_id == dataset_id)
        )
        return self._session.scalar(rows) or 0
