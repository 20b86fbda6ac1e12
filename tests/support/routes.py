"""All routes of the service, and the role that each must require."""

import re
from collections.abc import Iterator, Mapping

from fastapi import APIRouter
from fastapi.routing import APIRoute
from starlette.routing import BaseRoute

from app.main import ROUTERS
from unghost.wire.words import Role

NO_ROLE = None
V1 = "/api/v1"
DATASET = f"{V1}/datasets/{{dataset}}"
Operation = tuple[str, str]

REQUIRED_ROLES: dict[Operation, Role | None] = {
    ("GET", "/"): NO_ROLE,
    ("GET", "/static/{name:path}"): NO_ROLE,
    ("GET", "/healthz"): NO_ROLE,
    ("GET", "/readyz"): NO_ROLE,
    ("POST", f"{V1}/session"): NO_ROLE,
    ("GET", "/docs"): NO_ROLE,
    ("GET", "/openapi.json"): NO_ROLE,
    # Needs no token, but a key that is valid for one file.
    ("GET", f"{V1}/exports/{{export_id}}/file"): NO_ROLE,
}
_READING = {
    *("/version", "/metrics"),
    *(f"{V1}/login-codes/{{code_id}}",),
    *(f"{V1}/session", f"{V1}/datasets", DATASET, f"{V1}/configs/{{digest}}"),
    *(
        f"{DATASET}/{what}"
        for what in (
            *("stats", "histogram", "problems", "quality"),
            *("report", "coached"),
        )
    ),
    *(f"{DATASET}/{what}" for what in ("frames", "frames/{key:any}", "runs")),
    *(f"{DATASET}/{what}" for what in ("exports", "evaluations", "configs", "config")),
    *(f"{DATASET}/parts", f"{DATASET}/experiment"),
    f"{DATASET}/versions",
    *(f"{V1}/frames/{{frame_id}}", f"{V1}/boxes", f"{V1}/boxes/{{box_id}}"),
    *(f"{V1}/boxes/{what}" for what in ("table", "crops")),
    f"{V1}/runs",
    *(f"{V1}/boxes/{{box_id}}/{what}" for what in ("crop", "history")),
    *(f"{V1}/boxes/{{box_id}}/{what}" for what in ("alike", "track", "slice")),
    *(f"{V1}/runs/{{run_id}}{what}" for what in ("", "/events", "/diff")),
    *(f"{V1}/exports/{{export_id}}{what}" for what in ("", "/events", "/download")),
    *(f"{V1}/frames/{{frame_id}}/{what}" for what in ("thumbnail", "overlay")),
    f"{V1}/frames/{{frame_id}}/{{kind}}",
}
_WRITING = {
    *(("POST", f"{V1}/datasets"), ("PATCH", DATASET)),
    *((method, f"{DATASET}/classes/{{name:any}}") for method in ("PATCH", "DELETE")),
    *(("PUT", f"{DATASET}/frames/{{key:any}}"), ("POST", f"{DATASET}/batches")),
    *(("DELETE", f"{DATASET}/frames/{{key:any}}"), ("POST", f"{DATASET}/queue")),
    *(("POST", f"{DATASET}/configs"), ("PUT", f"{DATASET}/config")),
    *(("POST", f"{DATASET}/runs"), ("POST", f"{V1}/runs/{{run_id}}/cancel")),
    *(("POST", f"{DATASET}/exports"), ("POST", f"{V1}/exports/{{export_id}}/cancel")),
    *(("DELETE", f"{V1}/exports/{{export_id}}"), ("POST", f"{DATASET}/preview")),
    *(("POST", f"{DATASET}/evaluations"), ("PUT", f"{DATASET}/experiment")),
    *(("POST", f"{V1}/boxes/{{box_id}}/reviews"), ("POST", f"{V1}/reviews/bulk")),
    *(("POST", f"{V1}/boxes/{{box_id}}/reviews/{{revision}}/undo"),),
    *(("POST", f"{V1}/review-batches/{{batch_id}}/undo"),),
    *(("POST", f"{DATASET}/known-frames"), ("POST", f"{V1}/folders")),
}
_ADMINISTRATION = {
    *(("DELETE", DATASET), ("GET", f"{V1}/audit"), ("GET", f"{V1}/tokens")),
    ("POST", f"{DATASET}/reviews/import"),
    *(("GET", f"{V1}/hooks"), ("POST", f"{V1}/hooks")),
    *(("DELETE", f"{V1}/hooks/{{hook_id}}"), ("POST", f"{V1}/hooks/{{hook_id}}/ping")),
    ("GET", f"{V1}/hooks/{{hook_id}}/deliveries"),
    *(("POST", f"{V1}/tokens"), ("DELETE", f"{V1}/tokens/{{token_id}}")),
}
REQUIRED_ROLES |= {("GET", path): "viewer" for path in _READING}
_OWN_ACCESS = {
    *(("DELETE", f"{V1}/session"), ("POST", f"{V1}/login-codes")),
    ("POST", f"{V1}/exports/{{export_id}}/download-links"),
}
REQUIRED_ROLES |= dict.fromkeys(_OWN_ACCESS, "viewer")
REQUIRED_ROLES |= dict.fromkeys(_WRITING, "reviewer")
REQUIRED_ROLES |= dict.fromkeys(_ADMINISTRATION, "admin")


def every_route() -> Iterator[APIRoute]:
    """The routes of all modules, including those that OpenAPI does not list."""
    for router in ROUTERS:
        yield from _below(router.routes)


def _below(routes: list[BaseRoute]) -> Iterator[APIRoute]:
    for route in routes:
        inner = getattr(route, "original_router", None)
        if isinstance(inner, APIRouter):
            yield from _below(inner.routes)
        else:
            assert isinstance(route, APIRoute), route
            yield route


def operations(route: APIRoute) -> set[Operation]:
    """Pairs of each method of a route and its path."""
    return {(method, route.path) for method in route.methods or ()}


def fill_path(path: str, values: Mapping[str, object]) -> str:
    """A path with its parameters filled in."""
    return re.sub(r"{(.*?)}", lambda match: str(values[match[1]]), path)


def values_of_paths(number: int) -> dict[str, object]:
    """A value for each parameter of any path; all ids are `number`."""
    ids = (
        "box_id",
        "revision",
        "frame_id",
        "run_id",
        "export_id",
        "token_id",
        "code_id",
        "hook_id",
    )
    return {
        **dict.fromkeys((*ids, "batch_id"), number),
        "digest": "0" * 64,
        "kind": "image",
        "dataset": "street",
        "key": "a",
        "key:any": "a/b",
        "name:any": "car",
        "name": "a",
        "name:path": "js/main.js",
    }
