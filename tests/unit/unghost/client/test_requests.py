"""Each method of the client sends the request that the OpenAPI document describes.

Nothing is sent here. The document is the pinned one, which is compared with the
service; the methods that stream, such as `push` and `events`, have tests of their own.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from tests.pins import stored
from tests.support.response_checks import DECISION
from tests.support.sensors import experiment_report
from unghost.client.api import Api
from unghost.client.call import Call, Listing, ListPage, query_of
from unghost.wire import Decision, Selection

DOCUMENT = stored.read("openapi")
SCHEMAS = DOCUMENT["components"]["schemas"]
READ_FROM = {
    "Decision": "BoxPage",
    "Boxes": "BoxPage",
    "int": "BoxPage",
    "Selection": "BoxPage",
    "HistoryEntry": "History",
    "Flip": "Diff",
}
"""Results that are a part of an answer, and the name of that answer."""
STRICT = {"min_visible_pixels": 9}
SELECTION = Selection(dataset="town", filter={"class": "car"}, count=3, snapshot="s")


class Recorder(Api):
    """A client whose methods return what they would send."""

    def _send(self, call: Call[Any]) -> Call[Any]:
        return call

    def _pages(self, listing: Listing[Any]) -> Call[ListPage[Any]]:
        return listing.page()

    _boxes = _pages


CLIENT: Any = Recorder()


class Given:
    """A client whose methods return the arguments that they are given."""

    def __getattr__(self, _: str) -> Callable[..., tuple[Any, Any]]:
        return lambda *args, **kwargs: (args, kwargs)


ANSWER = {
    "frame": "town/1",
    "box": "7",
    "verdict": "keep",
    "reviewer": "anna",
    "created_at": "2026-01-01T00:00:00Z",
}
CALLS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "datasets": ("GET /datasets", lambda c: c.datasets()),
    "dataset": ("GET /datasets/{dataset}", lambda c: c.dataset("town")),
    "create_dataset": (
        "POST /datasets",
        lambda c: c.create_dataset("town", classes=["car"], palette=None),
    ),
    "change_dataset": (
        "PATCH /datasets/{dataset}",
        lambda c: c.change_dataset("town", description="a street"),
    ),
    "rename_class": (
        "PATCH /datasets/{dataset}/classes/{name}",
        lambda c: c.rename_class("town", "Caar", "car"),
    ),
    "merge_class": (
        "PATCH /datasets/{dataset}/classes/{name}",
        lambda c: c.merge_class("town", "Caar", "car"),
    ),
    "remove_class": (
        "DELETE /datasets/{dataset}/classes/{name}",
        lambda c: c.remove_class("town", "Caar"),
    ),
    "delete_dataset": ("DELETE /datasets/{dataset}", lambda c: c.delete_dataset("a")),
    "stats": ("GET /datasets/{dataset}/stats", lambda c: c.stats("town")),
    "coached": ("GET /datasets/{dataset}/coached", lambda c: c.coached("town")),
    "report": ("GET /datasets/{dataset}/report", lambda c: c.report("town")),
    "histogram": (
        "GET /datasets/{dataset}/histogram",
        lambda c: c.histogram("town", bins=9),
    ),
    "preview": (
        "POST /datasets/{dataset}/preview",
        lambda c: c.preview("town", STRICT, limit=7),
    ),
    "problems": ("GET /datasets/{dataset}/problems", lambda c: c.problems("town")),
    "put_frame": (
        "PUT /datasets/{dataset}/frames/{key}",
        lambda c: c.put_frame("town", "a/b", image=b"i", depth=b"d", replace=True),
    ),
    "frames": (
        "GET /datasets/{dataset}/frames",
        lambda c: c.frames("town", class_name="car", sort="id"),
    ),
    "frame": ("GET /frames/{frame_id}", lambda c: c.frame(7)),
    "frame_by_key": (
        "GET /datasets/{dataset}/frames/{key}",
        lambda c: c.frame_by_key("town", "a/b"),
    ),
    "delete_frame": (
        "DELETE /datasets/{dataset}/frames/{key}",
        lambda c: c.delete_frame("town", "a/b"),
    ),
    "frame_file": ("GET /frames/{frame_id}/{kind}", lambda c: c.frame_file(7, "image")),
    "thumbnail": ("GET /frames/{frame_id}/thumbnail", lambda c: c.thumbnail(7)),
    "overlay": (
        "GET /frames/{frame_id}/overlay",
        lambda c: c.overlay(7, boxes="kept", layer="blend", edges=True),
    ),
    "crop": (
        "GET /boxes/{box_id}/crop",
        lambda c: c.crop(7, pad=0.5, layer="image", height=9),
    ),
    "boxes": ("GET /boxes", lambda c: c.boxes("town", class_name="car", sort="id")),
    "count_boxes": ("GET /boxes", lambda c: c.count_boxes("town", class_name="car")),
    "select_boxes": ("GET /boxes", lambda c: c.select_boxes("town", verdict="kept")),
    "box": ("GET /boxes/{box_id}", lambda c: c.box(7)),
    "delete_export": ("DELETE /exports/{export_id}", lambda c: c.delete_export(7)),
    "alike": ("GET /boxes/{box_id}/alike", lambda c: c.alike(7)),
    "track": ("GET /boxes/{box_id}/track", lambda c: c.track(7)),
    "depth_slice": ("GET /boxes/{box_id}/slice", lambda c: c.depth_slice(7)),
    "history": ("GET /boxes/{box_id}/history", lambda c: c.history(7)),
    "queue": (
        "POST /datasets/{dataset}/queue",
        lambda c: c.queue(
            "town", order="random", limit=9, filters={"class": "car"}, exclude=[7]
        ),
    ),
    "review": (
        "POST /boxes/{box_id}/reviews",
        lambda c: c.review(7, "keep", seen_revision=0, comment="there"),
    ),
    "undo_review": (
        "POST /boxes/{box_id}/reviews/{revision}/undo",
        lambda c: c.undo_review(7, 2),
    ),
    "bulk_review": (
        "POST /reviews/bulk",
        lambda c: c.bulk_review("town", "keep", SELECTION),
    ),
    "import_answers": (
        "POST /datasets/{dataset}/reviews/import",
        lambda c: c.import_answers("town", [ANSWER]),
    ),
    "undo": ("POST /review-batches/{batch_id}/undo", lambda c: c.undo(7)),
    "configs": ("GET /datasets/{dataset}/configs", lambda c: c.configs("town")),
    "add_config": (
        "POST /datasets/{dataset}/configs",
        lambda c: c.add_config("town", STRICT),
    ),
    "config": ("GET /configs/{digest}", lambda c: c.config("c0ffee")),
    "active_config": (
        "GET /datasets/{dataset}/config",
        lambda c: c.active_config("town"),
    ),
    "set_config": (
        "PUT /datasets/{dataset}/config",
        lambda c: c.set_config("town", "c0ffee"),
    ),
    "runs": ("GET /datasets/{dataset}/runs", lambda c: c.runs("town")),
    "start_run": (
        "POST /datasets/{dataset}/runs",
        lambda c: c.start_run("town", STRICT, activate=True),
    ),
    "run": ("GET /runs/{run_id}", lambda c: c.run(7)),
    "cancel": ("POST /runs/{run_id}/cancel", lambda c: c.cancel(7)),
    "diff": ("GET /runs/{run_id}/diff", lambda c: c.diff(7, 6)),
    "flips": ("GET /runs/{run_id}/diff", lambda c: c.flips(7, 6)),
    "exports": ("GET /datasets/{dataset}/exports", lambda c: c.exports("town")),
    "parts": ("GET /datasets/{dataset}/parts", lambda c: c.parts("town", [0.8, 0.2])),
    "start_export": (
        "POST /datasets/{dataset}/exports",
        lambda c: c.start_export("town", "yolo", split=0.5),
    ),
    "cancel_export": ("POST /exports/{export_id}/cancel", lambda c: c.cancel_export(7)),
    "export": ("GET /exports/{export_id}", lambda c: c.export(7)),
    "session": ("GET /session", lambda c: c.session()),
    "hooks": ("GET /hooks", lambda c: c.hooks()),
    "create_hook": ("POST /hooks", lambda c: c.create_hook("http://ci/a")),
    "delete_hook": ("DELETE /hooks/{hook_id}", lambda c: c.delete_hook(7)),
    "hook_deliveries": (
        "GET /hooks/{hook_id}/deliveries",
        lambda c: c.hook_deliveries(7),
    ),
    "ping_hook": ("POST /hooks/{hook_id}/ping", lambda c: c.ping_hook(7)),
    "tokens": ("GET /tokens", lambda c: c.tokens()),
    "create_token": ("POST /tokens", lambda c: c.create_token("ada", "viewer")),
    "revoke_token": ("DELETE /tokens/{token_id}", lambda c: c.revoke_token(7)),
    "create_login_code": ("POST /login-codes", lambda c: c.create_login_code()),
    "login_code": ("GET /login-codes/{code_id}", lambda c: c.login_code(7)),
    "audit": ("GET /audit", lambda c: c.audit()),
    "quality": (
        "GET /datasets/{dataset}/quality",
        lambda c: c.quality("town", target="recall", recall=0.9),
    ),
    "evaluate": ("POST /datasets/{dataset}/evaluations", lambda c: c.evaluate("town")),
    "evaluations": (
        "GET /datasets/{dataset}/evaluations",
        lambda c: c.evaluations("town", truth="people"),
    ),
    "versions": ("GET /datasets/{dataset}/versions", lambda c: c.versions("town")),
    "set_experiment": (
        "PUT /datasets/{dataset}/experiment",
        lambda c: c.set_experiment("town", experiment_report()),
    ),
    "experiment": (
        "GET /datasets/{dataset}/experiment",
        lambda c: c.experiment("town"),
    ),
    "version": ("GET /version", lambda c: c.version()),
}
"""A call of each method, and the route that it is sent to."""


def path_of(route: str) -> str:
    path = route.partition(" ")[2]
    return path if path == "/version" else f"/api/v1{path}"


def described(route: str) -> Any:
    """What the document says about a route such as `GET /datasets`."""
    return DOCUMENT["paths"][path_of(route)][route.partition(" ")[0].lower()]


def body_of(operation: Any) -> Any:
    """The schema of a request's body; an empty one if it has none."""
    contents = operation.get("requestBody", {}).get("content", {"": {"schema": {}}})
    schema = next(iter(contents.values()))["schema"]
    (first, *_) = schema.get("anyOf", [schema])
    return SCHEMAS.get(name_of(first), first)


def sent_of(call: Call[Any]) -> dict[str, Any]:
    """What a call sends, by name: its query, the keys of its body, or its files."""
    body: Any = call.json or {}
    files = {name: part[1] for name, part in (call.files or {}).items()}
    return {**call.params, **body, **body.get("options", {}), **files}


def name_of(schema: Any) -> str:
    return str(schema.get("$ref", "")).rpartition("/")[2]


def answers_of(operation: Any) -> set[str]:
    """The names of successful answers; "bytes" for files and "None" for nothing."""
    found = set()
    for status, answer in operation["responses"].items():
        if status.startswith("2"):
            content = answer.get("content", {})
            json = content.get("application/json", {}).get("schema", {})
            found.add(name_of(json) or ("bytes" if content else "None"))
    return {re.sub("^Page_(.*)_$", r"\1", name) for name in found}


def test_table_has_every_method():
    assert CALLS.keys() == {name for name in dir(Api) if not name.startswith("_")}


@pytest.mark.parametrize("name", CALLS)
def test_request_is_sent_as_the_openapi_document_describes_it(name):
    route, describe = CALLS[name]
    call, operation = describe(CLIENT), described(route)

    assert call.method == route.partition(" ")[0]
    pattern = path_of(route).replace("{key}", ".+")
    assert re.fullmatch(re.sub(r"{\w+}", "[^/]+", pattern), call.path)
    parameters = {one["name"] for one in operation.get("parameters", ())}
    assert query_of(call.params).keys() <= parameters
    sent, body = call.files or call.json or {}, body_of(operation)
    assert sent.keys() <= body.get("properties", {}).keys()
    assert sent.keys() >= set(body.get("required", ()))


@pytest.mark.parametrize("name", [name for name in CALLS if name != "bulk_review"])
def test_all_that_a_method_is_given_is_sent(name):
    route, describe = CALLS[name]
    call, (args, kwargs) = describe(CLIENT), describe(Given())
    left = list(map(str, args))

    # The first arguments are those of the path.
    path = re.sub(r"{\w+}", lambda _: left.pop(0), path_of(route))
    assert call.path == path
    sent = sent_of(call)
    assert {*left} <= {*map(str, sent.values()), str(call.json)}
    named = {key.replace("class_name", "class"): kwargs[key] for key in kwargs}
    assert {key: sent.get(key) for key in named} == named


@pytest.mark.parametrize("name", CALLS)
def test_result_is_the_answer_that_the_openapi_document_describes(name):
    annotation = str(inspect.signature(getattr(Api, name)).return_annotation)
    kinds = set(re.findall(r"\w+", annotation)) - {"Iterator", "wire"}

    answers = answers_of(described(CALLS[name][0]))
    assert {READ_FROM.get(kind, kind) for kind in kinds} == answers


def test_deletion_of_a_dataset_is_confirmed_by_its_name():
    assert CLIENT.delete_dataset("town").params == {"confirm": "town"}


def test_config_of_text_is_sent_as_yaml():
    call = CLIENT.add_config("town", "min_visible_pixels: 9")

    assert (call.content, call.json) == (b"min_visible_pixels: 9", None)
    assert call.headers == {"Content-Type": "application/yaml"}


def test_text_with_the_ending_of_a_file_is_its_path(tmp_path):
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 8\n")

    assert CLIENT.set_config("town", str(file)).content == file.read_bytes()


@pytest.mark.parametrize(
    ("boxes", "selected"),
    [
        ([7, 8], {"box_ids": [7, 8]}),
        ([Decision.read(DECISION)], {"box_ids": [7], "seen_revisions": [0]}),
        (SELECTION, {"filter": {"class": "car"}, "snapshot": "s"}),
    ],
)
def test_bulk_review_sends_what_was_seen_of_its_boxes(boxes, selected):
    call = CLIENT.bulk_review("town", "keep", boxes, comment="all")

    answer = {"dataset": "town", "verdict": "keep", "comment": "all"}
    assert call.json == answer | selected


@pytest.mark.parametrize("boxes", [{"verdict": "kept"}, [Decision.read(DECISION), 7]])
def test_bulk_review_of_a_filter_or_mixed_boxes_raises_type_error(boxes):
    with pytest.raises(TypeError, match="expected decisions"):
        CLIENT.bulk_review("town", "keep", boxes)
