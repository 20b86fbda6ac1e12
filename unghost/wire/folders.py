"""The lines of a response about a dropped folder: its frames and other files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import Field, WithJsonSchema

from unghost.wire.model import Fault, Json, Message, ResponseModel
from unghost.wire.words import FileKind, FolderLayout, Layout, Verdict


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

    layout: FolderLayoutName | None = Field(
        description="The layout by which the folder was read; null if it cannot be "
        "read, and has no frames."
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


class FolderRemedy(ResponseModel):
    """A value of a key of recording.yaml that may be missing or wrong."""

    place: tuple[Message, ...] = Field(
        description="The key, below those that it is in: `boxes`, `unit`."
    )
    value: Message


class FolderRemark(ResponseModel):
    """A sentence about a folder."""

    text: Message
    finding: Message = Field(description="The sentence without what helps.")
    remedies: tuple[FolderRemedy, ...] = Field(
        description="What helps, where that is a word for a key."
    )
    unknown_classes: tuple[Message, ...] = Field(
        description="The classes that the sentence is about, if the filter knows none "
        "of them."
    )
    is_serious: bool = Field(
        description="Whether it must be looked at before the folder is used."
    )


class FolderStream(ResponseModel):
    """Images of one role that one pattern names, or those of one folder."""

    role: Message = Field(description="`image` for the camera's pictures.")
    images: int
    example: Message = Field(description="The first of them, as it was sent.")
    told_by: tuple[Message, ...] = Field(
        description="What told the role: `name`, `pixels`, `description`, `manifest`; "
        "empty for pictures of which nothing says that they are anything else."
    )
    pattern: Message | None = Field(
        description="Their paths, as `files` of recording.yaml names them: of all "
        "patterns that match an image, that of its stream is the most specific; null "
        "if no pattern names them."
    )


class FolderClass(ResponseModel):
    """A class of the labels; pixels and verdicts are of the frames looked at."""

    name: Message
    boxes: int = Field(description="In all labels.")
    measured_as: Message | None = Field(
        description="The filter's class as which it is measured, or `pass`; null if "
        "the filter knows none."
    )
    nearest: Message | None = Field(
        description="The class that an unknown name probably means."
    )
    tags: tuple[Message, ...] = Field(description="The tags that count for it.")
    kept: int
    rejected: int
    unmeasured: int
    unknown_percent: float | None = Field(
        description="Of the pixels in its boxes, those whose tag is not known; null "
        "if none was measured."
    )


class FolderFact(ResponseModel):
    """One line about a folder, such as its sizes of images."""

    name: Message
    text: Message


class PaintedBox(ResponseModel):
    """A box of a painted frame, in px of the frame."""

    xyxy: tuple[float, float, float, float]
    class_name: Message
    verdict: Verdict
    explanation: Message


class PaintedFrame(ResponseModel):
    """A frame with the verdicts of its boxes."""

    key: Message
    width: int
    height: int
    jpeg: str | None = Field(
        description="The picture, smaller, in base64; without one the segmentation in "
        "its colours; null if there is neither."
    )
    boxes: tuple[PaintedBox, ...]


class FolderInspection(ResponseModel):
    """How a folder is understood, as `unghost inspect` shows it."""

    why: Message = Field(description="What told the layout; empty if nothing did.")
    remarks: tuple[FolderRemark, ...]
    facts: tuple[FolderFact, ...]
    streams: tuple[FolderStream, ...]
    classes: tuple[FolderClass, ...]
    looked_at: int = Field(description="Frames whose pictures were looked at.")
    painted: tuple[PaintedFrame, ...]
    palette: Message | None = Field(
        description="The family of tags of the segmentations; null if none is known."
    )
    given: Json = Field(
        description="What recording.yaml of the folder says, as JSON, which is YAML, "
        "too."
    )
    read_with: Json = Field(
        description="What was given and recognised, as JSON: the `recording` of a new "
        "dataset."
    )
    recording: Message = Field(
        description="The same as the text of a recording.yaml, with hints in comments."
    )


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
    inspection: FolderInspection
