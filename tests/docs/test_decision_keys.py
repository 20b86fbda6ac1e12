"""Every place that defines the keys of a decision has the same keys and types.

The library's definition is the one that the others are compared with.
"""

import re
import types
from typing import Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from pydantic import BaseModel

from app.boxes.reader import StoredDecision
from filter_core.decisions.record import Decision
from filter_core.formats.decisions import COLUMNS
from filter_core.pipeline import SegmentationReport
from filter_core.verdicts import HiddenBy
from tests.support.documents import read
from unghost.wire import boxes, frames

# Keys without a column in tables: rectangles are written as four columns of corners,
# and nested values are left out.
NOT_IN_TABLES = {
    "id",  # the column is called box
    "explanation",
    "evidence",
    "distance_range",
    "xyxy",
    "amodal_xyxy",
    "visible_xyxy",
    "tight_xyxy",
    "visible_pixels",
    "occluded",
    "truncated",
    "edges",
}


def schema_of(model: type[BaseModel]) -> dict[str, object]:
    """The keys of a model's JSON object, and the type of each value."""
    return {
        field.alias or name: json_type(field.annotation)
        for name, field in model.model_fields.items()
    }


def json_type(kind: object) -> object:
    """The JSON type of a Python type.

    Models become the types of their keys, and a `Literal` the type of its values.
    """
    if get_origin(kind) is Literal:
        (literal,) = {type(value) for value in get_args(kind)}
        return literal
    if get_origin(kind) in (Union, types.UnionType):
        return frozenset(json_type(part) for part in get_args(kind))
    if get_origin(kind) in (list, tuple):
        return (list, json_type(get_args(kind)[0]))
    if is_typeddict(kind):
        return tuple(sorted(typed_keys(kind).items(), key=str))
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return tuple(sorted(schema_of(kind).items(), key=str))
    return kind


def typed_keys(kind: object) -> dict[str, object]:
    return {name: json_type(hint) for name, hint in get_type_hints(kind).items()}


def test_types_of_the_api_match_the_library_and_what_is_stored():
    answered = schema_of(boxes.Decision)

    values = {name: answered.get(name) for name in Decision.__annotations__}
    assert values == typed_keys(Decision)
    assert typed_keys(StoredDecision) == answered
    assert typed_keys(HiddenBy) == schema_of(boxes.HiddenBy)
    assert typed_keys(SegmentationReport) == schema_of(frames.SegmentationReport)


def test_tables_have_a_column_for_every_scalar_key():
    assert set(Decision.__annotations__) - set(COLUMNS) == NOT_IN_TABLES


def test_every_decision_key_is_documented():
    section = read("docs/api.md").split("## A decision")[1].split("## ")[0]
    explained = set(re.findall(r"`(\w+)`", section))

    assert set(StoredDecision.__annotations__) - explained == set()
