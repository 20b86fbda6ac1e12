"""The description of a recording: how its folder is read.

Each key is declared once, as a field of `RecordingDescription`, with the values that it
allows and its meaning. `describe` makes a description from ``recording.yaml`` beside
the data, or from a file that was named, and from options, which win over the file.

Readers of folders take the description. What it says about segmentations, depth and
classes is for the filter: `RecordingDescription.config_keys`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import (
    TYPE_CHECKING,
    ClassVar,
    Final,
    Literal,
    NamedTuple,
    TypeAlias,
    get_args,
)

import yaml

from filter_core.config.declaration import (
    INHERIT,
    AllowedWords,
    declared_keys,
    key,
    moved,
    placed,
    refuse_unknown_keys,
    wrong_value,
)
from filter_core.config.file import merged_classes, parse_yaml
from filter_core.config.filter import DecideConfig, object_schema
from filter_core.config.keys import ReadingKeys
from filter_core.errors import ConfigError, LayoutError
from filter_core.evidence_numbers import DepthEncoding
from filter_core.formats.reading import (
    RECORDING_NAME,
    is_inside,
    read_label_bytes,
    real_paths,
)
from filter_core.formats.splits import SplitSource
from filter_core.formats.tables.cameras import AllowedCameras, CameraPlaces
from filter_core.formats.tables.fields import AllowedFields, BoxFields
from filter_core.formats.tables.patterns import (
    LABELS,
    AllowedFiles,
    AllowedKeyPattern,
    FilePattern,
    FilePatterns,
)
from filter_core.segmentation.reading import Encoding, Lossy, OrderOfChannels, TagScale
from filter_core.values import pointer_token, prefix_of, shown

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

LAYOUTS: Final = (
    "auto",
    "yolo",
    "coco",
    "kitti",
    "voc",
    "cvat",
    "label-studio",
    "manifest",
    "decisions-jsonl",
    "carlasimu",
    "nuscenes",
    "table",
    "pairs",
)
"""The formats that a folder can be read in, and ``auto`` to recognise it.

Those of plug-ins, which installed packages add, are not among them (`AllowedLayout`).
"""

Origin: TypeAlias = Literal["auto", "0", "1"]

Unit: TypeAlias = Literal["auto", "pixels", "shares", "percent"]

Corners: TypeAlias = Literal["auto", "xyxy", "inclusive", "xywh", "cxcywh"]

_MAX_NAMES: Final = 100_000

_MAX_NAME: Final = 1000


class AllowedName(NamedTuple):
    """A text that is not empty, such as ``a class name``."""

    what: str

    def __str__(self) -> str:
        return self.what

    def checked(self, name: str, value: object, at: str = "") -> str:
        if not isinstance(value, str) or not 0 < len(value) <= _MAX_NAME:
            raise wrong_value(name, value, self, at)
        return value

    def schema(self) -> dict[str, object]:
        return {"type": "string", "minLength": 1, "maxLength": _MAX_NAME}


class ClassNames:
    """The names of the classes by their numbers."""

    def __str__(self) -> str:
        return "a list of class names"

    def checked(self, name: str, value: object, at: str = "") -> tuple[str, ...]:
        """See `Allowed.checked`.

        Of names by number, the numbers between them are called as they are.
        """
        if isinstance(value, Mapping) and value:
            numbers = [int(key) if str(key).isdecimal() else -1 for key in value]
            if min(numbers) >= 0 and max(numbers) < _MAX_NAMES:
                names = dict(zip(numbers, value.values(), strict=True))
                value = [
                    names.get(number, str(number)) for number in range(max(numbers) + 1)
                ]
        if not isinstance(value, list | tuple) or not 0 < len(value) <= _MAX_NAMES:
            raise wrong_value(name, value, self, at)
        class_name = AllowedName("a class name")
        return tuple(
            class_name.checked(str(number), word, f"{at}/{name}")
            for number, word in enumerate(value)
        )

    def schema(self) -> dict[str, object]:
        text = {"type": "string"}
        named = {"type": "object", "additionalProperties": text, "minProperties": 1}
        return {"anyOf": [{"type": "array", "items": text, "minItems": 1}, named]}


COMPANIONS: Final = "companions"
"""The key for the files of a recording that are of no frame."""

NAME: Final = "name"
"""The option of a class that is joined to another one, whose name it is."""


def measured_classes(class_map: Mapping[str, object]) -> dict[str, object]:
    """A class map as ``classes`` of a configuration, which knows no `NAME`."""
    measured = {
        name: {key: value for key, value in options.items() if key != NAME}
        if isinstance(options, Mapping)
        else options
        for name, options in class_map.items()
    }
    return {name: options for name, options in measured.items() if options != {}}


class ClassMap:
    """What classes measure as: the ``classes`` of a configuration."""

    def __str__(self) -> str:
        return "a mapping of class names, as a configuration has it"

    def checked(self, name: str, value: object, at: str = "") -> dict[str, object]:
        if not isinstance(value, Mapping):
            raise wrong_value(name, value, self, at)
        name_of_class = AllowedName("a class name")
        for class_name, options in value.items():
            if isinstance(options, Mapping) and NAME in options:
                place = f"{at}/{name}/{pointer_token(class_name)}"
                name_of_class.checked(NAME, options[NAME], place)
        # Its form is checked here, whatever was given.
        make: Callable[..., DecideConfig] = DecideConfig
        make(classes=measured_classes(value))
        return dict(value)

    def schema(self) -> dict[str, object]:
        return {"type": "object"}


class AllowedCounts:
    """Numbers of files by folder."""

    def __str__(self) -> str:
        return "numbers of files by the path of their folder"

    def checked(self, name: str, value: object, at: str = "") -> dict[str, int]:
        items = value.items() if isinstance(value, Mapping) else [("", value)]
        counts = {
            str(folder): count
            for folder, count in items
            if isinstance(count, int) and not isinstance(count, bool) and count > 0
        }
        if len(counts) < len(items) or not all(
            0 < len(folder) <= _MAX_NAME for folder in counts
        ):
            raise wrong_value(name, value, self, at)
        return counts

    def schema(self) -> dict[str, object]:
        number = {"type": "integer", "minimum": 1}
        return {"type": "object", "additionalProperties": number}


class AllowedOrigin:
    """Whether pixels are counted from 0 or from 1."""

    def __str__(self) -> str:
        return "auto, 0 or 1"

    def checked(self, name: str, value: object, at: str = "") -> str:
        is_number = isinstance(value, int) and not isinstance(value, bool)
        word = str(value) if is_number else value
        return AllowedWords(get_args(Origin)).checked(name, word, at)

    def schema(self) -> dict[str, object]:
        # Not one `enum`: some generators of clients take only values of one type.
        return {"anyOf": [{"const": "auto"}, {"enum": [0, 1]}]}


_PLUGINS: Final = "unghost.formats"
"""The group of the entry points by which packages name formats of their own.

The name of each is that of its format. Nothing is imported here but these names;
`filter_core.formats.registry` imports the formats when a folder is read that may have
one of them.
"""


@cache
def plugin_entries() -> Sequence[EntryPoint]:
    """The entry points of all installed packages, by name and package."""
    # A tenth of the time that the library needs to be imported.
    from importlib.metadata import entry_points

    return sorted(
        entry_points(group=_PLUGINS), key=lambda entry: (entry.name, package_of(entry))
    )


def package_of(entry: EntryPoint) -> str:
    """The package of an entry point, with its version."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value


def known_layouts(word: object) -> tuple[str, ...]:
    """`LAYOUTS`; also the names of plug-ins, if none of them is this word.

    Those of plug-ins with a fault are among them.
    """
    if word in LAYOUTS:
        return LAYOUTS
    return (*LAYOUTS, *dict.fromkeys(entry.name for entry in plugin_entries()))


class AllowedLayout:
    """One of `LAYOUTS`, or the name of a plug-in's format."""

    def __str__(self) -> str:
        return str(AllowedWords(known_layouts(None)))

    def checked(self, name: str, value: object, at: str = "") -> str:
        return AllowedWords(known_layouts(value)).checked(name, value, at)

    def schema(self) -> dict[str, object]:
        return {"anyOf": [AllowedWords(LAYOUTS).schema(), {"type": "string"}]}


_OF_READING: Final = declared_keys(ReadingKeys)


@dataclass(frozen=True, kw_only=True)
class RecordingDescription:
    """How a folder of frames is read; what is not given is recognised from its files.

    Wrong values raise `ConfigError` when the object is made.

    Attributes
    ----------
    outside_files : bool or None
        Whether files outside the folder are read if a manifest, labels or a symbolic
        link in the folder name them. By default they are refused: a folder that
        somebody else made could name private files, which would then be uploaded. So no
        file of the folder can say this, nor `roots`. None: this machine's files are not
        looked for, since the folder is that of another one; its manifest may name any.
    roots : tuple of Path
        Folders whose files may be read besides those in the folder.
    recorder : str
        The public recorder whose recordings it describes, if it came with the product.

    All other attributes are declared keys, with their meaning (`described_keys`).
    """

    layout: str = key(
        AllowedLayout(), "auto", "How the files of the folder are arranged."
    )
    segmentation: Path | None = placed(
        "segmentation.folder",
        AllowedName("the path of a folder"),
        None,
        "The folder of the segmentations, if it is not one of the usual ones.",
    )
    palette: str = moved("segmentation.palette", _OF_READING["palette"])
    encoding: Encoding = moved("segmentation.encoding", _OF_READING["encoding"])
    channel_order: OrderOfChannels = moved(
        "segmentation.channel_order", _OF_READING["channel_order"]
    )
    lossy_segmentation: Lossy = moved(
        "segmentation.lossy", _OF_READING["lossy_segmentation"]
    )
    tags: Mapping[str, str] = moved("segmentation.tags", _OF_READING["tags"])
    tag_scale: TagScale = moved("segmentation.scale", _OF_READING["tag_scale"])
    depth_encoding: DepthEncoding = moved(
        "depth.encoding", _OF_READING["depth_encoding"]
    )
    labels: Path | None = placed(
        "boxes.labels",
        AllowedName("the path of a folder"),
        None,
        "The folder of the labels (for COCO the file), if it is not the layout's own.",
    )
    classes: tuple[str, ...] | None = placed(
        "boxes.classes",
        ClassNames(),
        None,
        "The names of the classes in the order of their numbers.",
    )
    default_class: str = placed(
        "boxes.default_class",
        AllowedName("a class name"),
        "unknown",
        "The class of labels that carry none.",
    )
    origin: Origin = placed(
        "boxes.origin",
        AllowedOrigin(),
        "auto",
        "Whether rectangles in whole pixels are counted from 0 or from 1.",
    )
    unit: Unit = placed(
        "boxes.unit",
        AllowedWords(get_args(Unit)),
        "auto",
        "The unit of rectangles, if it is not the format's own; shares and percent "
        "are those of the image's width and height.",
    )
    corners: Corners = placed(
        "boxes.corners",
        AllowedWords(get_args(Corners)),
        "auto",
        "What the four numbers of a rectangle are, if not what the format says: "
        "two corners, two corners of which the last is a pixel of the box, a "
        "corner and the size, or the centre and the size.",
    )
    files: FilePatterns = key(
        AllowedFiles(),
        FilePatterns(),
        "Where the files of frames are: patterns of paths below the folder by role.",
    )
    key: FilePattern | None = placed(
        "key",
        AllowedKeyPattern(),
        None,
        "How frames are called, if `files` says where.",
    )
    fields: BoxFields = placed(
        "boxes.fields",
        AllowedFields(),
        BoxFields(),
        "Which column or which path (JMESPath) of a table is what of a box.",
    )
    cameras: CameraPlaces = placed(
        "cameras",
        AllowedCameras(),
        CameraPlaces(),
        "Where the cameras of 3D boxes stand, and how they see.",
    )
    class_map: Mapping[str, object] = placed(
        "classes",
        ClassMap(),
        MappingProxyType({}),
        "What the filter measures a class as: the name of another class, `pass` "
        "for boxes that are passed on unmeasured, or options as in `classes` of a "
        "configuration; `name` among them joins it to a class of that name.",
    )
    map: str = placed(
        "map",
        AllowedName("the name of a map, auto or none"),
        "auto",
        "The map of CARLA that frames were recorded in; by default what labels, or "
        "names of folders and files, say.",
    )
    split: SplitSource = placed(
        "split",
        AllowedWords(get_args(SplitSource)),
        "auto",
        "What tells the parts of the recording, such as train and val: lists of "
        "names, the names of COCO's files, names of folders; `none`: nothing.",
    )
    companions: Mapping[str, int] = placed(
        COMPANIONS,
        AllowedCounts(),
        MappingProxyType({}),
        "How many files of no frame each folder has, which a server does not get; "
        "counted by an upload.",
    )
    outside_files: bool | None = False
    roots: tuple[Path, ...] = ()
    recorder: str = ""

    _FOLDERS: ClassVar = ("segmentation", "labels")

    def __post_init__(self) -> None:
        for name, declared in declared_keys(type(self)).items():
            value = getattr(self, name)
            if value is INHERIT or value is None:
                value = declared.default
            elif name not in self._FOLDERS:
                value = declared.allowed.checked(name, value)
            object.__setattr__(self, name, value)

    @property
    def own_layout(self) -> str:
        """The layout, or the only one that can use what is described; else ``auto``."""
        if self.layout != "auto" or not {*_OF_TABLE} & self.changed.keys():
            return self.layout
        changed = self.changed.keys() & {*_OF_TABLE}
        if changed <= {"files"} and LABELS not in self.files.roles:
            return "auto"  # roles of images, which every layout uses
        are_images = changed <= {"files", "key"} and LABELS not in self.files.roles
        return "pairs" if are_images else "table"

    @property
    def changed(self) -> dict[str, object]:
        """The keys whose values are not their defaults, by attribute."""
        return {
            name: value
            for name, declared in declared_keys(type(self)).items()
            if (value := getattr(self, name)) != declared.default
        }

    def config_keys(self) -> dict[str, object]:
        """What it says about measuring, as keys of a configuration.

        A configuration's own values win over these (`load_config`).
        """
        keys = {
            name: value for name, value in self.changed.items() if name in _OF_READING
        }
        classes = measured_classes(self.class_map)
        return {**keys, **({"classes": classes} if classes else {})}

    @property
    def class_names(self) -> dict[str, str]:
        """The names of classes that are joined to others, each with the other's."""
        return {
            name: str(options[NAME])
            for name, options in self.class_map.items()
            if isinstance(options, Mapping) and NAME in options
        }

    def segmentation_settings(self) -> dict[str, str]:
        """What it says about segmentations, as settings of a dataset."""
        return {
            name: str(value)
            for name, value in self.changed.items()
            if name in DATASET_SETTINGS
        }


_OF_TABLE: Final = ("files", "key", "fields", "cameras")

DATASET_SETTINGS: Final = ("palette", "encoding", "channel_order", "lossy_segmentation")
"""Keys of a configuration that are settings of a dataset, too."""

READER_KEYS: Final = frozenset(
    {"segmentation", "labels", "classes", "default_class", "origin", *_OF_TABLE}
)
"""The keys that only some layouts use; each `Format` says which."""


def place_in_file(name: str) -> str:
    """The key in a file for an attribute, such as ``boxes.classes`` for ``classes``."""
    return declared_keys(RecordingDescription)[name].place or name


def describe(
    source: Path, file: Path | None = None, options: Mapping[str, object] | None = None
) -> RecordingDescription:
    """The description of a recording, from a file and from options.

    Parameters
    ----------
    source : Path
        The folder, or the file that is read.
    file : Path, optional
        The description. Default: ``recording.yaml`` in the folder or beside the file,
        if there is one. Only a file that is named here may name folders elsewhere.
    options : mapping, optional
        Values by attribute, which win over those of the file; class maps are merged.

    Raises
    ------
    LayoutError
        The file cannot be read, has an unknown key, one that is not supported yet, or a
        wrong value; names file and key.
    ConfigError
        An option has a wrong value.
    """
    folder = source if source.is_dir() else source.parent
    beside = folder / RECORDING_NAME
    path = file or (beside if beside.is_file() else None)
    described = {} if path is None else _values(path, folder, is_named=file is not None)
    chosen = dict(options or {})
    below, above = described.get("class_map"), chosen.get("class_map")
    if isinstance(below, Mapping) and isinstance(above, Mapping):
        chosen["class_map"] = merged_classes(below, above)
    make: Callable[..., RecordingDescription] = RecordingDescription
    return make(**{**described, **chosen})


def values_of(document: object) -> dict[str, object]:
    """The values of a description by attribute, from what its YAML holds.

    Raises `ConfigError`: an unknown key, one that is not supported yet, or a wrong
    value.
    """
    declared = declared_keys(RecordingDescription)
    by_place = {setting.place or name: name for name, setting in declared.items()}
    values = {}
    for name, section in _section(document, "", by_place):
        is_key = name in by_place
        keys = [(name, section)] if is_key else _section(section, name, by_place)
        for place, value in keys:
            *above, last = place.split(".")
            at = "".join(f"/{part}" for part in above)
            attribute = by_place[place]
            values[attribute] = declared[attribute].allowed.checked(last, value, at)
    return values


def description_schema() -> dict[str, object]:
    """The JSON schema of what a description's file holds."""
    sections: dict[str, dict[str, object]] = {"": {}}
    for name, setting in declared_keys(RecordingDescription).items():
        section, _, last = (setting.place or name).rpartition(".")
        schema = {**setting.allowed.schema(), "description": setting.sentence}
        sections.setdefault(section, {})[last] = schema
    top = sections.pop("")
    below = {name: object_schema(keys) for name, keys in sections.items()}
    return {
        "title": RecordingDescription.__name__,
        "description": "How a folder of frames is read; every key is optional.",
        **object_schema({**top, **below}),
    }


def description_text(description: RecordingDescription, folder: Path) -> str:
    """A description as YAML, which `describe` reads back; see `description_document`.

    It is empty if all is recognised.
    """
    document = description_document(description, folder)
    if not document:
        return ""
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True)


def description_document(
    description: RecordingDescription, folder: Path
) -> dict[str, object]:
    """What the file of a description holds.

    Parameters
    ----------
    description : RecordingDescription
        Keys that have their default values are left out, and so are the files outside
        the folder that it allows, since no file of the folder can say this.
    folder : Path
        That of the recording, to which paths in it are relative.
    """
    document: dict[str, object] = {}
    for name, value in description.changed.items():
        *sections, last = place_in_file(name).split(".")
        place = document
        for section in sections:
            below = place.setdefault(section, {})
            assert isinstance(below, dict), "a section is no key itself"
            place = below
        place[last] = _plain(value, folder)
    return document


def _plain(value: object, folder: Path) -> object:
    """A value as YAML has it."""
    if isinstance(value, Path):
        there, root = value.absolute(), folder.absolute()
        inside = there.is_relative_to(root)
        return there.relative_to(root).as_posix() if inside else str(there)
    if isinstance(value, FilePattern):
        return value.text
    if isinstance(value, FilePatterns | BoxFields | CameraPlaces):
        value = value.document
    if isinstance(value, Mapping):
        return {key: _plain(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        unnamed = [each == str(number) for number, each in enumerate(value)]
        if any(unnamed):  # numbers without names are called as they are
            named = enumerate(value)
            return {number: each for number, each in named if not unnamed[number]}
        return [_plain(each, folder) for each in value]
    return value


def _values(path: Path, folder: Path, *, is_named: bool) -> dict[str, object]:
    """The values of a file by attribute; paths are relative to the folder."""
    try:
        values = values_of(parse_yaml(read_label_bytes(path, path.name)))
    except ConfigError as exc:
        raise LayoutError(
            f"{path.name}: {exc.detail}", pointer=exc.pointer, code=exc.kind
        ) from exc
    for name in RecordingDescription._FOLDERS:
        if name in values:
            text, there = shown(values[name]), folder / str(values[name])
            place = f"{path.name}: {place_in_file(name)}"
            if not there.exists():
                raise LayoutError(
                    f"{place}: expected a folder, found none named {text}"
                )
            if not is_named and not is_inside(there, real_paths(folder)):
                raise LayoutError(
                    f"{place}: expected a folder in that of the recording, found "
                    f"{text}; --recording FILE names a description that you trust"
                )
            values[name] = there
    return values


def _section(
    section: object, name: str, by_place: Mapping[str, str]
) -> Iterator[tuple[str, object]]:
    """The keys of one mapping by their full names, without those whose value is null.

    Raises `ConfigError`: an unknown key, or no mapping.
    """
    at = f"/{name}" if name else ""
    if section is None:
        return
    if not isinstance(section, Mapping):
        raise ConfigError(
            f"{prefix_of(at)}expected a mapping of keys, found {shown(section)}",
            pointer=at,
        )
    prefix = f"{name}." if name else ""
    inside = (place for place in by_place if place.startswith(prefix))
    valid = dict.fromkeys(place.removeprefix(prefix).split(".")[0] for place in inside)
    for word, value in section.items():
        refuse_unknown_keys([word], valid, at=at)
        if value is not None:
            yield f"{prefix}{word}", value
