"""Makes boxes, as annotations have them, of rows whose fields are known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from filter_core.errors import LayoutError
from filter_core.formats.tables.fields import (
    FORMS_BY_FIELDS,
    FRAMES,
    GEOMETRY_FIELDS,
    ROTATION,
    USUAL_LISTS,
    BoxFields,
    Path,
    forms_of,
    recognised_fields,
    transform_of,
    value_at,
    vector_of,
)
from filter_core.formats.tables.rows import Row
from filter_core.geometry.projection import image_corners_xyxy
from filter_core.values import shown


class BoxReader:
    """Makes boxes of rows.

    Parameters
    ----------
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

    def check_columns(self, columns: Sequence[str], at: str) -> None:
        """Refuse a table that lacks columns which were named.

        Raises `LayoutError`: names all of them.
        """
        row = dict.fromkeys(columns, "")
        lacking = [
            f"{path.text} ({name})"
            for name, path in self._fields.paths.items()
            if not path.begins_in(row)
        ]
        if lacking:
            raise LayoutError(
                f"{at}: expected the columns that `boxes.fields` names, found none "
                f"called {', '.join(lacking)}, only {', '.join(columns)[:200]}"
            )

    def value(self, name: str, row: object) -> object:
        """The value of a field; None if a row has none."""
        path = self._fields.paths.get(name)
        if path is not None:
            return path.of(row)
        where = recognised_fields(row).get(name)
        return None if where is None else value_at(row, where)

    def frames_in(self, document: object, at: str) -> Iterator[tuple[object, Row]]:
        """What a value of JSON has of many frames, each with its name or None.

        They are the items of a list, or the values of an object by the frames' names,
        or the rows of all their boxes. Raises `LayoutError`: there is no list where one
        was expected.
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
            return any(isinstance(rows, list) for rows in lists)
        return self._usual_list(value) is not None

    def boxes_in(self, document: object, at: str) -> Iterator[tuple[str, Row]]:
        """The rows of boxes in one value of JSON, each with the class of its list.

        Raises `LayoutError`: there is no list of boxes where one was expected.
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
        text = shown(document)
        if isinstance(document, Mapping):
            text = f"an object of {', '.join(map(str, document))[:200] or 'nothing'}"
        raise LayoutError(
            f"{at}: expected a list of boxes, found {text}; `boxes: {{fields: "
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
        lists = [value for value in document.values() if isinstance(value, list)]
        for name in USUAL_LISTS:
            rows = document.get(name)
            if isinstance(rows, list):
                are_values = bool(rows) and not isinstance(rows[0], Mapping)
                if len(lists) == 1 or not are_values:
                    return rows
        return None

    def _columns(self, document: Mapping[str, object], at: str) -> list[object] | None:
        """Rows from lists that have one value of each box, such as NPZ's arrays."""
        names = {**recognised_fields(document), **self._fields.paths}
        if not forms_of(self._geometry_names(names)):
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
            sizes = (f"{name} {len(column)}" for name, column in columns.items())
            raise LayoutError(
                f"{at}: expected as many values of each field, found {', '.join(sizes)}"
            )
        rows = zip(*columns.values(), strict=True)
        return [_Cells(zip(columns, row, strict=True)) for row in rows]

    def _geometry_names(self, names: Mapping[str, object]) -> set[str]:
        """Of a form that was named, or of those that are usual."""
        named = GEOMETRY_FIELDS & self._fields.paths.keys()
        return named or {*names}

    def box(self, row: Row, class_name: str = "") -> dict[str, object] | None:
        """The box of a row, as an annotation has it; None if it has no rectangle.

        Raises `LayoutError`: a value cannot be read; names its place and column.
        """
        if row.problem is not None:
            raise row.problem
        names: Mapping[str, object] = recognised_fields(row.value)
        if isinstance(row.value, _Cells):
            names = row.value
        names = {**names, **self._fields.paths}
        forms = forms_of(self._geometry_names(names))
        if not forms:
            raise LayoutError(
                f"{row.at}: expected a rectangle or a 3D box, found "
                f"{_keys_of(row.value)}; `boxes: {{fields: ...}}` in recording.yaml "
                "says which column or path is what"
            )
        cells = _Row(self, row, names, self._corners)
        with_values = (form for form in forms if cells.has_values(form))
        geometry = cells.geometry(next(with_values, forms[0]))
        if geometry is None:
            self.left_out += 1
            return None
        return {**self._about(cells, class_name), **geometry}

    def cell(self, name: str, row: object) -> object:
        """The value of a field in a row; None if it is empty."""
        value = row.get(name) if isinstance(row, _Cells) else self.value(name, row)
        return _filled(value)

    def is_region(self, row: object) -> bool:
        """Whether a row is a region to be ignored, and no object."""
        return self.cell("region", row) in (True, 1, "1", "true", "True")

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


def _filled(value: object) -> object:
    """The value of a cell; None if it is an empty text."""
    return None if isinstance(value, str) and not value.strip() else value


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
        where, row = self.names.get(name), self.row.value
        if where is None:
            return None
        if isinstance(row, _Cells):
            return _filled(row.get(name))
        if isinstance(where, Path):
            return _filled(where.of(row))
        return _filled(value_at(row, where) if isinstance(where, tuple) else None)

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

    def has_values(self, form: str) -> bool:
        """Whether a field of a form of boxes has a value."""
        return any(self.value(name) is not None for name in FORMS_BY_FIELDS[form])

    def geometry(self, form: str) -> dict[str, object] | None:
        """The rectangle or the 3D box under its key in an annotation."""
        values = [self.value(name) for name in FORMS_BY_FIELDS[form]]
        if not self.has_values(form):
            self._refuse_absent(form)
            return None
        if form == "box3d":
            box: dict[str, object] = {
                "location": self._vector("centre", self.value("centre"), "xyz"),
                "extent": self._vector("extent", self.value("extent"), "xyz"),
            }
            rotation, actor = self.value("rotation"), self.value("actor")
            if rotation is not None:
                box["rotation"] = self._vector("rotation", rotation, ROTATION)
            if actor is not None:
                box["transform"] = self._transform(actor)
            return {form: box}
        if form == "vertices":
            return {form: self._corners("world_corners")}
        if form == "image_corners":
            corners = self._corners(form)
            (xyxy,) = image_corners_xyxy([corners]).tolist()
            return None if math.isnan(xyxy[0]) else {"xyxy": xyxy}
        if len(values) == 1:
            (name,) = FORMS_BY_FIELDS[form]
            return {self._notation(name, values[0]): self._rectangle(name, values[0])}
        needed = zip(FORMS_BY_FIELDS[form], values, strict=True)
        return {form: [self._number(name, value) for name, value in needed]}

    def _refuse_absent(self, form: str) -> None:
        """An empty rectangle is none; one that is looked for elsewhere is a mistake."""
        for name in FORMS_BY_FIELDS[form]:
            path = self.names[name]
            if isinstance(path, Path) and not path.begins_in(self.row.value):
                keys = _keys_of(self.row.value)
                raise LayoutError(
                    f"{self.row.at}: expected {name} under {path.text}, found {keys}"
                )

    def _notation(self, name: str, value: object) -> str:
        """What a list of four numbers is; two points are corners."""
        is_points = isinstance(value, list) and len(value) == 2
        if name != "rectangle" or is_points:
            return "xyxy" if is_points else name
        if self.corners != "auto":
            return "xyxy" if self.corners == "inclusive" else self.corners
        raise self.error(
            name,
            value,
            "a rectangle whose notation is known: `boxes: {corners: xyxy}` in "
            "recording.yaml says it, or `xywh` or `cxcywh` in its place",
        )

    def _rectangle(self, name: str, value: object) -> list[float]:
        """Four numbers, or two points; also written as text."""
        items: list[object] = []
        if isinstance(value, str):
            items += value.strip("[]() ").replace(",", " ").split()
        elif isinstance(value, list):
            lists = (item if isinstance(item, list) else [item] for item in value)
            items += chain.from_iterable(lists)
        if len(items) != 4:
            raise self.error(name, value, "a list of four numbers")
        return [self._number(name, item) for item in items]

    def _corners(self, name: str) -> list[list[float]]:
        value = self.value(name)
        if isinstance(value, list) and len(value) == 8:
            points = [self._vector(name, item, "xyz") for item in value]
            return [list(point.values()) for point in points]
        raise self.error(name, value, "a list of eight corners of three numbers")

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


def _keys_of(value: object) -> str:
    if not isinstance(value, Mapping):
        return shown(value)
    return f"only {', '.join(map(str, value))[:200] or 'nothing'}"
