"""Response models are strict where they are built, and lenient where they are read."""

from collections.abc import Mapping
from datetime import datetime, timedelta, timezone
from typing import Annotated, Literal

import pytest
from pydantic import AwareDatetime, Field, ValidationError

from filter_core import values
from unghost import wire
from unghost.wire.model import (
    MAX_FAULTS,
    Fault,
    IfAbsent,
    MissingKey,
    Page,
    Problem,
    RequestModel,
    ResponseModel,
    SparseModel,
)


class Wheel(ResponseModel):
    """A model that is nested in another one."""

    side: Literal["left", "right"]


class Car(ResponseModel):
    """A model with each kind of field that a response can have."""

    id: int
    class_name: str = Field(alias="class")
    built_at: AwareDatetime | None
    wheels: Annotated[tuple[Wheel, ...], IfAbsent(())]
    by_name: Annotated[Mapping[str, Wheel], IfAbsent({})]


class Order(RequestModel):
    """A model of a request."""

    cars: int = 1


CAR = {"id": 7, "class": "bus"}
EMPTY: dict[str, object] = {"built_at": None, "wheels": (), "by_name": {}}


def test_nested_objects_of_a_response_are_read_as_models():
    wheels = {"wheels": [{"side": "left"}], "by_name": {"a": {"side": 1}}}

    page = Page[Car].read({"items": [{**CAR, **wheels}], "next_cursor": "x"})

    (car,) = page.items
    assert (car.class_name, page.next_cursor) == ("bus", "x")
    assert car.wheels == (Wheel(side="left"),)
    assert isinstance(car.by_name["a"], Wheel)


def test_null_equals_absent_key():
    assert Car.read({**CAR, **EMPTY}) == Car.read(CAR)
    assert Car.read({**CAR, "wheels": None, "by_name": None}) == Car.read(CAR)
    assert Car.read(CAR).by_name is not Car.read(CAR).by_name


@pytest.mark.parametrize("key", ["id", "class"])
def test_missing_or_null_required_key_raises_missing_key(key):
    without = {name: value for name, value in CAR.items() if name != key}

    for raw in (without, {**CAR, key: None}):
        with pytest.raises(MissingKey, match=f"Car lacks '{key}'"):
            Car.read(raw)


def test_reading_accepts_unknown_values_of_a_newer_server():
    assert Wheel.read({"side": "spare"}).side == "spare"  # type: ignore[comparison-overlap]  # mypy believes the words


def test_unknown_keys_are_kept_in_raw_and_ignored_by_equality():
    newer = Car.read({**CAR, "colour": "red"})

    assert newer.raw["colour"] == "red"
    assert newer == Car.read(CAR)
    assert newer != Car.read({**CAR, "id": 8})
    assert "colour" not in repr(newer)


@pytest.mark.parametrize(
    "text",
    ["2026-01-01T00:00:00.5Z", "2026-01-01t00:00:00.5z", "2026-01-01T01:00:00.5+01:00"],
)
def test_rfc_3339_times_are_parsed(text):
    noon = datetime(2026, 1, 1, tzinfo=timezone.utc)

    assert Car.read({**CAR, "built_at": text}).built_at == noon + timedelta(seconds=0.5)
    with pytest.raises(ValueError, match="expected a time of RFC 3339, found 'soon'"):
        Car.read({**CAR, "built_at": "soon"})


def test_response_models_are_frozen_and_hashable_without_mappings():
    car = Car.read(CAR)

    with pytest.raises(ValidationError, match="frozen"):
        car.id = 8  # type: ignore[misc]  # that is what is tested
    with pytest.raises(ValidationError, match="frozen"):
        del car.id
    first, second = Wheel.read({"side": "left", "size": 3}), Wheel(side="left")

    assert {first, second} == {first}


def test_building_a_response_by_field_names_is_validated():
    built = Car(id=7, class_name="bus", built_at=None, wheels=(), by_name={})
    assert built == Car.read(CAR)
    with pytest.raises(ValidationError):
        Wheel(side="spare")
    with pytest.raises(ValidationError, match="Extra inputs are not permitted"):
        Car.model_validate({**CAR, **EMPTY, "colour": "red"})
    with pytest.raises(ValidationError, match="bikes"):
        Order.model_validate({"cars": 1, "bikes": 2})


@pytest.mark.parametrize("missing", ["class_name", *EMPTY])
def test_building_a_response_without_a_field_raises(missing):
    values = {"id": 7, "class_name": "bus", **EMPTY}
    del values[missing]

    with pytest.raises(ValidationError, match="Field required"):
        Car(**values)


def test_response_model_fields_have_no_defaults():
    told = [getattr(wire, name) for name in dir(wire)]
    responses = [
        kind
        for kind in told
        if isinstance(kind, type) and issubclass(kind, ResponseModel)
    ]

    assert len(responses) > 50
    assert [
        f"{kind.__name__}.{name}"
        for kind in responses
        if not issubclass(kind, SparseModel)
        for name, field in kind.model_fields.items()
        if not field.is_required()
    ] == []


def test_responses_and_their_schema_have_all_keys_by_alias():
    schema = Car.model_json_schema(mode="serialization")

    assert Car.read(CAR).model_dump() == {**CAR, **EMPTY}
    assert schema["required"] == [*CAR, *EMPTY]
    assert "default" not in str(schema)
    assert "additionalProperties" not in schema


def test_problem_is_read_and_serialised_with_its_faults():
    fault = {"pointer": "/a", "code": "missing", "detail": "expected a value"}
    raw = {"code": "invalid_request", "detail": "d", "errors": [fault]}

    problem = Problem.read(raw)

    assert str(problem.errors[0]) == "/a: expected a value"
    assert problem.model_dump(mode="json") == {
        "detail": "d",
        "code": "invalid_request",
        "errors": [fault],
    }
    with pytest.raises(MissingKey, match="Problem lacks 'code'"):
        Problem.read({"detail": "d"})
    assert str(Fault(pointer="", code="c", detail="d")) == "d"
    escaped = Fault(pointer="/a\ud800", code="missing", detail="\udfff there")

    assert escaped.model_dump_json() == (
        r'{"pointer":"/a\\ud800","code":"missing","detail":"\\udfff there"}'
    )
    schema = Problem.model_json_schema(mode="serialization")

    assert schema["properties"].keys() - set(schema["required"]) == {
        "more_errors",
        "current",
        "found",
    }
    assert schema["properties"]["status"]["type"] == "integer"
    assert MAX_FAULTS == values.MAX_FAULTS
