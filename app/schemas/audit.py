"""The audit log as it is answered."""

from __future__ import annotations

from typing import Any

from pydantic import AwareDatetime, BaseModel, Field


class AuditEntryOut(BaseModel):
    """Who did what, when, and to what."""

    id: int
    created_at: AwareDatetime
    actor: str = Field(description="The token's name; `unghost` is the service itself.")
    token_id: int | None
    action: str = Field(description="What was done, such as `dataset.deleted`.")
    subject: str = Field(description="The name or number of what it was done to.")
    details: dict[str, Any]
