"""The API described for people: made from the OpenAPI document, without a script."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any, Final

_METHODS: Final = ("get", "post", "put", "patch", "delete")


def docs_page(schema: Mapping[str, Any]) -> str:
    """All routes by tag, each with its parameters and answers."""
    sections: dict[str, list[str]] = {}
    for path, operations in schema["paths"].items():
        for method in _METHODS:
            if method in operations:
                operation = operations[method]
                tag = (operation.get("tags") or ["other"])[0]
                routes = sections.setdefault(tag, [])
                routes.append(_route(method, path, operation))
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
        f"<code>application/problem+json</code>.</p>{body}</main></body></html>"
    )


def _route(method: str, path: str, operation: Mapping[str, Any]) -> str:
    description = escape(operation.get("description", ""))
    return (
        f'<details><summary><code><span class="method">{method.upper()}</span>'
        f"{escape(path)}</code> "
        f'<span class="brief">{escape(operation.get("summary", ""))}</span></summary>'
        f"<p>{description}</p>{_parameters(operation)}{_answers(operation)}</details>"
    )


def _parameters(operation: Mapping[str, Any]) -> str:
    rows = [
        (one["name"], one["in"], one.get("description", ""))
        for one in operation.get("parameters", ())
    ]
    rows += [("body", kind, "") for kind in _body_types(operation)]
    return _table(rows)


def _body_types(operation: Mapping[str, Any]) -> list[str]:
    return list(operation.get("requestBody", {}).get("content", {}))


def _answers(operation: Mapping[str, Any]) -> str:
    return _table(
        (status, answer.get("description", "problem"), "")
        for status, answer in operation["responses"].items()
    )


def _table(rows: Iterable[tuple[str, str, str]]) -> str:
    cells = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table>{cells}</table>" if cells else ""
