"""Options for reading a folder of frames, and the frames of the folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import Field, dataclass, replace
from functools import wraps
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    ClassVar,
    Final,
    Protocol,
    TypeAlias,
    TypeVar,
    get_args,
)

import typer

from unghost.cli.options import error_context, listed, read_file
from unghost.cli.screen import Kinds, Refused, Screen, one_line
from unghost.wire.words import ChannelOrder, Encoding, Layout, LossyPolicy, Palette

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.errors import FilterError
    from filter_core.formats.reading import FrameSet, FrameSource, Unmatched
    from filter_core.formats.recording import RecordingDescription
    from filter_core.recognition import Shown
    from unghost.client.outgoing import NotSent, OutgoingFrame

_KEY: Final = re.compile(
    r"`(?P<key>[a-z_.]+)"
    r"(: (\{(?P<below>[^{}:]+): (?P<of>[^{}]+)\}|(?P<value>[^`{}]+)))?`"
    r"(?P<file> in recording\.yaml)?"
)
"""A key of a description that a sentence names: `boxes: {unit: percent}`."""

_MISSPELT: Final = 0.85
"""Likeness of a key to one with a meaning; other keys are kept on purpose."""

_MOST_KEYS: Final = 1000
"""Different keys that are looked at; others are not looked for any more."""

_READING_SETTING: Final = re.compile(r"\b(lossy_segmentation|encoding): (nearest|raw)")
"""Settings that errors recommend (see `SourceOptions`)."""

SourceFolder: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="SOURCE",
        help="A folder in one of the known layouts, a manifest.jsonl, or an archive "
        "of a folder (.zip, .tar, .tar.gz).",
        exists=True,
    ),
]

EncodingOption: TypeAlias = Annotated[
    Encoding | None, typer.Option(help="How the segmentations encode tags.")
]
ChannelOrderOption: TypeAlias = Annotated[
    ChannelOrder | None,
    typer.Option(help="Order of the colour channels in the segmentations."),
]


def _layout_name(word: str) -> str:
    """A layout; plug-ins are looked for only if none of the product's has the name."""
    if word in get_args(Layout):
        return word
    from filter_core.formats.recording import known_layouts

    layouts = known_layouts(word)
    if word not in layouts:
        raise typer.BadParameter(
            f"{word!r} is not one of {', '.join(map(repr, layouts))}."
        )
    return word


def _layouts(incomplete: str) -> list[str]:
    words: tuple[str, ...] = get_args(Layout)
    return [word for word in words if word.startswith(incomplete)]


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """How to read a folder of frames; what is not given is recognised or described."""

    layout: Annotated[
        str,
        typer.Option(
            metavar="LAYOUT",
            parser=_layout_name,
            autocompletion=_layouts,
            help=f"How the files of the folder are arranged: {listed(Layout)}. "
            "Installed plug-ins add names.",
        ),
    ] = "auto"
    segmentation: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the segmentations, in SOURCE or anywhere; default: the "
            "layout's own.",
        ),
    ] = None
    labels: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the labels, in SOURCE or anywhere; default: the layout's "
            "own.",
        ),
    ] = None
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Names of the classes in the order of their numbers, separated by "
            "commas, if the folder has no list of its own.",
        ),
    ] = None
    default_class: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Class to use for labels without one.",
            show_default="unknown",
        ),
    ] = None
    palette: Annotated[
        Palette | None,
        typer.Option(
            help="Table of tags of the segmentations, named after the first version of "
            "CARLA that has it: carla-0.9.14 is also that of 0.9.15, 0.9.16 and 0.10."
        ),
    ] = None
    encoding: EncodingOption = None
    channel_order: ChannelOrderOption = None
    lossy_segmentation: Annotated[
        LossyPolicy | None,
        typer.Option(
            help="What to do with segmentations whose colours are not exact, such as "
            "JPEG files."
        ),
    ] = None
    depth_encoding: Annotated[
        str | None,
        typer.Option(
            metavar="ENCODING",
            help="How the depth images encode distances, such as carla or carla-bgr.",
        ),
    ] = None
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="0|1",
            help="Whether rectangles in whole pixels are counted from 0 or from 1; "
            "default: as the files show.",
        ),
    ] = None
    unit: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT",
            help="The unit of rectangles, if it is not the format's own: pixels, "
            "shares or percent.",
        ),
    ] = None
    corners: Annotated[
        str | None,
        typer.Option(
            metavar="FORM",
            help="What the four numbers of a rectangle are, if not what the format "
            "says: xyxy, inclusive, xywh or cxcywh.",
        ),
    ] = None
    class_map: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=CLASS",
            help="What a class measures as, such as Car=car, or NAME=pass to pass its "
            "boxes on unmeasured; several separated by commas, or repeated.",
        ),
    ] = None
    outside_files: Annotated[
        bool,
        # Hidden: of the commands that upload nothing, older scripts may still use it.
        typer.Option(
            "--outside-files",
            hidden=True,
            help="Has no effect: this command reads files outside the folder anyway.",
        ),
    ] = False
    recording: Annotated[
        Path | None,
        read_file(
            metavar="FILE",
            help="The description of the recording (YAML); default: recording.yaml "
            "beside the data, if there is one.",
        ),
    ] = None

    @property
    def reading(self) -> dict[str, str]:
        """The given options for segmentations, with the names of datasets' settings."""
        words = {name: getattr(self, name) for name in SEGMENTATION_SETTINGS}
        return {name: word for name, word in words.items() if word is not None}

    @property
    def outside(self) -> dict[str, object]:
        """Which files outside the folder may be read: all, since none is uploaded."""
        return {"outside_files": True}

    def description_of(self, source: Path) -> RecordingDescription:
        """How a folder is read: its description, with the given options in front.

        The description is recording.yaml, else that of a recognised recorder. Class
        maps of both are merged.

        Raises `LayoutError`: the description cannot be read.
        Raises `typer.BadParameter`: an option has a wrong value.
        """
        from filter_core.errors import ConfigError
        from filter_core.formats.registry import describe_source

        keys = {
            name: getattr(self, name)
            for name in (*_DESCRIBING, *SEGMENTATION_SETTINGS)
            if getattr(self, name) is not None
        }
        keys |= {
            name: _folder_of(source, keys[name], name)
            for name in ("segmentation", "labels")
            if name in keys
        }
        if self.classes is not None:
            keys["classes"] = _names(self.classes)
        if self.class_map is not None:
            keys["class_map"] = dict(_class_map(self.class_map))
        if self.layout != "auto":
            keys["layout"] = self.layout
        try:
            return describe_source(source, self.recording, keys | self.outside)
        except ConfigError as exc:
            # The error about a key of a description, with the option in its place
            name, colon, rest = exc.detail.partition(": ")
            key, dot, below = name.partition(".")
            if key == "classes" and below in dict(_class_map(self.class_map or ())):
                key = "class_map"
            option = f"--{key.replace('_', '-')}"
            raise typer.BadParameter(
                f"{option}{dot and ' '}{below}{colon}{rest}"
            ) from exc


def _folder_of(source: Path, folder: Path, option: str) -> Path:
    """The folder that an option names.

    It is that in SOURCE, as in recording.yaml, else as the shell has it.
    """
    home = source if source.is_dir() else source.parent
    for path in (home / folder, folder):
        if path.is_dir():
            return path
    raise typer.BadParameter(
        f"--{option}: expected a folder, found none named {folder} in {source} or here"
    )


_OF_BOXES: Final = ("origin", "unit", "corners")
_DESCRIBING: Final = (
    "segmentation",
    "labels",
    "default_class",
    "depth_encoding",
    *_OF_BOXES,
)
"""Options that are keys of a description as they are."""

SEGMENTATION_SETTINGS: Final = (
    "palette",
    "encoding",
    "channel_order",
    "lossy_segmentation",
)
"""Options that are settings of a dataset, too."""


def _names(words: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in words.split(","))


def _class_map(texts: Iterable[str]) -> Iterator[tuple[str, str]]:
    for entry in (entry for words in texts for entry in _names(words)):
        # A name may have "=" in it; the class it measures as has none.
        name, _, meant = entry.rpartition("=")
        if not name.strip() or not meant.strip():
            raise typer.BadParameter(
                f"--class-map: expected NAME=CLASS, such as Car=car, found {entry!r}"
            )
        yield name.strip(), meant.strip()


@dataclass(frozen=True, kw_only=True)
class LocalFilterOptions(SourceOptions):
    """A folder, and how it is filtered on this machine."""

    source: SourceFolder
    config: Annotated[
        Path | None,
        read_file(help="A filter configuration (YAML); default: the built-in one."),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, max=256, help="Frames processed in parallel; default: one per core."
        ),
    ] = None


class WithSource(Protocol):
    """The options of a command that reads a folder, a file or an archive."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    @property
    def source(self) -> Path:
        """What the command reads."""

    @property
    def layout(self) -> str:
        """Its layout; ``auto``: the one that is recognised."""

    @property
    def recording(self) -> Path | None:
        """The file that describes it, if one was named."""

    @property
    def screen(self) -> Screen:
        """Where its output goes."""


OptionsT = TypeVar("OptionsT", bound=WithSource)


def reads_archives(command: Callable[[OptionsT], None]) -> Callable[[OptionsT], None]:
    """The command, which gets the unpacked folder where its source is an archive.

    Of a folder that is no recording and has nothing but one folder, it gets that.
    """

    @wraps(command)
    def run(options: OptionsT) -> None:
        from filter_core.formats.recorders import recorder_of
        from filter_core.formats.registry import possible_layouts
        from unghost.cli.archives import is_archive, only_folder, unpacked

        source = options.source
        if is_archive(source):
            with unpacked(source, options.screen) as folder:
                command(replace(options, source=folder))
            return
        is_described = options.layout != "auto" or options.recording is not None
        inner = only_folder(source) if source.is_dir() and not is_described else None
        if inner and not (possible_layouts(source) or recorder_of(source)):
            source = inner
        command(replace(options, source=source))

    return run


def open_source(path: Path, layout: str, description: RecordingDescription) -> FrameSet:
    """The frames of a folder or a file; a `layout` that is named wins.

    Raises `LayoutError`: its layout is unknown, or is not the one that was named.
    Raises `typer.BadParameter`: its layout does not have one of the options.
    Raises `Refused`: it may have several layouts, and none was named; or it has no
    frames, or labels without a list of classes.
    """
    from filter_core.errors import LayoutError
    from filter_core.formats.reading import name_of
    from filter_core.formats.registry import (
        UNUSED_OPTION,
        possible_layouts,
        read_source,
    )
    from filter_core.formats.yolo import NoClassList

    chosen = layout if layout != "auto" else description.own_layout
    possible = possible_layouts(path, description) if chosen == "auto" else ()
    if len(possible) > 1:
        raise Refused(
            f"{name_of(path)}: could be {' or '.join(possible)}; choose one, for "
            f"example with --layout {possible[0]}"
        )
    try:
        frames = read_source(path, possible[0] if possible else chosen, description)
    except LayoutError as exc:
        if exc.kind == UNUSED_OPTION:
            raise typer.BadParameter(exc.detail) from exc
        if isinstance(exc, NoClassList):
            raise Refused(f"{exc.detail}; {_class_options(path, chosen)}") from exc
        raise
    if frames.count is None and frames.layout == "manifest":
        frames = replace(frames, count=_count_lines(path))
    if frames.count == 0:
        problem = f"no frames in {name_of(path)} (layout {frames.layout})"
        raise Refused("\n".join([problem, *unmatched_lines(frames.unmatched)]))
    return frames


def _class_options(path: Path, layout: str) -> str:
    """The options for YOLO's labels without a list of classes."""
    from filter_core.formats.pairs import PAIRS
    from filter_core.formats.reading import IMAGE_SUFFIXES, walk
    from filter_core.formats.yolo import YOLO

    if layout == YOLO.name:
        return "--classes NAMES names them"
    named = f"--layout {YOLO.name} --classes NAMES names them"
    has_images = any(True for _ in walk(path, IMAGE_SUFFIXES))
    images = f", --layout {PAIRS.name} reads the images alone"
    return f"{named}{images}" if has_images else named


def _count_lines(source: Path) -> int:
    """Frames of a manifest, for the bar: it is small compared with the images."""
    from filter_core.formats.manifest import manifest_of
    from filter_core.formats.reading import name_of, open_regular

    path = manifest_of(source) or source
    try:
        with open_regular(path) as lines:
            return sum(1 for line in lines if line.strip())
    except OSError as exc:
        raise Refused(f"{name_of(path)}: cannot be read: {exc.strerror}") from exc


def read_config(
    path: Path | None,
    options: SourceOptions,
    description: RecordingDescription,
    screen: Screen,
) -> FilterConfig:
    """The configuration of a file, above the description and below the options.

    A class map of the command line is part of the description.
    """
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig

    with error_context(path):
        content = path.read_bytes() if path is not None else b""
        loaded = load_config(content, below=description.config_keys())
    if loaded.config.profile == "carlasimu":
        screen.note(
            "profile carlasimu: boxes are decided as the paper's published code does, "
            f"projection: {loaded.config.projection}"
        )
    note_unused_keys(loaded.unused_keys, screen)
    return FilterConfig.from_mapping({**loaded.config.as_dict(), **options.reading})


def note_unused_keys(keys: Sequence[str], screen: Screen) -> None:
    """Tell about keys of carlasimu's file that concern only its recording."""
    if keys:
        more = f" and {len(keys) - _NAMED_KEYS} more" if len(keys) > _NAMED_KEYS else ""
        screen.note(f"keys that are not used: {', '.join(keys[:_NAMED_KEYS])}{more}")


_NAMED_KEYS: Final = 3


def shown_by(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    channels: Collection[str],
    screen: Screen,
) -> Shown:
    """How some frames of a recording show that it is read; notes it.

    Raises `LayoutError`: its images are of several families of tags.
    """
    from filter_core.recognition import recognise_recording

    shown = recognise_recording(frames, config, channels)
    for note in shown.notes:
        screen.note(one_line(note))
    return shown


def outgoing(frames: FrameSet) -> Iterator[OutgoingFrame | NotSent]:
    """Frames to be sent; one that cannot be read becomes `NotSent` with the reason."""
    from filter_core.formats.reading import missing_image
    from filter_core.formats.same import with_labels
    from unghost.client.outgoing import NotSent, OutgoingFrame

    for frame in frames:
        # The server knows the names of no labels.
        if problem := frame.problem or missing_image(frame):
            yield NotSent(frame.key, problem)
            continue
        files = {"image": frame.image, "segmentation": frame.segmentation}
        files |= frame.others
        there = {name: path for name, path in files.items() if path is not None}
        yield OutgoingFrame(frame.key, with_labels(frame, frames.layout), there)


class FrameCheck:
    """Looks, while the frames of a folder are read, for what is mostly a mistake."""

    def __init__(self) -> None:
        self._frames = 0
        self._any_box = False
        self._keys: set[str] = set()

    def watch(self, frames: FrameSet) -> FrameSet:
        """The same frames, looked at while they are read."""

        def watched() -> Iterator[FrameSource]:
            for frame in frames.frames():
                if frame.problem is None:
                    annotation = frame.annotation or {}
                    self._frames += 1
                    self._any_box |= bool(annotation.get("boxes"))
                    if len(self._keys) < _MOST_KEYS:
                        self._keys.update(annotation)
                yield frame

        return replace(frames, frames=watched)

    def note(self, screen: Screen, frames: FrameSet) -> None:
        """Note what was seen: how the folder was read, misspelt keys, no box at all."""
        note_reading(screen, frames)
        from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
        from filter_core.formats.manifest import FRAME_FILES
        from filter_core.values import similar

        keys = KNOWN_FRAME_KEYS.union(FRAME_FILES)
        for key in sorted(self._keys - keys):
            if meant := similar(key, keys, likeness=_MISSPELT):
                screen.note(
                    one_line(
                        f"the key {key!r} of frames is kept, but has no meaning; "
                        f"did you mean {meant!r}?"
                    )
                )
        # Mostly, the labels were not found
        from filter_core.formats.pairs import PAIRS
        from filter_core.formats.registry import layout_format

        if self._any_box or not self._frames:
            return
        hints = ["--layout names another layout"]
        if "labels" in layout_format(frames.layout).read_options:
            hints.append("--labels the folder of the labels")
        why = "which lists no boxes"
        if "labels" in layout_format(frames.layout).read_options:
            why = "whose labels were found, and are empty"
        if frames.layout == PAIRS.name:  # which reads every image as a frame
            why = "which expects the boxes of an image NAME.png in NAME.json"
            hints.append("--segmentation that of the segmentations")
        screen.note(
            f"no frame has a box ({self._frames} read, layout {frames.layout}, {why}); "
            f"{', '.join(hints)}"
        )


def note_reading(screen: Screen, frames: FrameSet) -> None:
    """Note how the files were read, when all have been: what was recognised."""
    for sentence in frames.notes():
        screen.note(one_line(with_options(f"{frames.layout}: {sentence}")))


def default_class_of(frames: FrameSet, description: RecordingDescription) -> str | None:
    """The class of labels that carry none; None if the layout has no such labels."""
    from filter_core.formats.registry import layout_format

    has_some = "default_class" in layout_format(frames.layout).read_options
    return description.default_class if has_some else None


def naming_reading(detail: str, *, of_dataset: bool = False) -> str:
    """The error of a frame with the options of the settings that it recommends.

    `of_dataset`: the options hold only for a dataset without frames.
    """
    where = " in the settings of a dataset that has frames" if of_dataset else ""

    def named(match: re.Match[str]) -> str:
        name, value = match.groups()
        return f"--{name.replace('_', '-')} {value} ({match.group()}{where})"

    return with_options(_READING_SETTING.sub(named, detail))


def with_options(text: str) -> str:
    """A sentence with options for the keys of a description that it names.

    An option stands in place of a key, or behind it where the file is named, too.
    """

    def named(match: re.Match[str]) -> str:
        key, below, value = match["key"], match["below"], match["value"] or ""
        option: str | None = "--class-map"
        if key != "classes":
            from filter_core.formats.recording import place_in_file

            place = f"{key}.{below}" if below else key
            names = ("layout", "classes", *_DESCRIBING, *SEGMENTATION_SETTINGS)
            options = (name for name in names if place_in_file(name) == place)
            option = next((f"--{name.replace('_', '-')}" for name in options), None)
        if option is None:
            return match.group()
        if option == "--class-map" and below:
            value = f"{below}={match['of']}"
        elif below:
            value = match["of"].strip("[]").replace(", ", ",")
        words = f"{option} {value}".rstrip()
        return f"{match.group()} ({words})" if match["file"] else words

    return _KEY.sub(named, text)


def kind_of(problem: FilterError) -> str:
    """Which problems are alike when they are listed: by the code of the first fault."""
    from filter_core.errors import problem_of

    return f"refused ({problem_of(problem)['errors'][0]['code']})"


def unmatched_lines(files: Iterable[Unmatched]) -> Iterator[str]:
    """Lines for files that belong to no frame; of each kind the first ten."""
    from filter_core.formats.reading import kind_of_reason

    kinds = Kinds()
    for file in files:
        if kinds.is_listed(f"not matched: {kind_of_reason(file.why)}"):
            yield one_line(f"not matched: {file.path}: {file.why}")
    yield from kinds.more()
