"""SQL of exports."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Dataset, Measurement, Run
from app.jobs.queries import OPEN


def is_being_renamed(session: Session, dataset: Dataset) -> bool:
    """Whether an open run will rename classes of a dataset."""
    rows = (
        select(Measurement)
        .join(Run, Run.measurement_id == Measurement.id)
        .where(
            Run.dataset_id == dataset.id, Run.state.in_(OPEN), Run.activate.is_(True)
        )
    )
    return any(
        coming.options["dataset"].get("renamed_classes", {}) != dataset.renamed_classes
        for coming in session.scalars(rows)
    )
