"""The base classes of requests and responses, pages of lists, and problem documents.

A response can come into being in two ways:

- Built by its fields, ``Run(id=7, ...)``, as any model of pydantic. That is strict:
  every field must be given, every value is checked, and unknown keys are refused, so
  that the service cannot send what is not described.
- Read from JSON, ``Run.read(raw)``, which the client does. That is lenient, because the
  service may be older or newer: values are not checked, unknown keys are kept in `raw`,
  and an absent key has the value of its `IfAbsent`. It is also fast, because lists have
  thousands of objects: how a class is read is found out once (`_plan_of`), and `read`
  then sets the four attributes in which pydantic keeps an object's state, which are
  `__dict__` (the fields' values), `__pydantic_fields_set__`, `__pydantic_extra__` and
  `__pydantic_private__` (what is no field, such as `raw`).

Of the JSON that a service of this version sends, both ways make equal objects; a test
compares them for every response (`assert_matches_model`). What is no field is neither
compared nor sent.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from functools import cache, partial
from typing import (
    Annotated,
    Any,
    Final,
    Generic,
    NamedTuple,
    Protocol,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    runtime_checkable,
)

from pydantic import (
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    model_serializer,
)
from pydantic.config import JsonDict
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue

Json: TypeAlias = Mapping[str, Any]
"""An object of JSON, as `json` reads it."""
ItemT = TypeVar("ItemT")
ResponseT = TypeVar("ResponseT", bound="ResponseModel")

optional: Final = partial(Field, default=None)
"""A field that may be left out, or be null, with this `description`."""


class MissingKey(ValueError):
    """A JSON object lacks a required key."""


class RequestModel(BaseModel):
    """Base of requests; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)


class IfAbsent(NamedTuple):
    """The value that the client uses for a key that an older service does not send."""

    value: object


def _open(schema: JsonDict) -> None:
    # A newer service may send more, which the client lets pass.
    schema.pop("additionalProperties", None)


class ResponseModel(BaseModel):
    """Base of responses: frozen; objects with equal fields are equal.

    No field has a default: the service sets every field. If a key is absent, the client
    reads the field's `IfAbsent`.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        populate_by_name=True,
        serialize_by_alias=True,
        json_schema_extra=_open,
    )

    @property
    def raw(self) -> Json:
        """The JSON object as received, with unknown keys; empty if it was not read."""
        read: dict[str, Json] = self.__pydantic_private__ or {}
        return read.get("raw", {})

    @classmethod
    def read(cls: type[ResponseT], raw: Json) -> ResponseT:
        """Read a JSON object that the service sent, without checking its values.

        Null is the same as absent: None where the field may be null, else `IfAbsent`.
        Unknown values and keys are kept as they are; times become `datetime`, arrays
        tuples, objects their models. Raises MissingKey if a key is not there that is
        needed, and ValueError if a time is none.
        """
        fields, defaults, copied, private = _plan_of(cls)
        values: dict[str, object] = {}
        for name, key, needed, convert in fields:
            value = raw.get(key)
            if value is not None:
                values[name] = value if convert is None else convert(value)
            elif needed:
                raise MissingKey(f"{cls.__name__} lacks {key!r}")
        # As `model_construct`, in a third of the time: lists have thousands of objects.
        made = cls.__new__(cls)
        missing = {name: copy() for name, copy in copied if name not in values}
        _set(made, "__dict__", {**defaults, **missing, **values})
        _set(made, "__pydantic_fields_set__", set(values))
        _set(made, "__pydantic_extra__", None)
        # Declared as a private attribute, it would be made for every object that the
        # service builds, which doubles the time that this takes.
        _set(made, "__pydantic_private__", {**private, "raw": raw})
        return made

    def __eq__(self, other: object) -> bool:
        # pydantic's own compares what is private, too.
        if not isinstance(other, ResponseModel):
            return NotImplemented
        return type(self) is type(other) and self.__dict__ == other.__dict__


def properties_of(schema: JsonDict) -> Iterator[tuple[str, JsonDict]]:
    """The keys of the object that a JSON schema describes, and their schemas."""
    properties = schema["properties"]
    assert isinstance(properties, dict)
    for name, value in properties.items():
        assert isinstance(value, dict)
        yield name, value


def _answered(schema: JsonDict) -> None:
    _open(schema)
    # A default is what the client takes; it is never sent.
    for _, value in properties_of(schema):
        value.pop("default", None)


class SparseModel(ResponseModel):
    """A response that has only those keys whose fields were set."""

    model_config = ConfigDict(json_schema_extra=_answered)

    @model_serializer(mode="wrap")
    def _only_set(self, write: SerializerFunctionWrapHandler) -> dict[str, object]:
        values: dict[str, object] = write(self)
        fields = type(self).model_fields
        keys = {fields[name].alias or name for name in self.model_fields_set}
        return {key: values[key] for key in values if key in keys}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: Json, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        # Of the fields; that of the serializer only says that it gives an object.
        described = dict(core_schema)
        described.pop("serialization", None)
        return handler(described)


class Page(ResponseModel, Generic[ItemT]):
    """One page of a list."""

    items: tuple[ItemT, ...]
    next_cursor: str | None


def _writable(text: object) -> object:
    # JSON can have halves of surrogate pairs, UTF-8 cannot: they become `\\ud800`.
    if not isinstance(text, str):
        return text
    return text.encode("utf-8", "backslashreplace").decode()


Message: TypeAlias = Annotated[str, BeforeValidator(_writable)]
"""Text that may contain parts of the request."""
MAX_FAULTS: Final = 100
"""How many faults a problem lists."""


class Fault(ResponseModel):
    """One error of a request: its place, its code, and what was expected."""

    pointer: Annotated[Message, IfAbsent("")] = Field(
        description="JSON pointer into the body, or /query/name, /path/name."
    )
    code: Annotated[Message, IfAbsent("invalid")]
    detail: Annotated[Message, IfAbsent("")]

    def __str__(self) -> str:
        return f"{self.pointer}: {self.detail}" if self.pointer else self.detail


def never_null(schema: JsonDict) -> None:
    """Declare a field of a `SparseModel` that is omitted instead of being null."""
    forms = schema.pop("anyOf")
    assert isinstance(forms, list)
    for form in forms:
        if isinstance(form, dict) and form != {"type": "null"}:
            schema.update(form)


def _of_an_answer(schema: JsonDict) -> None:
    _answered(schema)
    schema["required"] = [
        "type",
        "title",
        "status",
        "detail",
        "instance",
        "code",
        "request_id",
        "errors",
    ]


class Problem(SparseModel):
    """Why a request failed (RFC 9457): `code` for programs, `detail` for people.

    A response always has the fields down to `errors`, and the others only where they
    apply.
    """

    model_config = ConfigDict(json_schema_extra=_of_an_answer)

    type: str = "about:blank"
    title: str = ""
    status: int | None = optional(json_schema_extra=never_null)
    detail: Message = ""
    instance: str = ""
    code: str
    request_id: str | None = optional(json_schema_extra=never_null)
    errors: tuple[Fault, ...] = Field(
        default=(), json_schema_extra={"maxItems": MAX_FAULTS}
    )
    more_errors: int = Field(
        default=0,
        description="How many errors there are besides those listed; absent if there "
        "are none.",
    )
    current: Json | None = optional(
        description="Of a 412: the object as it is now; null if it is not known."
    )
    found: int | None = optional(
        json_schema_extra=never_null,
        description="Of a 409 `count_changed`: how many boxes there are.",
    )


@runtime_checkable
class _Readable(Protocol):
    """A class whose objects are read from JSON, such as a `ResponseModel`."""

    @classmethod
    def read(cls, raw: Json, /) -> object: ...


_Convert: TypeAlias = Callable[[Any], object]

_Field: TypeAlias = tuple[str, str, bool, "_Convert | None"]
"""Name, key, whether it is needed, and what makes it of JSON's own value, if not it."""
_Plan: TypeAlias = tuple[
    tuple[_Field, ...],
    Mapping[str, object],
    tuple[tuple[str, Callable[[], object]], ...],
    Mapping[str, object],
]

_set: Final = object.__setattr__
_NEEDED: Final = object()


@cache
def _plan_of(cls: type[ResponseModel]) -> _Plan:
    """How a class is read: its fields, and the values of absent keys.

    Then the values that each object needs a copy of, and those of what is no field.
    """
    absent = {name: _if_absent(each) for name, each in cls.model_fields.items()}
    fields = tuple(
        (
            name,
            field.alias or name,
            absent[name] is _NEEDED,
            _converter(field.annotation),
        )
        for name, field in cls.model_fields.items()
    )
    copied = tuple(
        (name, value.copy) for name, value in absent.items() if isinstance(value, dict)
    )
    private = {
        name: attribute.default
        for name, attribute in cls.__private_attributes__.items()
    }
    return fields, absent, copied, private


def _if_absent(field: FieldInfo) -> object:
    for each in field.metadata:
        if isinstance(each, IfAbsent):
            return each.value
    if not field.is_required():
        return field.default
    return None if type(None) in get_args(field.annotation) else _NEEDED


def _converter(hint: object) -> _Convert | None:
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _converter(args[0])
    if origin in (Union, types.UnionType):
        inner = [arg for arg in args if arg is not type(None)]
        return _converter(inner[0]) if len(inner) == 1 else None
    if origin is tuple:
        convert = _converter(args[0])
        if convert is None:
            return tuple
        return lambda values: tuple([convert(value) for value in values])
    if origin in (dict, Mapping):
        of_value = _converter(args[1])
        return of_value and (
            lambda values: {key: of_value(value) for key, value in values.items()}
        )
    if hint in (datetime, AwareDatetime):
        return time_of
    if isinstance(hint, type) and issubclass(hint, _Readable):
        return hint.read
    return None


_TIME: Final = TypeAdapter(datetime)


def time_of(text: str) -> datetime:
    """The time in an RFC 3339 text; ValueError if it is none."""
    try:
        return _TIME.validate_python(text)
    except ValidationError as exc:
        raise ValueError(f"expected a time of RFC 3339, found {text!r}") from exc
