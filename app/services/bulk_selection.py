"""All boxes of a filter, for one answer on every one of them."""

from __future__ import annotations

import numpy as np
from sqlalchemy.orm import Session

from app.db.tables import Dataset
from app.errors import CountChanged, TooLarge
from app.repositories.box_filter import BoxFilter
from app.repositories.box_probes import BoxProbes
from app.services.box_counts import count_boxes
from app.services.context import ServiceContext


def select_boxes(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    wanted: BoxFilter,
    expected: int,
) -> list[int]:
    """All boxes of a filter, if they are as many as the person was shown."""
    limit = context.settings.max_bulk_boxes
    found = count_boxes(context, session, dataset, wanted)
    if found != expected:
        raise CountChanged("the filter selects", found=found, expected=expected)
    if found > limit:
        raise TooLarge(
            f"the filter selects {found} boxes, one bulk review changes at most {limit}"
        )
    return [int(box_id) for box_id in np.sort(BoxProbes(session).every(wanted))]
