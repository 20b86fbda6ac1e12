"""Text with half of a surrogate pair is refused wherever it is sent, never a 500.

The routes and their fields come from the OpenAPI document, so that new ones are tested,
too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from app.main import create_app
from app.settings import Settings
from tests.support import frames as scene
from tests.support.archives import lines_of, tar_archive
from tests.support.routes import fill_path, values_of_paths

LONE_SURROGATE = "\ud800"
VALUES = values_of_paths(1)
DOCUMENT = create_app(Settings()).openapi()


def resolved(schema: Any) -> Any:
    while "$ref" in schema:
        schema = DOCUMENT["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    return schema


def forms(schema: Any) -> Iterator[Any]:
    """Every form that a schema allows: its alternatives, and the schema itself."""
    schema = resolved(schema)
    for word in ("anyOf", "oneOf"):
        for one in schema.get(word, ()):
            yield from forms(one)
    yield schema


def spoiled_values(schema: Any, depth: int = 0) -> Iterator[Any]:
    """Values of a schema, each with one text or one key that holds half a pair."""
    for form in forms(schema):
        kind = form.get("type")
        kinds = kind if isinstance(kind, list) else [kind]
        if "string" in kinds:
            yield f"a{LONE_SURROGATE}"
        if "array" in kinds:
            yield from (
                [one] for one in spoiled_values(form.get("items", {}), depth + 1)
            )
        if "object" in kinds and depth < 4:
            yield {LONE_SURROGATE: 1}
            for name, inner in form.get("properties", {}).items():
                others = sample(form)
                yield from (
                    {**others, name: one} for one in spoiled_values(inner, depth + 1)
                )


def sample(schema: Any) -> Any:
    """A valid value of a schema, with only the required fields."""
    form = next(iter(forms(schema)))
    if "enum" in form or "const" in form:
        return form.get("const", form.get("enum", [None])[0])
    if form.get("type") == "object":
        needed = form.get("required", ())
        return {name: sample(form["properties"][name]) for name in needed}
    plain = {
        "string": "0" * 64,
        "integer": 1,
        "number": 1,
        "array": [],
        "boolean": True,
    }
    return plain.get(form.get("type"))


BODIES = [
    pytest.param(method, path, body, id=f"{method} {path} {ascii(body)[:60]}")
    for path, item in DOCUMENT["paths"].items()
    for method, operation in item.items()
    for schema in [
        operation.get("requestBody", {}).get("content", {}).get("application/json")
    ]
    if schema is not None
    for body in spoiled_values(schema["schema"])
]
TEXTS = [
    pytest.param(
        method, path, parameter["in"], parameter["name"], id=f"{method} {path}"
    )
    for path, item in DOCUMENT["paths"].items()
    for method, operation in item.items()
    for parameter in operation.get("parameters", ())
]


@pytest.fixture(scope="module", autouse=True)
def street(api):
    api.post("/datasets", {"name": "street"})


def assert_problem(answer):
    """Check that the answer is a problem with a 4xx status; return the problem."""
    problem = answer.json()
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    return problem


@pytest.mark.parametrize(("method", "path", "body"), BODIES)
def test_surrogate_in_any_field_of_a_json_body_is_refused(api, method, path, body):
    content = json.dumps(body).encode()
    assert b"\\ud800" in content

    answer = api.http.request(
        method,
        fill_path(path, VALUES),
        content=content,
        headers={"Content-Type": "application/json"},
    )

    assert "surrogate" in assert_problem(answer)["detail"]


@pytest.mark.parametrize(("method", "path", "place", "name"), TEXTS)
def test_surrogate_in_a_path_query_or_header_causes_no_500(
    api, method, path, place, name
):
    values, half = VALUES, b"%ED%A0%80"
    query, headers = b"", dict(api.http.headers.raw)
    if place == "path":
        values = {**VALUES, name: half.decode()}
    elif place == "query":
        query = b"?" + name.encode() + b"=" + half
    elif place == "header":
        headers[name.encode()] = b"\xed\xa0\x80"
    else:
        headers[b"cookie"] = name.encode() + b"=\xed\xa0\x80"
    url = api.http.base_url.copy_with(raw_path=fill_path(path, values).encode() + query)

    answer = api.http.request(method, url, headers=headers)

    assert answer.status_code < 500, answer.text


@pytest.mark.parametrize(
    "place",
    [
        lambda a: a.update({"map": LONE_SURROGATE}),
        lambda a: a.update({"carla_version": LONE_SURROGATE}),
        lambda a: a.update({"captured_at": LONE_SURROGATE}),
        lambda a: a.update({LONE_SURROGATE: 1}),
        lambda a: a.update({"weather": {LONE_SURROGATE: 1}}),
        lambda a: a.update({"weather": {"fog": LONE_SURROGATE}}),
        lambda a: a.update({"extra": [LONE_SURROGATE]}),
        lambda a: a.update({"sensors": {LONE_SURROGATE: {}}}),
        lambda a: a.update({"sensors": {"lidar": {"transform": {LONE_SURROGATE: 1}}}}),
        lambda a: a["camera"].update({LONE_SURROGATE: 1}),
        lambda a: a["camera"].update({"fov": LONE_SURROGATE}),
        lambda a: a["camera"].update({"transform": {LONE_SURROGATE: 1}}),
        lambda a: a["boxes"][0].update({"id": LONE_SURROGATE}),
        lambda a: a["boxes"][0].update({"class": LONE_SURROGATE}),
        lambda a: a["boxes"][0].update({"type_id": LONE_SURROGATE}),
        lambda a: a["boxes"][0].update({"base_type": LONE_SURROGATE}),
        lambda a: a["boxes"][0].update({"kept": {"deep": [LONE_SURROGATE]}}),
        lambda a: a["boxes"][0].update({LONE_SURROGATE: LONE_SURROGATE}),
        lambda a: a["boxes"][0].update({"box3d": {LONE_SURROGATE: 1}}),
        lambda a: a["boxes"][0].update({"xyxy": LONE_SURROGATE}),
    ],
)
def test_surrogate_in_any_field_of_an_annotation_is_refused(api, place):
    annotation = scene.annotation()
    place(annotation)
    content = json.dumps(annotation).encode()
    files = [("a.json", content), ("a.image.png", scene.image())]

    problem = assert_problem(api.put("street", "a", content))
    batch = api.http.post(
        "/api/v1/datasets/street/batches",
        content=tar_archive(files),
        headers={"Content-Type": "application/x-tar"},
    )

    assert problem["code"] == "bad_annotation"
    line, end = lines_of(batch.text)
    assert (line["status"], end["refused"]) == (422, 1), batch.text
    kept = api.json("/datasets/street/problems")["items"][0]["error"]
    assert kept["errors"] == problem["errors"]


@pytest.mark.parametrize(
    "text",
    [
        '"\\ud800": 1',
        'classes: {"\\ud800": {}}',
        'sitting: {"\\ud800": 1}',
        '- "\\ud800"',
    ],
)
def test_surrogate_in_a_configuration_is_refused(api, text):
    answer = api.http.post(
        "/api/v1/datasets/street/configs",
        content=text,
        headers={"Content-Type": "application/yaml"},
    )

    assert "surrogate" in assert_problem(answer)["detail"]


@pytest.mark.parametrize("name", [b"\xed\xa0\x80", b"a\xff"])
def test_invalid_utf8_in_a_part_or_member_name_causes_no_500(api, name):
    form = (
        b'--b\r\nContent-Disposition: form-data; name="%b"; filename="%b"\r\n\r\n'
        b"x\r\n--b--\r\n" % (name, name)
    )
    part = api.http.put(
        "/api/v1/datasets/street/frames/a",
        content=form,
        headers={"Content-Type": "multipart/form-data; boundary=b"},
    )
    archive = tar_archive([("XX.json", b"{}")]).replace(b"XX", name[:2], 1)
    member = api.http.post(
        "/api/v1/datasets/street/batches",
        content=archive,
        headers={"Content-Type": "application/x-tar"},
    )

    assert_problem(part)
    assert member.status_code in (200, 422), member.text
