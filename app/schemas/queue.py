"""The review queue as it is asked and answered."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.schemas.boxes import DecisionOut
from app.schemas.reviews import BoxSelection, Id


class QueueIn(BaseModel):
    """Which boxes are wanted next."""

    model_config = ConfigDict(extra="forbid")

    order: Literal["doubt", "random", "class", "audit"] = "doubt"
    filters: BoxSelection = Field(
        default_factory=BoxSelection,
        description="Undecided boxes unless `review` or `conflict` is given; decided "
        "ones in an audit.",
    )
    limit: Annotated[int, Field(ge=1, le=50)] = 10
    exclude: list[Id] = Field(
        default_factory=list,
        max_length=1000,
        description="Boxes that are at hand already: not answered again; own claims "
        "on them are renewed.",
    )
    seed: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] | None = Field(
        default=None, description="Of the random order; one per dataset unless given."
    )


class ClaimOut(BaseModel):
    """Until when nobody else is given the box."""

    expires_at: datetime


class QueuedOut(DecisionOut):
    """A box to look at."""

    claim: ClaimOut


class QueueOut(BaseModel):
    """Boxes to look at, most urgent first."""

    items: list[QueuedOut]
    remaining: int = Field(
        description="Boxes of the filter that nobody has answered, claimed or not; of "
        "a filter on answers, all its boxes."
    )
    unsure: int = Field(
        description="Boxes that a person was unsure about; they come last."
    )
    claimed_by_others: int
