"""`inspect_recording`: how a folder is understood, shown before anything runs.

All labels are read, and the pictures of some frames, with the readers and the filter
that every command uses. What cannot be read is a problem of the inspection, never an
error: the files are listed all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from filter_core.class_names import class_meant_by, misspelt_class
from filter_core.classes import PASS, accepted_names
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.carlasimu import CARLASIMU
from filter_core.formats.labels import other_notations
from filter_core.formats.reading import FrameSet, StreamFacts, name_of
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import (
    describe_source,
    layout_format,
    possible_layouts,
    read_source,
)
from filter_core.formats.splits import Split
from filter_core.formats.streams import Streams
from filter_core.formats.yolo import NoClassList
from filter_core.inspection.files import Cameras, FileUse, found_splits, unused_files
from filter_core.inspection.labels import LabelSurvey
from filter_core.inspection.listing import Counted, Listed, counted
from filter_core.inspection.pictures import (
    DepthFacts,
    DrawnFrame,
    PictureSurvey,
    SegmentationFacts,
    Size,
    look_at,
)
from filter_core.local import ClassCount, in_class_order

PICTURES: Final = 24
"""Frames whose pictures are looked at; rare classes add a few."""


@dataclass(frozen=True)
class Problem:
    """Something that has to be said in a description before a folder can be used.

    `detail` is what was found, and the remedy.
    """

    code: str
    detail: str


@dataclass(frozen=True)
class ClassFacts:
    """A class of the labels.

    Attributes
    ----------
    boxes : int
        In all labels.
    measured_as : str or None
        The filter's class as which it is measured, or `PASS`; None if the filter knows
        none.
    nearest : str or None
        The class that a name which is not known probably means.
    tags : tuple of str
        The tags whose pixels count for it.
    looked_at : ClassCount
        Its boxes in the frames whose pictures were looked at.
    kept, unmeasured : int
        Of these.
    unknown : tuple of Counted
        Tags or colours in these boxes that are not known, by their pixels.
    """

    name: str
    boxes: int
    measured_as: str | None
    nearest: str | None
    tags: tuple[str, ...]
    looked_at: ClassCount
    kept: int
    unmeasured: int
    unknown: tuple[Counted, ...]

    @property
    def unknown_percent(self) -> float | None:
        """Of the pixels in its boxes; None if none was measured."""
        count = self.looked_at
        return 100 * count.unknown_pixels / count.pixels if count.pixels else None


@dataclass(frozen=True)
class BoxFacts:
    """All boxes of the labels, and how many of them are given as 3D boxes.

    `faults` are kinds of rectangles that can hardly be right: see `LabelSurvey.faults`.
    """

    count: int
    in_3d: int
    faults: tuple[Listed, ...]


@dataclass(frozen=True)
class Inspection:
    """How a folder is understood.

    Attributes
    ----------
    layout : str or None
        None if it cannot be read.
    layouts : tuple of str
        All that it may have, the likeliest first.
    why : str
        What told the layout.
    described : RecordingDescription
        What was recognised, and what the given description says. To read a folder with
        it gives the same.
    notes : tuple of str
        How the files were read.
    with_role : mapping of str to int
        How many frames have a file of each role.
    refused : tuple of Listed
        Frames that cannot be used, by the code of the fault; `refused_pictures` those
        of `pictures` that cannot be measured.
    left_over : tuple of Listed
        Images and labels that belong to no frame.
    not_read : tuple of Listed
        Other files.
    pictures : int
        How many frames were looked at.
    image_notes : tuple of Counted
        How other images of frames were read.
    """

    name: str
    layout: str | None
    layouts: tuple[str, ...]
    why: str
    described: RecordingDescription
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]
    frames: int
    with_role: Mapping[str, int]
    streams: tuple[StreamFacts, ...]
    refused: tuple[Listed, ...]
    refused_pictures: tuple[Listed, ...]
    left_over: tuple[Listed, ...]
    not_read: tuple[Listed, ...]
    classes: tuple[ClassFacts, ...]
    boxes: BoxFacts
    pictures: int
    segmentation: SegmentationFacts | None
    depth: DepthFacts | None
    image_notes: tuple[Counted, ...]
    sizes: tuple[Size, ...]
    splits: tuple[Split, ...]
    cameras: tuple[Cameras, ...]
    drawn: tuple[DrawnFrame, ...]


@dataclass(frozen=True)
class Sampling:
    """Which frames are looked at, besides reading all labels.

    Attributes
    ----------
    pictures : int
        How many, evenly spread, besides one of each class.
    absent : set of str
        Paths of images whose content is not here, and says nothing: frames that have
        one are not looked at.
    workers : int or None
        Threads; one more than there are cores.
    """

    pictures: int = PICTURES
    absent: AbstractSet[str] = frozenset()
    workers: int | None = None


def inspect_recording(
    source: Path,
    description: RecordingDescription | None = None,
    *,
    pictures: int = PICTURES,
    progress: Callable[[int, int | None], None] = lambda _done, _of: None,
) -> Inspection:
    """How a folder or a file of frames is understood.

    Parameters
    ----------
    description : RecordingDescription, optional
        What is known about it. Default: that of ``recording.yaml`` beside the data.
    pictures : int
        Frames whose pictures are looked at, evenly spread, besides one of each class.
        All labels are read.
    progress : callable
        Called after each frame with their number, and with that of all if it is known.

    Raises
    ------
    LayoutError
        There is no such folder, or a fault in ``recording.yaml``.
    """
    if not source.exists():
        raise LayoutError(f"{name_of(source)}: expected a folder or a file, found none")
    described = describe_source(source) if description is None else description
    opened = open_recording(source, described)
    return inspect_opened(source, opened, Sampling(pictures), progress)


def inspect_opened(
    source: Path,
    opened: OpenedRecording,
    sampling: Sampling,
    progress: Callable[[int, int | None], None] = lambda _done, _of: None,
) -> Inspection:
    """How a recording that was opened is understood: see `inspect_recording`.

    Its frames are read once.
    """
    root = source if source.is_dir() else source.parent
    files = FileUse(root, opened.description.files)
    labels = LabelSurvey(files, sampling.pictures, sampling.absent)
    labels.read(opened.frames, progress)
    config = FilterConfig.from_mapping(opened.description.config_keys())
    looked = look_at(labels.sample(), config, sampling.workers)
    splits = found_splits(opened.frames, labels.use)
    is_folder = source.is_dir()
    left_over, not_read = unused_files(opened.frames, labels.use, splits)
    # The description with what was recognised for certain
    recognised: dict[str, object] = {}
    description = opened.description
    if opened.layout is not None and description.layout == "auto":
        recognised["layout"] = opened.layout
    tags = looked.segmentation
    if tags is not None and tags.is_certain:
        encoding, order = tags.common("encoding"), tags.common("channel_order")
        recognised |= {"palette": tags.family, "encoding": encoding or "auto"}
        if encoding == "palette":  # the order of raw tags means nothing
            recognised["channel_order"] = order or "auto"
    if looked.depth is not None and looked.depth.encoding is not None:
        recognised["depth_encoding"] = looked.depth.encoding
    unsaid = {
        key: value
        for key, value in recognised.items()
        if getattr(description, key) == "auto"
    }
    changed: Callable[..., RecordingDescription] = replace
    # The files by role where the layout or the description names each
    roles, layout = description.files.roles, str(opened.layout)
    named_streams = tuple(
        StreamFacts(
            role, count, labels.examples[role], ("description",), roles[role].text
        )
        if role in roles
        else StreamFacts(role, count, labels.examples[role], (layout,))
        for role, count in labels.roles.items()
    )
    problems, mixed = opened.problems, looked.problem
    if mixed is not None:  # segmentations are of several families
        problems = (*problems, Problem(mixed.kind, mixed.detail))
    return Inspection(
        name=name_of(source),
        layout=opened.layout,
        layouts=opened.layouts,
        why=opened.why,
        described=changed(description, **unsaid),
        problems=problems,
        notes=opened.frames.notes(),
        frames=labels.frames,
        with_role=dict(labels.roles),
        streams=opened.frames.streams or named_streams,
        refused=labels.refused.listed(),
        refused_pictures=looked.refused.listed(),
        left_over=left_over,
        not_read=not_read if is_folder else (),
        classes=tuple(_classes(opened.frames, labels, looked, config)),
        boxes=BoxFacts(labels.boxes, labels.boxes_3d, labels.faults.listed()),
        pictures=looked.frames,
        segmentation=looked.segmentation,
        depth=looked.depth,
        image_notes=counted(looked.notes),
        sizes=tuple(Size(*wh, count) for wh, count in looked.sizes.most_common()),
        splits=splits,
        cameras=labels.use.cameras(),
        drawn=looked.drawn,
    )


@dataclass(frozen=True)
class OpenedRecording:
    """A folder with what was recognised; without frames if it cannot be read.

    Frames have their boxes as they look like, whatever the format says; the description
    says what that is. `others` are the errors about boxes of which a person has to say
    what they are before they are used.
    """

    frames: FrameSet
    layout: str | None
    layouts: tuple[str, ...]
    why: str
    description: RecordingDescription
    problems: tuple[Problem, ...]
    others: tuple[LayoutError, ...] = ()


def open_recording(source: Path, description: RecordingDescription) -> OpenedRecording:
    """The frames, in the layout and notation that they are recognised to have.

    What `description` says is not recognised.
    """
    layout = description.own_layout
    layouts = (layout,) if layout != "auto" else possible_layouts(source, description)
    problems = []
    if len(layouts) > 1:
        names = " or ".join(layouts)
        remedies = [f"`layout: {name}`" for name in layouts]
        which = f"{', '.join(remedies[:-1])} or {remedies[-1]}"
        text = _SEVERAL.format(names, layouts[0], which)
        problems.append(Problem("several_layouts", text))
    try:
        frames, described, others = _read(
            source, layouts[0] if layouts else "", description
        )
    except LayoutError as exc:
        remedy = "" if layouts else _NAME_LAYOUT
        if isinstance(exc, NoClassList):
            remedy = _NAME_CLASSES
        problems.append(Problem(exc.kind, f"{exc.detail}{remedy}"))
        streams: tuple[StreamFacts, ...] = ()
        with suppress(LayoutError):  # of a description that contradicts itself
            streams = Streams(source, description).facts if source.is_dir() else ()
        frames = FrameSet("", lambda: iter(()), streams=streams)
        return OpenedRecording(frames, None, layouts, "", description, tuple(problems))
    problems += [Problem(other.kind, other.detail) for other in others]
    if frames.count == 0:
        problems.append(Problem("no_frames", _NO_FRAMES.format(frames.layout)))
    why = "as the description says"
    if layout == "auto":
        why = f"recognised by {layout_format(frames.layout).recognised_by}"
    return OpenedRecording(
        frames, frames.layout, layouts, why, described, tuple(problems), others
    )


def _read(
    source: Path, layout: str, description: RecordingDescription
) -> tuple[FrameSet, RecordingDescription, tuple[LayoutError, ...]]:
    """The frames, with boxes in another unit or notation read as what they look like.

    Also the description that says so, and the errors that say what they look like.
    """
    layout = layout or "auto"
    changed: Callable[..., RecordingDescription] = replace
    plain = changed(description, unit="auto", corners="auto")
    frames = read_source(source, layout, plain, recognise=False)
    others: list[LayoutError] = []
    said: set[str] = set()
    described = description
    # Boxes whose unit is known may show another notation.
    for _ in range(0 if layout == CARLASIMU.name else 2):  # has units of its own
        shown = [
            (key, word, error)
            for key, word, error in other_notations(frames, described)
            if key not in said
        ]
        said.update(key for key, _, _ in shown)
        others += (error for _, _, error in shown)
        clear = {key: word for key, word, _ in shown if " or " not in word}
        described = changed(described, **clear)
        if not clear:
            break
    if described != plain:
        frames = read_source(source, layout, described, recognise=False)
    return frames, described, tuple(others)


_SEVERAL: Final = (
    "the files could be {0}, and are read as {1}; {2} in recording.yaml says which "
    "labels are meant"
)

_NAME_LAYOUT: Final = "; `layout` in recording.yaml names it"

_NAME_CLASSES: Final = (
    "; `layout: yolo` and `boxes: {classes: [car, bus]}` in recording.yaml name them "
    "in their order"
)

_NO_FRAMES: Final = (
    "no frames in layout {}: its files are not used; `layout` in recording.yaml names "
    "another one"
)


def _classes(
    frames: FrameSet, labels: LabelSurvey, looked: PictureSurvey, config: FilterConfig
) -> Iterator[ClassFacts]:
    """The classes in the order of their list, else in the filter's."""
    measuring = config.measuring()
    family = looked.segmentation.family if looked.segmentation else None
    listed = frames.classes or ()
    others = set(labels.by_class).difference(listed)
    for name in (*listed, *in_class_order(others)):
        measured_as = measuring.measured_class(name)
        mask = 0
        with suppress(FilterError):  # tags that this family does not have: said before
            (mask,) = measuring.accept_masks([name], family).tolist()
        is_known = bool(mask) or measured_as == PASS
        count = looked.classes.get(name, ClassCount())
        kept = looked.verdicts[name, "kept"]
        unknown = [
            Counted(value, pixels)
            for (of_class, value), pixels in looked.unknown.most_common()
            if of_class == name
        ]
        yield ClassFacts(
            name=name,
            boxes=labels.by_class[name],
            measured_as=measured_as if is_known else None,
            nearest=None if class_meant_by(name) else misspelt_class(name),
            tags=accepted_names(mask, family) if mask and family else (),
            looked_at=count,
            kept=kept,
            unmeasured=count.boxes - count.rejected - kept,
            unknown=tuple(unknown),
        )
