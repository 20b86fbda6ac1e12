"""The refusal of an invalid request says what was expected and what was found."""

import json

import pytest

from app.http.problems import InvalidValue, in_words

DIGEST = "a digest of 64 hexadecimal digits"
SECRET = "ug_of-somebody-else"


@pytest.mark.parametrize(
    ("method", "path", "body", "detail"),
    [
        ("POST", "/datasets", b"", "expected a body of JSON, found none"),
        ("POST", "/datasets", b"[]", "expected an object, found a list"),
        ("POST", "/datasets", b'{"name',
         "expected JSON in UTF-8, found a fault at line 1, column 2: Unterminated"),
        ("POST", "/datasets", b'{"name": "a", "name": "b"}',
         "expected JSON in UTF-8, found the key 'name' twice"),
        ("POST", "/datasets", b'{"name": 5}', "/name: expected a text, found 5"),
        ("POST", "/datasets", b'{"name": null}', "/name: expected a text, found null"),
        ("POST", "/datasets", b'{"name": "A b"}',
         "/name: expected 1 to 100 of a-z, A-Z, 0-9, dot, dash and underscore, with "
         "a letter or a digit at both ends"),
        ("POST", "/datasets", b'{"name": "a", "pallete": "auto"}',
         "/pallete: unknown name; did you mean 'palette'?"),
        ("POST", "/datasets", b'{"name": "a", "xyz": 1}',
         "/xyz: unknown name; it may be misspelt"),
        ("POST", "/datasets/a/queue", b'{"filters": {"verdct": "kept"}}',
         "/filters/verdct: unknown name; did you mean 'verdict'?"),
        ("POST", "/datasets", b'{"name": "a", "palette": "carla"}',
         "/palette: expected 'auto', 'carla-0.9.0', 'carla-0.9.10', 'carla-0.9.14' or "
         "'paper-table1', found 'carla'"),
        ("POST", "/tokens", b'{"name": "a\\n"}',
         "/name: expected printable characters"),
        ("POST", "/tokens", b"{}", "/name: required, but missing"),
        ("POST", "/tokens", b'{"name": "a", "role": "boss"}',
         "/role: expected 'viewer', 'reviewer' or 'admin'"),
        ("POST", "/tokens", b'{"name": "a", "expires_at": "yesterday"}',
         "/expires_at: expected a time such as 2026-01-31T12:00:00Z"),
        ("POST", "/datasets/a/runs", b'{"config": "strict"}',
         f"/config: expected a configuration, or {DIGEST}"),
        ("GET", "/boxes?dataset=a&limit=0", None,
         "query parameter 'limit': expected at least 1, found 0"),
        ("GET", "/frames/x", None,
         "path parameter 'frame_id': expected a whole number, found a text"),
        ("GET", "/configs/x", None, f"path parameter 'digest': expected {DIGEST}"),
    ],
)  # fmt: skip
def test_validation_error_has_the_expected_and_the_found_value(
    api, method, path, body, detail
):
    headers = {"Content-Type": "application/json"}
    response = api.http.request(method, f"/api/v1{path}", content=body, headers=headers)

    problem = response.json()
    assert (response.status_code, problem["code"]) == (422, "invalid_request"), problem
    assert problem["detail"].startswith(detail)


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/session", {"token": [SECRET]}),
        ("/tokens", {"name": ["a"], "role": SECRET, SECRET[:2]: SECRET}),
    ],
)
def test_possible_token_in_an_invalid_body_is_not_echoed(api, path, body):
    response = api.post(path, body)

    assert response.status_code == 422
    assert SECRET not in response.text


def find_patterns(document):
    if isinstance(document, dict):
        if isinstance(document.get("pattern"), str):
            yield document["pattern"]
        for part in document.values():
            yield from find_patterns(part)
    elif isinstance(document, list):
        for part in document:
            yield from find_patterns(part)


def test_every_pattern_has_a_readable_error_message(document):
    # This pattern is left out, as its error has a message of its own.
    patterns = set(find_patterns(json.loads(json.dumps(document)))) - {"^[!-~]{1,200}$"}

    assert len(patterns) > 3
    for pattern in patterns:
        error = InvalidValue(
            type="string_pattern_mismatch",
            loc=("body", "name"),
            msg="",
            input="x",
            ctx={"pattern": pattern},
        )
        assert in_words(error).startswith("expected ")
