"""How much may be asked of the background at once: by everybody, and by one token."""

from __future__ import annotations

from typing import Final

from sqlalchemy.orm import Session

from app.errors import TooManyRequests
from app.repositories.runs import ExportRepository, RunRepository
from app.settings import Settings

_RETRY_S: Final = 10


def require_a_place(session: Session, settings: Settings, author: str) -> None:
    """Let one more run or export be queued.

    Only one transaction writes at a time, so what is counted here still holds when the
    job is added.

    Raises
    ------
    TooManyRequests
        So many wait or work already.
    """
    runs, exports = RunRepository(session), ExportRepository(session)
    if runs.open_count() + exports.open_count() >= settings.max_open_runs:
        raise TooManyRequests(
            f"{settings.max_open_runs} runs and exports wait or work already; "
            "try again when one of them is over",
            retry_after_s=_RETRY_S,
        )
    own = runs.open_count(author) + exports.open_count(author)
    if own >= settings.max_open_jobs_per_token:
        raise TooManyRequests(
            f"{own} runs and exports of {author!r} wait or work already; cancel one, "
            "or try again when one is over",
            retry_after_s=_RETRY_S,
            code="too_many_jobs",
        )
