"""Which column of a row, or which path in a JSON value, is what of a box.

A description says it under ``boxes.fields``; columns and keys under their usual names
(``xmin``, ``label``) are recognised without it. A path is a JMESPath. `BoxReader` makes
boxes of rows, as annotations have them.

References
----------
.. [1] The specification of JMESPath, https://jmespath.org/specification.html
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple

import jmespath
from jmespath.exceptions import JMESPathError

from filter_core.config.declaration import refuse_unknown_keys
from filter_core.errors import ConfigError, LayoutError
from filter_core.formats.rows import Row
from filter_core.geometry.projection import image_corners_xyxy
from filter_core.values import place_of, shown

FRAMES: Final = "frames"
"""The field that says where the frames are in a file of many."""

BOXES: Final = "boxes"
"""The field that says where the boxes are in a file, or in what it has of a frame."""

_USUAL: Final[Mapping[str, str]] = {
    "id": "id boxid objectid actorid trackid",
    "class": "class classname label labelname category categoryname objectclass "
    "objecttype name type classid labelid categoryid",
    "type_id": "typeid blueprint blueprintid bpid actortype",
    "base_type": "basetype",
    "instance_id": "instanceid",
    "distance": "distance dist distancem",
    "frame": "frame frameid framenumber frameno frameindex image imagename imageid "
    "imagefile imagepath filename file img imgname imageidx",
    "camera": "camera cameraname cameraid cam sensor sensorname",
    "x1": "x1 xmin minx left bboxx1 bboxxmin bboxleft xtl",
    "y1": "y1 ymin miny top bboxy1 bboxymin bboxtop ytl",
    "x2": "x2 xmax maxx right bboxx2 bboxxmax bboxright xbr",
    "y2": "y2 ymax maxy bottom bboxy2 bboxymax bboxbottom ybr",
    "cx": "cx xcenter xcentre centerx centrex xc",
    "cy": "cy ycenter ycentre centery centrey yc",
    "width": "width w bboxwidth bboxw boxwidth",
    "height": "height h bboxheight bboxh boxheight",
    "rectangle": "bbox box boundingbox rect rectangle bbox2d box2d boundingbox2d",
    "xyxy": "xyxy bboxxyxy",
    "xywh": "xywh bboxxywh",
    "cxcywh": "cxcywh bboxcxcywh",
    "centre": "centre center location position",
    "extent": "extent",
    "rotation": "rotation",
    "actor": "actortransform",
    "world_corners": "worldcorners worldvertices vertices",
    "image_corners": "imagecorners",
}
"""By field: its usual names in lower case, without what separates words."""

_LEFT: Final = {"x1": "x bboxx boxx", "y1": "y bboxy boxy"}
"""Usual only beside a width and a height: without them it may be a position."""

_LISTS: Final = (
    *("boxes", "objects", "annotations", "labels", "bboxes", "bounding_boxes"),
    *("boundingboxes", "detections", "instances", "actors"),
)
"""Usual names of the list of a frame's boxes."""

FIELDS: Final = (FRAMES, BOXES, *_USUAL)

_GEOMETRIES: Final[Mapping[str, tuple[str, ...]]] = {
    "xyxy": ("x1", "y1", "x2", "y2"),
    "xywh": ("x1", "y1", "width", "height"),
    "cxcywh": ("cx", "cy", "width", "height"),
    "list xyxy": ("xyxy",),
    "list xywh": ("xywh",),
    "list cxcywh": ("cxcywh",),
    "rectangle": ("rectangle",),
    "image_corners": ("image_corners",),
    "vertices": ("world_corners",),
    "box3d": ("centre", "extent"),
}
"""Forms of a box by the fields that they need; the first that is there is taken."""

_OF_BOX3D: Final = ("rotation", "actor")

_OF_GEOMETRY: Final = {*_OF_BOX3D, *(one for of in _GEOMETRIES.values() for one in of)}

_IS_3D: Final = frozenset({"vertices", "box3d"})

_MAX_PATH: Final = 500

_SEPARATORS: Final = re.compile(r"[\W_]+")


class Path(NamedTuple):
    """Where a value is in a row: a column or key of this name, else a JMESPath."""

    text: str

    def of(self, row: object) -> object:
        """The value; None if there is none."""
        if isinstance(row, Mapping) and self.text in row:
            return row[self.text]
        try:
            found: object = _compiled(self.text).search(row)
        except JMESPathError:  # such as a function of a text that gets a number
            return None
        return found

    def begins_in(self, row: object) -> bool:
        """Whether a row has the key that the path begins with."""
        if not isinstance(row, Mapping):
            return False
        begin = _IDENTIFIER.match(self.text)
        return self.text in row or begin is None or begin[0] in row


_IDENTIFIER: Final = re.compile(r"[A-Za-z_]\w*")


@lru_cache(4096)
def _compiled(text: str) -> jmespath.parser.ParsedResult:
    return jmespath.compile(text)


def checked_path(name: str, value: object, at: str) -> Path:
    """A path as a description has it; a number is that of a column without a name.

    Raises
    ------
    ConfigError
        It is no text, or no JMESPath.
    """
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return Path(f"[{value}]")
    text = value if isinstance(value, str) else ""
    expected = "the name of a column or a path (JMESPath)"
    if 0 < len(text) <= _MAX_PATH:
        try:
            _compiled(text)
        except JMESPathError as exc:
            # Names of columns may be anything; only what looks like a path must be one.
            if set(text).isdisjoint("[{(|&"):
                return Path(text)
            why = str(exc).partition("\n")[0]
            raise _refused(name, value, f"{expected}: {why}", at) from exc
        return Path(text)
    raise _refused(name, value, expected, at)


@dataclass(frozen=True)
class BoxFields:
    """``boxes.fields`` of a description.

    Attributes
    ----------
    paths : mapping of str to Path
        By `FIELDS`.
    lists : mapping of str to Path, or None
        The lists of boxes by the class of all boxes in them; "" if boxes say it.
    """

    paths: Mapping[str, Path] = field(default_factory=dict)
    lists: Mapping[str, Path] | None = None


class AllowedFields:
    """What is where in a row."""

    def __str__(self) -> str:
        return "names of columns or paths (JMESPath) by what they are"

    def checked(self, name: str, value: object, at: str = "") -> BoxFields:
        """See `Allowed.checked`."""
        if isinstance(value, BoxFields):
            return value
        if not isinstance(value, Mapping):
            raise _refused(name, value, str(self), at)
        place = f"{at}/{name}"
        refuse_unknown_keys(value, FIELDS, at=place)
        paths = {
            one: checked_path(one, path, place)
            for one, path in value.items()
            if path is not None and one != BOXES
        }
        _check_geometry(paths, place)
        lists = value.get(BOXES)
        if lists is None:
            return BoxFields(paths)
        if not isinstance(lists, Mapping):
            return BoxFields(paths, {"": checked_path(BOXES, lists, place)})
        if not lists or not all(isinstance(one, str) and one for one in lists):
            expected = "a path, or paths by the class of boxes"
            raise _refused(BOXES, lists, expected, place)
        by_class = {
            one: checked_path(one, path, f"{place}/{BOXES}")
            for one, path in lists.items()
        }
        return BoxFields(paths, by_class)

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`."""
        path = {"type": ["string", "integer"]}
        return {
            "type": "object",
            "properties": {
                BOXES: {"type": ["string", "object"]},
                **dict.fromkeys((FRAMES, *_USUAL), path),
            },
            "additionalProperties": False,
        }


def _check_geometry(paths: Mapping[str, Path], at: str) -> None:
    """Fields of a geometry must be those of one, and all that it needs."""
    named = _OF_GEOMETRY & paths.keys()
    if not named:
        return
    for needed in _GEOMETRIES.values():
        allowed = {*needed, *(_OF_BOX3D if "centre" in needed else ())}
        if named <= allowed and named >= {*needed}:
            return
    raise ConfigError(
        f"{place_of(at)}expected the fields of one form of boxes "
        f"({'; '.join(', '.join(of) for of in _GEOMETRIES.values())}), found "
        f"{', '.join(name for name in _USUAL if name in named)}",
        pointer=at,
    )


def _refused(name: str, value: object, expected: str, at: str) -> ConfigError:
    return ConfigError(
        f"{place_of(at)}{name}: expected {expected}, found {shown(value)}",
        pointer=f"{at}/{name}",
    )


_Where = tuple[str, ...]
"""The keys that lead to a value: one, or that of an object and one in it."""


@lru_cache(1024)
def _recognised(keys: tuple[_Where, ...]) -> Mapping[str, _Where]:
    """The fields that are there under their usual names."""
    by_name: dict[str, _Where] = {}
    for where in keys:
        by_name.setdefault(_SEPARATORS.sub("", where[-1]).lower(), where)
    fields = {
        name: by_name[one]
        for name, words in _USUAL.items()
        for one in reversed(words.split())
        if one in by_name
    }
    if {"width", "height"} <= fields.keys():
        for name, words in _LEFT.items():
            found = next((one for one in words.split() if one in by_name), None)
            if name not in fields and found is not None:
                fields[name] = by_name[found]
    return fields


def recognised_fields(row: object) -> Mapping[str, _Where]:
    """What is in a row under its usual name, also in an object such as ``bbox``."""
    if not isinstance(row, Mapping):
        return {}
    keys: list[_Where] = [(key,) for key in row if isinstance(key, str)]
    for key, value in row.items():
        is_rectangle = _SEPARATORS.sub("", str(key)).lower() in _RECTANGLES
        if is_rectangle and isinstance(value, Mapping):
            keys.remove((key,))
            keys += [(key, one) for one in value if isinstance(one, str)]
    return _recognised(tuple(keys))


_RECTANGLES: Final = frozenset(_USUAL["rectangle"].split())


def geometry_of(names: Iterable[str]) -> str | None:
    """The form of boxes that is given by fields of these names."""
    own = {*names}
    return next((one for one, of in _GEOMETRIES.items() if own.issuperset(of)), None)


class BoxReader:
    """Makes boxes of rows.

    Parameters
    ----------
    fields : BoxFields
    classes : sequence of str
        The names of classes that rows have by number.
    default_class : str
        That of rows without one.
    corners : str
        ``boxes.corners`` of the description: what lists of four numbers are.

    Attributes
    ----------
    left_out : int
        Rows without a rectangle: empty ones, and boxes behind the camera.
    """

    def __init__(
        self,
        fields: BoxFields,
        classes: Sequence[str] = (),
        default_class: str = "unknown",
        corners: str = "auto",
    ) -> None:
        self._fields, self._classes = fields, classes
        self._default_class, self._corners = default_class, corners
        self.left_out = 0

    def value(self, name: str, row: object) -> object:
        """The value of a field; None if a row has none."""
        path = self._fields.paths.get(name)
        if path is not None:
            return path.of(row)
        where = recognised_fields(row).get(name)
        return None if where is None else _at(row, where)

    def frames_in(self, document: object, at: str) -> Iterator[tuple[object, Row]]:
        """What a value of JSON has of many frames, each with its name or None.

        They are the items of a list, or the values of an object by the frames' names,
        or the rows of all their boxes.

        Raises
        ------
        LayoutError
            There is no list where one was expected.
        """
        path = self._fields.paths.get(FRAMES)
        frames = document if path is None else path.of(document)
        if isinstance(frames, Mapping):
            named = self.value("frame", frames)
            is_one = named is not None and not isinstance(named, list)
            are_columns = isinstance(named, list)
            if is_one or not (are_columns or self.holds_boxes(frames)):
                items = {None: frames}.items() if is_one else frames.items()
                for name, value in items:
                    yield name, Row(at if is_one else f"{at}, {shown(name)}", value)
                return
            for _, row in self.boxes_in(frames, at):
                yield None, row
            return
        if not isinstance(frames, list):
            where = at if path is None else f"{at}, {path.text}"
            raise LayoutError(f"{where}: expected a list, found {shown(frames)}")
        for number, value in enumerate(frames):
            yield None, Row(f"{at}, item {number}", value)

    def holds_boxes(self, value: object) -> bool:
        """Whether a value has a list of boxes, and is not one itself."""
        if not isinstance(value, Mapping):
            return isinstance(value, list) and isinstance(next(iter(value), {}), dict)
        if self._fields.lists is not None:
            lists = (path.of(value) for path in self._fields.lists.values())
            return any(isinstance(one, list) for one in lists)
        return self._usual_list(value) is not None

    def boxes_in(self, document: object, at: str) -> Iterator[tuple[str, Row]]:
        """The rows of boxes in one value of JSON, each with the class of its list.

        Raises
        ------
        LayoutError
            There is no list of boxes where one was expected.
        """
        for class_name, rows in self._lists(document, at):
            for number, row in enumerate(rows):
                place = f" of {class_name}" if class_name else ""
                yield class_name, Row(f"{at}, box {number}{place}", row)

    def _lists(self, document: object, at: str) -> Iterator[tuple[str, list[object]]]:
        if self._fields.lists is not None:
            yield from self._named_lists(self._fields.lists, document, at)
            return
        if isinstance(document, list):
            yield "", document
            return
        if isinstance(document, Mapping):
            rows = self._usual_list(document)
            if rows is None:
                rows = self._columns(document, at)
            if rows is not None:
                yield "", rows
                return
        found = shown(document)
        if isinstance(document, Mapping):
            found = f"an object of {', '.join(map(str, document))[:200] or 'nothing'}"
        raise LayoutError(
            f"{at}: expected a list of boxes, found {found}; `boxes: {{fields: "
            "{boxes: ...}}}` in recording.yaml says where it is"
        )

    def _named_lists(
        self, lists: Mapping[str, Path], document: object, at: str
    ) -> Iterator[tuple[str, list[object]]]:
        missing = []
        for class_name, path in lists.items():
            rows = path.of(document)
            if isinstance(rows, list):
                yield class_name, rows
            elif rows is None:
                missing.append(path.text)
            else:
                raise LayoutError(
                    f"{at}, {path.text}: expected a list of boxes, found {shown(rows)}"
                )
        if len(missing) == len(lists):
            raise LayoutError(
                f"{at}: expected a list of boxes under {' or '.join(missing)}, found "
                "none"
            )

    def _usual_list(self, document: Mapping[str, object]) -> list[object] | None:
        """The list of boxes under a usual name.

        A list with one value of each box, beside lists of others, is a column.
        """
        lists = [one for one in document.values() if isinstance(one, list)]
        for name in _LISTS:
            rows = document.get(name)
            if isinstance(rows, list):
                are_values = bool(rows) and not isinstance(rows[0], Mapping)
                if len(lists) == 1 or not are_values:
                    return rows
        return None

    def _columns(self, document: Mapping[str, object], at: str) -> list[object] | None:
        """Rows from lists that have one value of each box, such as NPZ's arrays."""
        names = {**recognised_fields(document), **self._fields.paths}
        if geometry_of(self._geometry_names(names)) is None:
            return None
        columns = {
            name: column
            for name in names
            if isinstance(column := self.value(name, document), list)
        }
        if not columns:
            return [document]
        lengths = {len(column) for column in columns.values()}
        if len(lengths) > 1:
            sizes = (f"{name} {len(one)}" for name, one in columns.items())
            raise LayoutError(
                f"{at}: expected as many values of each field, found {', '.join(sizes)}"
            )
        rows = zip(*columns.values(), strict=True)
        return [_Cells(zip(columns, row, strict=True)) for row in rows]

    def _geometry_names(self, names: Mapping[str, object]) -> set[str]:
        """Of a form that was named, or of those that are usual."""
        named = _OF_GEOMETRY & self._fields.paths.keys()
        return named or {*names}

    def box(self, row: Row, class_name: str = "") -> dict[str, object] | None:
        """The box of a row, as an annotation has it; None if it has no rectangle.

        Raises
        ------
        LayoutError
            A value cannot be read; names its place and column.
        """
        if row.problem is not None:
            raise row.problem
        names: Mapping[str, object] = recognised_fields(row.value)
        if isinstance(row.value, _Cells):
            names = row.value
        names = {**names, **self._fields.paths}
        form = geometry_of(self._geometry_names(names))
        if form is None:
            raise LayoutError(
                f"{row.at}: expected a rectangle or a 3D box, found "
                f"{_keys_of(row.value)}; `boxes: {{fields: ...}}` in recording.yaml "
                "says which column or path is what"
            )
        cells = _Row(self, row, names, self._corners)
        geometry = cells.geometry(form)
        if geometry is None:
            self.left_out += 1
            return None
        return {**self._about(cells, class_name), **geometry}

    def cell(self, name: str, row: object) -> object:
        """The value of a field in a row; None if it is empty."""
        value = row.get(name) if isinstance(row, _Cells) else self.value(name, row)
        return None if isinstance(value, str) and not value.strip() else value

    def _about(self, cells: _Row, class_name: str) -> dict[str, object]:
        box: dict[str, object] = {}
        for name in ("id", "type_id", "base_type"):
            if (value := cells.name(name)) is not None:
                box[name] = value
        for name in ("instance_id", "distance"):
            if (number := cells.number(name)) is not None:
                whole = name == "instance_id" and number == int(number)
                box[name] = int(number) if whole else number
        named = self._class_of(cells)
        # A number says less than a blueprint.
        if named is not None and not (isinstance(named, int) and "type_id" in box):
            box["class"] = str(named)
        elif class_name or "type_id" not in box:
            box["class"] = class_name or self._default_class
        return box

    def _class_of(self, cells: _Row) -> str | int | None:
        """The class of a row: its name, or its number if the names are not known."""
        named = cells.name("class")
        if not isinstance(named, int) or not self._classes:
            return named
        if 0 <= named < len(self._classes):
            return self._classes[named]
        last = len(self._classes) - 1
        raise cells.error("class", named, f"a class from 0 to {last}")


class _Cells(dict[str, object]):
    """A row whose values are by field already."""


@dataclass(frozen=True)
class _Row:
    """The values of one row by field, checked."""

    reader: BoxReader
    row: Row
    names: Mapping[str, object]
    corners: str

    def value(self, name: str) -> object:
        return self.reader.cell(name, self.row.value) if name in self.names else None

    def error(self, name: str, value: object, expected: str) -> LayoutError:
        where = self.names.get(name)
        column = name
        if isinstance(where, Path):
            column = where.text
        elif isinstance(where, tuple):
            column = ".".join(where)
        return LayoutError(
            f"{self.row.at}, column {column}: expected {expected}, found {shown(value)}"
        )

    def name(self, name: str) -> str | int | None:
        """A text, or a whole number, also one that is written as text."""
        value = self.value(name)
        if isinstance(value, float) and value.is_integer():
            return int(value)
        if value is None or isinstance(value, bool):
            return None
        if isinstance(value, int):
            return value
        if not isinstance(value, str):
            raise self.error(name, value, "a text or a whole number")
        text = value.strip()
        is_class = name == "class" and text.removesuffix(".0").isdecimal()
        return int(text.removesuffix(".0")) if is_class else text

    def number(self, name: str) -> float | int | None:
        value = self.value(name)
        return None if value is None else self._number(name, value)

    def _number(self, name: str, value: object) -> float | int:
        if isinstance(value, str):
            try:
                value = int(value) if value.strip().isdecimal() else float(value)
            except ValueError:
                raise self.error(name, value, "a number") from None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(name, value, "a number")
        if not math.isfinite(value):
            raise self.error(name, value, "a finite number")
        return value

    def geometry(self, form: str) -> dict[str, object] | None:
        """The rectangle or the 3D box under its key in an annotation."""
        values = [self.value(name) for name in _GEOMETRIES[form]]
        if all(value is None for value in values):
            self._refuse_absent(form)
            return None
        if form == "box3d":
            return {form: self._box3d()}
        if form == "vertices":
            return {form: self._corners("world_corners")}
        if form == "image_corners":
            corners = self._corners(form)
            (xyxy,) = image_corners_xyxy([corners]).tolist()
            return None if math.isnan(xyxy[0]) else {"xyxy": xyxy}
        if len(values) == 1:
            (name,) = _GEOMETRIES[form]
            return {self._notation(name, values[0]): self._rectangle(name, values[0])}
        needed = zip(_GEOMETRIES[form], values, strict=True)
        return {form: [self._number(name, value) for name, value in needed]}

    def _refuse_absent(self, form: str) -> None:
        """An empty rectangle is none; one that is looked for elsewhere is a mistake."""
        for name in _GEOMETRIES[form]:
            path = self.names[name]
            if isinstance(path, Path) and not path.begins_in(self.row.value):
                found = _keys_of(self.row.value)
                raise LayoutError(
                    f"{self.row.at}: expected {name} under {path.text}, found {found}"
                )

    def _notation(self, name: str, value: object) -> str:
        """What a list of four numbers is; two points are corners."""
        is_points = isinstance(value, list) and len(value) == 2
        if name != "rectangle" or is_points:
            return "xyxy" if is_points else name
        if self.corners != "auto":
            return self.corners
        raise self.error(
            name,
            value,
            "a rectangle whose notation is known; say it in recording.yaml: `boxes: "
            "{corners: xyxy}`, `xywh` or `cxcywh` (--corners)",
        )

    def _rectangle(self, name: str, value: object) -> list[float]:
        """Four numbers, or two points."""
        items = _flat(value)
        if len(items) != 4:
            raise self.error(name, value, "a list of four numbers")
        return [self._number(name, item) for item in items]

    def _corners(self, name: str) -> list[list[float]]:
        value = self.value(name)
        if isinstance(value, list) and len(value) == 8:
            points = [self._vector(name, item, "xyz") for item in value]
            return [list(point.values()) for point in points]
        raise self.error(name, value, "a list of eight corners of three numbers")

    def _box3d(self) -> dict[str, object]:
        box: dict[str, object] = {
            "location": self._vector("centre", self.value("centre"), "xyz"),
            "extent": self._vector("extent", self.value("extent"), "xyz"),
        }
        rotation, actor = self.value("rotation"), self.value("actor")
        if rotation is not None:
            box["rotation"] = self._vector("rotation", rotation, _ROTATION)
        if actor is not None:
            box["transform"] = self._transform(actor)
        return box

    def _transform(self, value: object) -> dict[str, float]:
        try:
            return transform_of(value)
        except ValueError as exc:
            raise self.error("actor", value, str(exc)) from exc

    def _vector(
        self, name: str, value: object, keys: Sequence[str]
    ) -> dict[str, float]:
        try:
            return vector_of(value, keys)
        except ValueError as exc:
            raise self.error(name, value, str(exc)) from exc


_ROTATION: Final = ("pitch", "yaw", "roll")


def vector_of(value: object, keys: Sequence[str]) -> dict[str, float]:
    """An object with these keys, in any case, or a list, as an object of numbers.

    Of a rotation, keys may be missing, and a number alone is its yaw.

    Raises
    ------
    ValueError
        It is none; says what was expected.
    """
    is_rotation = tuple(keys) == _ROTATION
    expected = f"{{{', '.join(keys)}}} or a list of {len(keys)} numbers"
    if is_rotation and _is_plain_number(value):
        value = {"yaw": value}
    if isinstance(value, Mapping):
        own = {str(key).lower(): item for key, item in value.items()}
        items = [own.get(key, 0.0 if is_rotation else None) for key in keys]
        if is_rotation and not own.keys() & {*keys} and own:
            raise ValueError(expected)
    else:
        items = value if isinstance(value, list) else []
    if len(items) != len(keys):
        raise ValueError(expected)
    numbers = [_as_number(item) for item in items]
    if not all(map(math.isfinite, numbers)):
        raise ValueError(expected)
    return dict(zip(keys, numbers, strict=True))


_LOCATIONS: Final = ("location", "translation", "position")


def transform_of(value: object) -> dict[str, float]:
    """Where something stands: x, y, z, pitch, yaw and roll.

    From an object with these keys, or with a location (``translation``, ``position``)
    and a rotation, in any case.

    Raises
    ------
    ValueError
        It is none; says what was expected.
    """
    if not isinstance(value, Mapping):
        raise ValueError("an object with a location and a rotation")
    own = {str(key).lower(): item for key, item in value.items()}
    place = next((own[name] for name in _LOCATIONS if name in own), None)
    if place is not None:
        location, rotation = vector_of(place, "xyz"), own.get("rotation")
        return {**location, **vector_of(rotation or {}, _ROTATION)}
    rotation = {name: own[name] for name in _ROTATION if name in own}
    return {**vector_of(own, "xyz"), **vector_of(rotation, _ROTATION)}


def _as_number(value: object) -> float:
    """A number, also one that is written as text; NaN if it is none."""
    try:
        return float(value) if isinstance(value, int | float | str) else math.nan
    except ValueError:
        return math.nan


def _is_plain_number(value: object) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def _flat(value: object) -> list[object]:
    """The items of a list, also of lists in it, or of one written as text."""
    if isinstance(value, str):
        return [*value.strip("[]() ").replace(",", " ").split()]
    if not isinstance(value, list):
        return []
    return [
        inner
        for item in value
        for inner in (item if isinstance(item, list) else [item])
    ]


def _at(row: object, where: _Where) -> object:
    for key in where:
        row = row[key] if isinstance(row, Mapping) else None
    return row


def _keys_of(value: object) -> str:
    if not isinstance(value, Mapping):
        return shown(value)
    return f"only {', '.join(map(str, value))[:200] or 'nothing'}"
