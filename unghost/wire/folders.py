"""What the service finds in a folder of files, line by line; nothing is stored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from unghost.wire.model import Fault, Json, Message, ResponseModel


class FolderHead(ResponseModel):
    """The first line: how the folder is laid out."""

    layout: str = Field(description="The layout by which it is read.")
    layouts: tuple[str, ...] = Field(
        description="The layouts that it may have, the likeliest first."
    )
    classes: tuple[Message, ...] | None = Field(
        description="The layout's own list of classes, in its order."
    )
    count: int | None = Field(
        description="How many frames follow; null where only reading tells."
    )


class FolderFrame(ResponseModel):
    """One frame: its annotation as an upload takes it, or why it cannot be read."""

    key: Message
    annotation: Json | None
    files: Mapping[str, Message] = Field(
        description="The names of its files, as they were sent, by their kinds."
    )
    fault: Fault | None


class UnmatchedFile(ResponseModel):
    """A file that belongs to no frame."""

    path: Message
    why: Message


class FolderEnd(ResponseModel):
    """The last line: how many lines of each kind there were."""

    end: Literal[True]
    frames: int
    faulty: int = Field(description="Frames of these that cannot be read.")
    unmatched: int
