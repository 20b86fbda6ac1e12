"""Which of many frames are stored already."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class KnownFramesIn(BaseModel):
    """Keys to look for."""

    model_config = ConfigDict(extra="forbid")

    keys: list[str] = Field(max_length=1000)


class KnownFrameOut(BaseModel):
    """A frame that is stored."""

    key: str
    frame_id: int
    digest: str = Field(description="Names the content; see the guide to the API.")


class KnownFramesOut(BaseModel):
    """Those of the keys that are stored; the others are not there."""

    items: list[KnownFrameOut]
