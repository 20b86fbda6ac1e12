"""Text with half of a surrogate pair is refused wherever it is sent, never a 500."""

import json

import pytest

from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.archives import lines_of, send, tar_archive

HALF = "\ud800"


@pytest.fixture(scope="module", autouse=True)
def street(api):
    api.post("/datasets", {"name": "street"})


def problem_of(response):
    """The problem document of an answer with a 4xx status."""
    assert 400 <= response.status_code < 500, response.text
    assert response.headers["content-type"] == "application/problem+json"
    return response.json()


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/datasets", {"name": HALF}),
        ("/datasets", {"name": "a", HALF: 1}),
        ("/datasets", {"name": "a", "classes": [HALF]}),
        ("/datasets/street/queue", {"filters": {"class": HALF}}),
        ("/datasets/street/configs", {"classes": {HALF: {}}}),
        ("/boxes/1/reviews", {"verdict": "keep", "seen_revision": 0, "comment": HALF}),
        ("/tokens", {"name": HALF}),
        ("/session", {"token": HALF}),
    ],
)
def test_surrogate_in_any_field_of_a_json_body_is_refused(api, path, body):
    content = json.dumps(body).encode()

    response = api.http.post(
        BASE + path, content=content, headers={"Content-Type": "application/json"}
    )

    assert "surrogate" in problem_of(response)["detail"]


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (b"/datasets/%ED%A0%80", {}),
        (b"/datasets/street/frames/%ED%A0%80", {}),
        (b"/boxes?dataset=street&class=%ED%A0%80", {}),
        (b"/boxes?dataset=street&cursor=%ED%A0%80", {}),
        (b"/datasets", {b"idempotency-key": b"\xed\xa0\x80"}),
        (b"/datasets", {b"if-none-match": b"\xed\xa0\x80"}),
        (b"/datasets", {b"cookie": b"a=\xed\xa0\x80"}),
    ],
)
def test_surrogate_in_a_path_query_or_header_causes_no_500(api, path, headers):
    url = api.http.base_url.copy_with(raw_path=BASE.encode() + path)
    headers = {**dict(api.http.headers.raw), **headers}

    for method in ("GET", "POST"):
        response = api.http.request(method, url, headers=headers)

        assert response.status_code < 500, response.text


@pytest.mark.parametrize(
    "place",
    [
        lambda a: a.update({"map": HALF}),
        lambda a: a.update({HALF: 1}),
        lambda a: a.update({"weather": {HALF: 1}}),
        lambda a: a["camera"].update({"transform": {HALF: 1}}),
        lambda a: a["boxes"][0].update({"id": HALF}),
        lambda a: a["boxes"][0].update({"kept": {"deep": [HALF]}}),
        lambda a: a["boxes"][0].update({"xyxy": HALF}),
    ],
)
def test_surrogate_in_any_field_of_an_annotation_is_refused(api, place):
    annotation = scene.annotation()
    place(annotation)
    content = json.dumps(annotation).encode()
    files = [("a.json", content), ("a.image.png", scene.image())]

    problem = problem_of(api.put("street", "a", content))
    batch = send(api, "street", tar_archive(files))

    assert problem["code"] == "bad_annotation"
    line, end = lines_of(batch.text)
    assert (line["status"], end["refused"]) == (422, 1), batch.text
    kept = api.json("/datasets/street/problems")["items"][0]["error"]
    assert kept["errors"] == problem["errors"]


@pytest.mark.parametrize("text", ['"\\ud800": 1', 'classes: {"\\ud800": {}}'])
def test_surrogate_in_a_configuration_is_refused(api, text):
    response = api.http.post(
        f"{BASE}/datasets/street/configs",
        content=text,
        headers={"Content-Type": "application/yaml"},
    )

    assert "surrogate" in problem_of(response)["detail"]


@pytest.mark.parametrize("name", [b"\xed\xa0\x80", b"a\xff"])
def test_invalid_utf8_in_a_part_or_member_name_causes_no_500(api, name):
    form = (
        b'--b\r\nContent-Disposition: form-data; name="%b"; filename="%b"\r\n\r\n'
        b"x\r\n--b--\r\n" % (name, name)
    )
    part = api.http.put(
        f"{BASE}/datasets/street/frames/a",
        content=form,
        headers={"Content-Type": "multipart/form-data; boundary=b"},
    )
    archive = tar_archive([("XX.json", b"{}")]).replace(b"XX", name[:2], 1)
    member = send(api, "street", archive)

    problem_of(part)
    assert member.status_code in (200, 422), member.text
