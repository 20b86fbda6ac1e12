"""Each method of the client sends the request that the OpenAPI document describes.

Nothing is sent here. The document is the pinned one, which is compared with the
service; the methods that stream, such as `push` and `events`, have tests of their own.
"""

import inspect
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from tests.pins import stored
from tests.support.response_checks import DECISION
from tests.support.sensors import experiment_report
from unghost.client.api import Api
from unghost.client.call import Call, ItemsAndCursor, Listing, query_of
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

    def _pages(self, listing: Listing[Any]) -> Call[ItemsAndCursor[Any]]:
        return listing.page()

    _boxes = _pages


CLIENT: Any = Recorder()


class AskedCall(NamedTuple):
    """A method of the client with arguments for it."""

    name: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]

    def sent(self) -> Call[Any]:
        """What the client would send."""
        call: Call[Any] = getattr(CLIENT, self.name)(*self.args, **self.kwargs)
        return call


class Asked:
    """A client whose methods return how they were called."""

    def __getattr__(self, name: str) -> Callable[..., AskedCall]:
        return lambda *args, **kwargs: AskedCall(name, args, kwargs)


ANSWER = {
    "frame": "town/1",
    "box": "7",
    "verdict": "keep",
    "reviewer": "anna",
    "created_at": "2026-01-01T00:00:00Z",
}
ask: Any = Asked()
CALLS = {
    request.name: (route, request)
    for route, request in [
        ("GET /datasets", ask.datasets()),
        ("GET /datasets/{dataset}", ask.dataset("town")),
        ("POST /datasets", ask.create_dataset("town", classes=["car"], palette=None)),
        (
            "PATCH /datasets/{dataset}",
            ask.change_dataset("town", description="a street"),
        ),
        (
            "PATCH /datasets/{dataset}/classes/{name}",
            ask.rename_class("town", "Caar", "car"),
        ),
        (
            "PATCH /datasets/{dataset}/classes/{name}",
            ask.merge_class("town", "Caar", "car"),
        ),
        ("DELETE /datasets/{dataset}/classes/{name}", ask.remove_class("town", "Caar")),
        ("DELETE /datasets/{dataset}", ask.delete_dataset("a")),
        ("GET /datasets/{dataset}/stats", ask.stats("town")),
        ("GET /datasets/{dataset}/coached", ask.coached("town")),
        ("GET /datasets/{dataset}/report", ask.report("town")),
        ("GET /datasets/{dataset}/histogram", ask.histogram("town", bins=9)),
        ("POST /datasets/{dataset}/preview", ask.preview("town", STRICT, limit=7)),
        ("GET /datasets/{dataset}/problems", ask.problems("town")),
        (
            "PUT /datasets/{dataset}/frames/{key}",
            ask.put_frame("town", "a/b", image=b"i", depth=b"d", replace=True),
        ),
        (
            "GET /datasets/{dataset}/frames",
            ask.frames("town", class_name="car", sort="id"),
        ),
        ("GET /frames/{frame_id}", ask.frame(7)),
        ("GET /datasets/{dataset}/frames/{key}", ask.frame_by_key("town", "a/b")),
        ("DELETE /datasets/{dataset}/frames/{key}", ask.delete_frame("town", "a/b")),
        ("GET /frames/{frame_id}/{kind}", ask.frame_file(7, "image")),
        ("GET /frames/{frame_id}/thumbnail", ask.thumbnail(7)),
        (
            "GET /frames/{frame_id}/overlay",
            ask.overlay(7, boxes="kept", layer="blend", edges=True),
        ),
        ("GET /boxes/{box_id}/crop", ask.crop(7, pad=0.5, layer="image", height=9)),
        ("GET /boxes", ask.boxes("town", class_name="car", sort="id")),
        ("GET /boxes", ask.count_boxes("town", class_name="car")),
        ("GET /boxes", ask.select_boxes("town", verdict="kept")),
        ("GET /boxes/{box_id}", ask.box(7)),
        ("DELETE /exports/{export_id}", ask.delete_export(7)),
        ("GET /boxes/{box_id}/alike", ask.alike(7)),
        ("GET /boxes/{box_id}/track", ask.track(7)),
        ("GET /boxes/{box_id}/slice", ask.depth_slice(7)),
        ("GET /boxes/{box_id}/history", ask.history(7)),
        (
            "POST /datasets/{dataset}/queue",
            ask.queue(
                "town", order="random", limit=9, filters={"class": "car"}, exclude=[7]
            ),
        ),
        (
            "POST /boxes/{box_id}/reviews",
            ask.review(7, "keep", seen_revision=0, comment="there"),
        ),
        ("POST /boxes/{box_id}/reviews/{revision}/undo", ask.undo_review(7, 2)),
        ("POST /reviews/bulk", ask.bulk_review("town", "keep", SELECTION)),
        (
            "POST /datasets/{dataset}/reviews/import",
            ask.import_answers("town", [ANSWER]),
        ),
        ("POST /review-batches/{batch_id}/undo", ask.undo(7)),
        ("GET /datasets/{dataset}/configs", ask.configs("town")),
        ("POST /datasets/{dataset}/configs", ask.add_config("town", STRICT)),
        ("GET /configs/{digest}", ask.config("c0ffee")),
        ("GET /datasets/{dataset}/config", ask.active_config("town")),
        ("PUT /datasets/{dataset}/config", ask.set_config("town", "c0ffee")),
        ("GET /datasets/{dataset}/runs", ask.runs("town")),
        ("POST /datasets/{dataset}/runs", ask.start_run("town", STRICT, activate=True)),
        ("GET /runs/{run_id}", ask.run(7)),
        ("POST /runs/{run_id}/cancel", ask.cancel(7)),
        ("GET /runs/{run_id}/diff", ask.diff(7, 6)),
        ("GET /runs/{run_id}/diff", ask.flips(7, 6)),
        ("GET /datasets/{dataset}/exports", ask.exports("town")),
        ("GET /datasets/{dataset}/parts", ask.parts("town", [0.8, 0.2])),
        (
            "POST /datasets/{dataset}/exports",
            ask.start_export("town", "yolo", split=0.5),
        ),
        ("POST /exports/{export_id}/cancel", ask.cancel_export(7)),
        ("GET /exports/{export_id}", ask.export(7)),
        ("GET /session", ask.session()),
        ("GET /hooks", ask.hooks()),
        ("POST /hooks", ask.create_hook("http://ci/a")),
        ("DELETE /hooks/{hook_id}", ask.delete_hook(7)),
        ("GET /hooks/{hook_id}/deliveries", ask.hook_deliveries(7)),
        ("POST /hooks/{hook_id}/ping", ask.ping_hook(7)),
        ("GET /tokens", ask.tokens()),
        ("POST /tokens", ask.create_token("ada", "viewer")),
        ("DELETE /tokens/{token_id}", ask.revoke_token(7)),
        ("POST /login-codes", ask.create_login_code()),
        ("GET /login-codes/{code_id}", ask.login_code(7)),
        ("GET /audit", ask.audit()),
        (
            "GET /datasets/{dataset}/quality",
            ask.quality("town", target="recall", recall=0.9),
        ),
        ("POST /datasets/{dataset}/evaluations", ask.evaluate("town")),
        (
            "GET /datasets/{dataset}/evaluations",
            ask.evaluations("town", truth="people"),
        ),
        ("GET /datasets/{dataset}/versions", ask.versions("town")),
        (
            "PUT /datasets/{dataset}/experiment",
            ask.set_experiment("town", experiment_report()),
        ),
        ("GET /datasets/{dataset}/experiment", ask.experiment("town")),
        ("GET /version", ask.version()),
    ]
}
"""By method: the route that it is sent to, and a call of it."""


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
    names = set()
    for status, response in operation["responses"].items():
        if status.startswith("2"):
            content = response.get("content", {})
            json = content.get("application/json", {}).get("schema", {})
            names.add(name_of(json) or ("bytes" if content else "None"))
    return {re.sub("^Page_(.*)_$", r"\1", name) for name in names}


def test_table_has_every_method():
    assert CALLS.keys() == {name for name in dir(Api) if not name.startswith("_")}


@pytest.mark.parametrize("name", CALLS)
def test_request_is_sent_as_the_openapi_document_describes_it(name):
    route, request = CALLS[name]
    call, operation = request.sent(), described(route)

    assert call.method == route.partition(" ")[0]
    pattern = path_of(route).replace("{key}", ".+")
    assert re.fullmatch(re.sub(r"{\w+}", "[^/]+", pattern), call.path)
    parameters = {row["name"] for row in operation.get("parameters", ())}
    assert query_of(call.params).keys() <= parameters
    sent, body = call.files or call.json or {}, body_of(operation)
    assert sent.keys() <= body.get("properties", {}).keys()
    assert sent.keys() >= set(body.get("required", ()))


@pytest.mark.parametrize("name", [name for name in CALLS if name != "bulk_review"])
def test_all_that_a_method_is_given_is_sent(name):
    route, request = CALLS[name]
    call, kwargs = request.sent(), request.kwargs
    left = list(map(str, request.args))

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

    described_kinds = answers_of(described(CALLS[name][0]))
    assert {READ_FROM.get(kind, kind) for kind in kinds} == described_kinds


def test_config_may_be_yaml_or_a_path_and_a_deletion_is_confirmed(tmp_path):
    call = CLIENT.add_config("town", "min_visible_pixels: 9")

    assert (call.content, call.json) == (b"min_visible_pixels: 9", None)
    assert call.headers == {"Content-Type": "application/yaml"}
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 8\n")

    assert CLIENT.set_config("town", str(file)).content == file.read_bytes()
    assert CLIENT.delete_dataset("town").params == {"confirm": "town"}


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

    judgement = {"dataset": "town", "verdict": "keep", "comment": "all"}
    assert call.json == judgement | selected


@pytest.mark.parametrize("boxes", [{"verdict": "kept"}, [Decision.read(DECISION), 7]])
def test_bulk_review_of_a_filter_or_mixed_boxes_raises_type_error(boxes):
    with pytest.raises(TypeError, match="expected decisions"):
        CLIENT.bulk_review("town", "keep", boxes)
