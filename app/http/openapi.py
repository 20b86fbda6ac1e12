"""The OpenAPI document, with the errors that all routes share, and a page of it."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterable
from html import escape
from http import HTTPStatus
from typing import Any, Final, TypeAlias

from fastapi import FastAPI
from pydantic.json_schema import models_json_schema

from app.http.problems import PROBLEM_TYPE
from filter_core.config.filter import FilterConfig, schema_of
from filter_core.formats.recording import description_schema
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from unghost.wire.annotation import Annotation
from unghost.wire.codes import ERROR_CODES
from unghost.wire.datasets import FilterConfigIn, RecordingIn
from unghost.wire.descriptions import Described, described
from unghost.wire.folders import FolderEnd, FolderFrame, FolderHead, UnmatchedFile
from unghost.wire.frames import BatchEnd, BatchLine
from unghost.wire.model import Problem
from unghost.wire.runs import ConfigVersion, ExportIn

_Object: TypeAlias = dict[str, Any]
"""An object of the document: FastAPI has no types for them."""
_METHODS: Final = ("get", "post", "put", "patch", "delete")


def docs_page(schema: _Object) -> str:
    """All routes by tag, each with its parameters and responses."""
    sections: dict[str, list[str]] = {}
    for path, operations in schema["paths"].items():
        for method in _METHODS:
            if method in operations:
                operation = operations[method]
                tag = (operation.get("tags") or ["other"])[0]
                description = _marked_up(operation.get("description", ""))
                sections.setdefault(tag, []).append(
                    '<details><summary><code><span class="method">'
                    f"{method.upper()}</span>{escape(path)}</code> "
                    f'<span class="brief">{escape(operation.get("summary", ""))}'
                    f"</span></summary><p>{description}</p>"
                    f"{_parameters(operation)}{_responses(operation)}</details>"
                )
    body = "".join(
        f"<h2>{escape(tag)}</h2>{''.join(routes)}"
        for tag, routes in sorted(sections.items())
    )
    title = escape(f"{schema['info']['title']} {schema['info']['version']}")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}: API</title>"
        '<link rel="stylesheet" href="/static/css/docs.css">'
        f"</head><body><main><h1>{title}: API</h1>"
        '<p>For machines: <a href="/openapi.json">openapi.json</a>. Every error is '
        f"<code>application/problem+json</code>.</p>{body}"
        f"<h2>Objects</h2>{_objects(schema)}</main></body></html>"
    )


def _objects(schema: _Object) -> str:
    """Each object of bodies and responses, with its fields and an example of each."""
    return "".join(
        f'<details id="{escape(name)}"><summary><code>{escape(name)}</code> '
        f'<span class="brief">{_marked_up(model.get("description", ""))}</span>'
        "</summary>"
        + _table(
            (
                field if field in model.get("required", ()) else f"{field}, optional",
                _type_of(of_field),
                _with_example(of_field),
            )
            for field, of_field in model["properties"].items()
        )
        + "</details>"
        for name, model in sorted(schema["components"]["schemas"].items())
        if model.get("properties")
    )


def _type_of(schema: _Object) -> str:
    """The type of a value in a few words: ``list of Decision or null``."""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    for several in ("anyOf", "allOf", "oneOf"):
        if several in schema:
            kinds = map(_type_of, schema[several])
            return " or ".join(dict.fromkeys(kinds))
    if "enum" in schema:
        return ", ".join(
            "null" if value is None else str(value) for value in schema["enum"]
        )
    if "const" in schema:
        return str(schema["const"])
    kind = schema.get("type", "any")
    if kind == "array" and "items" in schema:
        return f"list of {_type_of(schema['items'])}"
    return " or ".join(kind) if isinstance(kind, list) else str(kind)


def _with_example(schema: _Object) -> str:
    text = str(schema.get("description", ""))
    if _DEFAULT in schema:
        text += f" Default: {json.dumps(schema[_DEFAULT])}."
    if "examples" in schema:
        text += f" Example: {json.dumps(schema['examples'][0])}"
    return text


def _parameters(operation: _Object) -> str:
    rows = [
        (
            parameter["name"],
            parameter["in"],
            _with_example({**parameter["schema"], **parameter}),
        )
        for parameter in operation.get("parameters", ())
    ]
    for kind, body in operation.get("requestBody", {}).get("content", {}).items():
        schema = body["schema"]
        fields = schema.get("properties", {})
        rows += [("body", kind, "" if fields else _type_of(schema))]
        rows += [
            (name, _type_of(field), _with_example(field))
            for name, field in fields.items()
        ]
    return _table(rows)


def _responses(operation: _Object) -> str:
    """What a route returns; all errors are alike, so they are one row."""
    errors, rows = [], []
    for status, response in sorted(operation["responses"].items()):
        if "description" not in response:
            errors.append(status)
            continue
        contents = response.get("content", {}).values()
        kinds = [
            _type_of(content["schema"]) for content in contents if "schema" in content
        ]
        rows.append((status, response["description"], ", ".join(kinds)))
    if errors:
        rows.append((", ".join(errors), "An error.", "Problem"))
    return _table(rows)


def _table(rows: Iterable[tuple[str, str, str]]) -> str:
    cells = "".join(
        "<tr>" + "".join(f"<td>{_marked_up(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table>{cells}</table>" if cells else ""


def _marked_up(text: str) -> str:
    """A text as HTML, with what is between backticks as code."""
    return _CODE.sub(r"<code>\1</code>", escape(text))


_CODE: Final = re.compile("`([^`]+)`")


_NO_ROUTE_RETURNS: Final = (
    Problem,
    BatchLine,
    BatchEnd,
    FolderHead,
    FolderFrame,
    UnmatchedFile,
    FolderEnd,
)
"""Models that no route returns as a whole: errors, and lines of streams."""
_EVERYWHERE: Final = (400, 404, 408, 421, 422, 431, 500, 503)
_WITH_TOKEN: Final = (401, 403, 429)
_WITH_BODY: Final = (401, 403, 409, 412, 413, 415, 429)
_BODY_METHODS: Final = ("post", "put", "patch", "delete")
IDEMPOTENCY_PARAMETER: Final = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": False,
    "description": "A request repeated with the same key gets the same response, and "
    "is not executed again.",
    "schema": {"type": "string", "pattern": "^[!-~]{1,200}$"},
}
_LARGEST: Final = 2**63 - 1
_DEFAULT: Final = "x-default"
"""In place of `default`, from which generators of clients make required fields, or
fields that are sent although nobody has set them."""
_MAKING: Final = threading.Lock()


def document(app: FastAPI) -> _Object:
    """The OpenAPI document of the service, generated once.

    The first call takes about a second: do not call it on the event loop.
    """
    with _MAKING:
        if app.openapi_schema is None:
            schema = FastAPI.openapi(app)
            _add_components(schema)
            for operations in schema["paths"].values():
                for method, operation in operations.items():
                    _describe_operation(method, operation)
            _make_bounds_whole(schema)
            app.openapi_schema = schema
        return app.openapi_schema


def _add_components(schema: _Object) -> None:
    components = schema.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    _, others = models_json_schema(
        [
            (Annotation, "validation"),
            *((model, "serialization") for model in _NO_ROUTE_RETURNS),
        ],
        ref_template="#/components/schemas/{model}",
    )
    for name, schema_of_model in others["$defs"].items():
        schemas.setdefault(name, schema_of_model)
    # The wire declares it as an object only; the library declares its keys.
    schemas[FilterConfigIn.__name__] = schema_of(FilterConfig)
    schemas[RecordingIn.__name__] = description_schema()
    stored = schemas[ConfigVersion.__name__]["properties"]
    stored["config"] = {"$ref": f"#/components/schemas/{FilterConfigIn.__name__}"}
    # As for formats: the wire has only their names.
    format_field = schemas[ExportIn.__name__]["properties"]["format"]
    format_field["x-titles"] = {name: FORMATS[name].title for name in EXPORT_FORMATS}
    format_field["x-briefs"] = {name: FORMATS[name].brief for name in EXPORT_FORMATS}
    format_field["x-options"] = {
        name: sorted(FORMATS[name].options) for name in EXPORT_FORMATS
    }
    schemas["Problem"]["properties"]["code"]["enum"] = [*ERROR_CODES]
    for name, model_schema in schemas.items():
        for field, of_field in model_schema.get("properties", {}).items():
            _describe(of_field, described(field, name))
            if "default" in of_field:
                of_field[_DEFAULT] = of_field.pop("default")
    content = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    statuses = sorted({*_EVERYWHERE, *_WITH_TOKEN, *_WITH_BODY, 416})
    components["responses"] = {
        f"Problem{status}": {
            "description": HTTPStatus(status).phrase,
            "content": content,
        }
        for status in statuses
    }


def _describe(schema: _Object, said: Described | None) -> None:
    """Add the description and the example, unless the field has them."""
    if said is None:
        return
    schema.setdefault("description", said.text)
    if said.example is not None and not {"example", "examples"} & schema.keys():
        if "in" in schema:  # of a parameter it is another key
            schema["example"] = said.example
        else:
            schema["examples"] = [said.example]


def _describe_operation(method: str, operation: _Object) -> None:
    """Add the errors, and what the parameters mean."""
    responses = operation["responses"]
    statuses = {
        *_EVERYWHERE,
        *(int(status) for status in responses if int(status) >= 400),
    }
    if "security" in operation:
        statuses.update(_WITH_TOKEN)
    if method in _BODY_METHODS:
        statuses.update(_WITH_BODY)
    for status in sorted(statuses):
        reference = f"#/components/responses/Problem{status}"
        responses[str(status)] = {"$ref": reference}
    for parameter in operation.get("parameters", ()):
        _describe(parameter, described(parameter["name"], "BoxSelection"))
    if method == "post":
        operation.setdefault("parameters", []).append(IDEMPOTENCY_PARAMETER)


def _make_bounds_whole(node: object) -> None:
    """Turn the bounds of all integers below a node into integers.

    FastAPI writes them as floats, and 2**63 - 1 is not one: it is rounded up.
    """
    if isinstance(node, list):
        for item in node:
            _make_bounds_whole(item)
    elif isinstance(node, dict):
        for value in node.values():
            _make_bounds_whole(value)
        if node.get("type") == "integer":
            for bound in ("minimum", "maximum"):
                if isinstance(node.get(bound), float):
                    node[bound] = min(int(node[bound]), _LARGEST)
