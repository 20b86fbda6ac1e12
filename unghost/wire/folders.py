"""The lines of a response about a dropped folder: its frames and other files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import Field, WithJsonSchema

from unghost.wire.model import Fault, Json, Message, ResponseModel
from unghost.wire.words import FileKind, FolderLayout, Layout


def _or_plugin(words: object) -> WithJsonSchema:
    named = {"type": "string", "enum": [*get_args(words)]}
    other = {"type": "string", "description": "The name of a plug-in's format."}
    return WithJsonSchema({"anyOf": [named, other]})


LayoutName: TypeAlias = Annotated[str, _or_plugin(Layout)]
"""A `Layout`, or that of a plug-in which the server has."""
FolderLayoutName: TypeAlias = Annotated[str, _or_plugin(FolderLayout)]
"""A `FolderLayout`, or that of a plug-in which the server has."""


class FolderHead(ResponseModel):
    """The first line: how the files of the folder are arranged."""

    layout: FolderLayoutName = Field(
        description="The layout by which the folder was read."
    )
    layouts: tuple[FolderLayoutName, ...] = Field(
        description="The layouts that the folder may have, the likeliest first."
    )
    titles: Mapping[FolderLayoutName, Message] = Field(
        description="The name for people of each of these layouts."
    )
    classes: tuple[Message, ...] | None = Field(
        description="Names of the classes in the order of their numbers; null if the "
        "folder has no list of them."
    )
    settings: Mapping[Message, Message] = Field(
        description="What recording.yaml in the folder says about segmentations, as "
        "settings of a dataset."
    )
    config: Json = Field(
        description="Other keys of a configuration that recording.yaml gives, such as "
        "classes."
    )
    count: int | None = Field(
        description="How many frames follow; null if that is known only at the end."
    )


class FolderFrame(ResponseModel):
    """One frame: the annotation to upload it with, or why it cannot be read."""

    key: Message
    annotation: Json | None
    annotation_text: str | None = Field(
        description="The annotation as JSON, if it has whole numbers beyond 2^53, of "
        "which JavaScript would lose digits; null for any other."
    )
    files: Mapping[FileKind, Message] = Field(
        description="Name of each file of the frame, as it was sent, by its kind."
    )
    fault: Fault | None


class UnmatchedFile(ResponseModel):
    """A file that belongs to no frame."""

    path: Message
    why: Message


class FolderEnd(ResponseModel):
    """The last line: how many lines of each kind there are."""

    end: Literal[True]
    frames: int
    faulty: int = Field(description="How many of the frames cannot be read.")
    unmatched: int
    notes: list[Message] = Field(
        description="Sentences about how the files were read, such as what was "
        "recognised, or read as something else."
    )
