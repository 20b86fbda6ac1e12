"""Which column of a row, or which path in a JSON value, is what of a box.

A description says it under ``boxes.fields``; columns and keys under their usual names
(``xmin``, ``label``) are recognised without it. A path is a JMESPath. Vectors and poses
are read in the forms in which people's files have them.

References
----------
.. [1] The specification of JMESPath, https://jmespath.org/specification.html
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple

import jmespath
from jmespath.exceptions import JMESPathError

from filter_core.config.declaration import refuse_unknown_keys, wrong_value
from filter_core.errors import ConfigError
from filter_core.values import prefix_of

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
    "map": "map mapname town townname",
    "camera": "camera cameraname cameraid cam sensor sensorname",
    "x1": "x1 xmin minx left bboxx1 bboxxmin bboxleft xtl xleft leftx umin u1 "
    "tlx xtl xtopleft topleftx bbleft "
    "startx xstart",
    "y1": "y1 ymin miny top bboxy1 bboxymin bboxtop ytl ytop topy vmin v1 "
    "tly ytl ytopleft toplefty bbtop "
    "starty ystart",
    "x2": "x2 xmax maxx right bboxx2 bboxxmax bboxright xbr xright rightx umax u2 "
    "brx xbottomright bottomrightx "
    "endx xend",
    "y2": "y2 ymax maxy bottom bboxy2 bboxymax bboxbottom ybr ybottom bottomy vmax "
    "bry ybottomright bottomrighty "
    "v2 endy yend",
    "cx": "cx xcenter xcentre centerx centrex xc",
    "cy": "cy ycenter ycentre centery centrey yc",
    "width": "width w bboxwidth bboxw boxwidth bbwidth",
    "height": "height h bboxheight bboxh boxheight bbheight",
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
    "region": "",
}
"""By field: its usual names in lower case, without what separates words."""

_LEFT: Final = {"x1": "x bboxx boxx", "y1": "y bboxy boxy"}
"""Usual only beside a width and a height: without them it may be a position."""

USUAL_LISTS: Final = (
    *("boxes", "objects", "annotations", "labels", "bboxes", "bounding_boxes"),
    *("boundingboxes", "detections", "instances", "actors"),
)
"""Usual names of the list of a frame's boxes."""

FIELDS: Final = (FRAMES, BOXES, *_USUAL)

FORMS_BY_FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
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
"""Forms of a box by the fields that they need; the first that has values is taken."""

_OF_BOX3D: Final = ("rotation", "actor")

GEOMETRY_FIELDS: Final = {
    *_OF_BOX3D,
    *(name for of in FORMS_BY_FIELDS.values() for name in of),
}

_MAX_PATH: Final = 500

_SEPARATORS: Final = re.compile(r"[\W_]+")

_UNIT: Final = re.compile(r"[\W_]*\b(?:px|pixels?)\W*$|_px$", re.IGNORECASE)
"""What a name of a column may end with: ``x_min (px)``."""


class Path(NamedTuple):
    """Where a value is in a row: a column or key of this name, else a JMESPath."""

    text: str

    def of(self, row: object) -> object:
        """The value; None if there is none."""
        if isinstance(row, dict) and self.text in row:
            return row[self.text]
        try:
            value: object = _compiled(self.text).search(row)
        except JMESPathError:  # such as a function of a text that gets a number
            return None
        return value

    def begins_in(self, row: object) -> bool:
        """Whether a row has the key that the path begins with."""
        if not isinstance(row, Mapping):
            return False
        begin = _IDENTIFIER.match(self.text)
        if begin is None or self.text[begin.end() :].startswith("("):
            return True  # an expression, which may use any key
        return self.text in row or begin[0] in row


_IDENTIFIER: Final = re.compile(r"[A-Za-z_]\w*")


@lru_cache(4096)
def _compiled(text: str) -> jmespath.parser.ParsedResult:
    return jmespath.compile(text)


def checked_path(name: str, value: object, at: str) -> Path:
    """A path as a description has it; a number is that of a column without a name.

    Raises `ConfigError`: it is no text, or no JMESPath.
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
            raise wrong_value(name, value, f"{expected}: {why}", at) from exc
        return Path(text)
    raise wrong_value(name, value, expected, at)


@dataclass(frozen=True)
class BoxFields:
    """``boxes.fields`` of a description: where each of `FIELDS` is.

    `lists` are those of boxes by the class of all boxes in them; "" if boxes say it.
    """

    paths: Mapping[str, Path] = field(default_factory=dict)
    lists: Mapping[str, Path] | None = None

    @property
    def document(self) -> dict[str, object]:
        """What a description says."""
        paths: dict[str, object] = {
            name: path.text for name, path in self.paths.items()
        }
        if self.lists is None:
            return paths
        lists = {name: path.text for name, path in self.lists.items()}
        return {**paths, BOXES: lists.get("", lists)}


class AllowedFields:
    """What is where in a row."""

    def __str__(self) -> str:
        return "names of columns or paths (JMESPath) by what they are"

    def checked(self, name: str, value: object, at: str = "") -> BoxFields:
        if isinstance(value, BoxFields):
            return value
        if not isinstance(value, Mapping):
            raise wrong_value(name, value, str(self), at)
        place = f"{at}/{name}"
        refuse_unknown_keys(value, FIELDS, at=place)
        paths = {
            field: checked_path(field, path, place)
            for field, path in value.items()
            if path is not None and field != BOXES
        }
        # Fields of a geometry must be all that it needs; several geometries may be
        # said, if boxes of one file have different ones.
        named = GEOMETRY_FIELDS & paths.keys()
        whole = {each for form in forms_of(named) for each in FORMS_BY_FIELDS[form]}
        if not named <= {*whole, *(_OF_BOX3D if "centre" in whole else ())}:
            forms = "; ".join(", ".join(of) for of in FORMS_BY_FIELDS.values())
            raise ConfigError(
                f"{prefix_of(place)}expected the fields of one form of boxes ({forms}),"
                f" found {', '.join(each for each in _USUAL if each in named)}",
                pointer=place,
            )
        lists = value.get(BOXES)
        if lists is None:
            return BoxFields(paths)
        if not isinstance(lists, Mapping):
            return BoxFields(paths, {"": checked_path(BOXES, lists, place)})
        if not lists or not all(
            isinstance(class_name, str) and class_name for class_name in lists
        ):
            expected = "a path, or paths by the class of boxes"
            raise wrong_value(BOXES, lists, expected, place)
        by_class = {
            class_name: checked_path(class_name, path, f"{place}/{BOXES}")
            for class_name, path in lists.items()
        }
        return BoxFields(paths, by_class)

    def schema(self) -> dict[str, object]:
        path = {"type": ["string", "integer"]}
        return {
            "type": "object",
            "properties": {
                BOXES: {"type": ["string", "object"]},
                **dict.fromkeys((FRAMES, *_USUAL), path),
            },
            "additionalProperties": False,
        }


Keys = tuple[str, ...]
"""The keys that lead to a value: one, or that of an object and one in it."""


@lru_cache(1024)
def _recognised(keys: tuple[Keys, ...]) -> Mapping[str, Keys]:
    """The fields that are there under their usual names."""
    by_name: dict[str, Keys] = {}
    for where in keys:
        name = _SEPARATORS.sub("", _UNIT.sub("", where[-1])).lower()
        by_name.setdefault(name, where)
    fields = {
        name: by_name[word]
        for name, words in _USUAL.items()
        for word in reversed(words.split())
        if word in by_name
    }
    if {"x0", "y0", "x1", "y1"} <= by_name.keys() and not {"x2", "y2"} & fields.keys():
        # The corners are counted from 0.
        fields |= {
            corner: by_name[name]
            for corner, name in zip(
                ("x1", "y1", "x2", "y2"), ("x0", "y0", "x1", "y1"), strict=True
            )
        }
    if {"width", "height"} <= fields.keys():
        for name, words in _LEFT.items():
            spelling = next((word for word in words.split() if word in by_name), None)
            if name not in fields and spelling is not None:
                fields[name] = by_name[spelling]
    return fields


@lru_cache(1024)
def _recognised_flat(keys: tuple[object, ...]) -> Mapping[str, Keys]:
    return _recognised(tuple((key,) for key in keys if isinstance(key, str)))


def recognised_fields(row: object) -> Mapping[str, Keys]:
    """What is in a row under its usual name, also in an object such as ``bbox``."""
    # Not `Mapping`, which takes much longer to ask for, and JSON has no other.
    if not isinstance(row, dict):
        return {}
    if not any(isinstance(value, dict) for value in row.values()):
        return _recognised_flat(tuple(row))
    keys: list[Keys] = [(key,) for key in row if isinstance(key, str)]
    for key, value in row.items():
        is_rectangle = _SEPARATORS.sub("", str(key)).lower() in _RECTANGLES
        if is_rectangle and isinstance(value, Mapping):
            keys.remove((key,))
            keys += [(key, name) for name in value if isinstance(name, str)]
    return _recognised(tuple(keys))


_RECTANGLES: Final = frozenset(_USUAL["rectangle"].split())


def forms_of(names: Iterable[str]) -> list[str]:
    """The forms of boxes that are given by fields of these names."""
    own = {*names}
    return [form for form, of in FORMS_BY_FIELDS.items() if own.issuperset(of)]


def value_at(row: object, where: Keys) -> object:
    """The value to which keys lead in a row."""
    for key in where:
        row = row[key] if isinstance(row, dict) else None
    return row


ROTATION: Final = ("pitch", "yaw", "roll")


def vector_of(value: object, keys: Sequence[str]) -> dict[str, float]:
    """An object with these keys, in any case, or a list, as an object of numbers.

    Of a rotation, keys may be missing, and a number alone is its yaw. Raises
    `ValueError`: it is none; says what was expected.
    """
    is_rotation = tuple(keys) == ROTATION
    expected = f"{{{', '.join(keys)}}} or a list of {len(keys)} numbers"
    if is_rotation and (
        isinstance(value, int | float | str) and not isinstance(value, bool)
    ):
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
    numbers = [as_number(item) for item in items]
    if not all(map(math.isfinite, numbers)):
        raise ValueError(expected)
    return dict(zip(keys, numbers, strict=True))


_LOCATIONS: Final = ("location", "translation", "position")


def transform_of(value: object) -> dict[str, float]:
    """Where something stands: x, y, z, pitch, yaw and roll.

    From an object with these keys, or with a location (``translation``, ``position``)
    and a rotation, in any case. Raises `ValueError`: it is none; says what was
    expected.
    """
    if not isinstance(value, Mapping):
        raise ValueError("an object with a location and a rotation")
    own = {str(key).lower(): item for key, item in value.items()}
    place = next((own[name] for name in _LOCATIONS if name in own), None)
    if place is not None:
        location, rotation = vector_of(place, "xyz"), own.get("rotation")
        return {**location, **vector_of(rotation or {}, ROTATION)}
    rotation = {name: own[name] for name in ROTATION if name in own}
    return {**vector_of(own, "xyz"), **vector_of(rotation, ROTATION)}


def as_number(value: object) -> float:
    """A number, also one that is written as text; NaN if it is none."""
    try:
        return float(value) if isinstance(value, int | float | str) else math.nan
    except ValueError:
        return math.nan
