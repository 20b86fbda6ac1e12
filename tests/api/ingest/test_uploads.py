"""Uploads that are not frames: wrong parts, wrong bodies, keys that are paths."""

import pytest


@pytest.fixture(scope="module")
def empty_dataset(api):
    return api.dataset()


@pytest.mark.parametrize(
    ("parts", "code"),
    [
        pytest.param(
            [("annotation", "{}"), ("imagee", "x")], "unknown_part", id="typo"
        ),
        pytest.param(
            [("annotation", "{}"), ("annotation", "{}")], "repeated_part", id="twice"
        ),
        pytest.param([("image", "x")], "missing_annotation", id="no annotation"),
    ],
)
def test_unknown_repeated_or_missing_part_of_a_frame_is_refused(
    api, empty_dataset, parts, code
):
    files = [(name, (name, content)) for name, content in parts]
    path = f"/api/v1/datasets/{empty_dataset}/frames/a"

    response = api.http.put(path, files=files)

    assert (response.status_code, response.json()["code"]) == (422, code)


@pytest.mark.parametrize(
    ("headers", "content", "status", "code"),
    [
        ({"Content-Type": "application/json"}, b"{}", 415, "unsupported_media_type"),
        ({}, b"x", 415, "unsupported_media_type"),
        ({"Content-Type": "multipart/form-data"}, b"x", 400, "bad_multipart"),
        ({"Content-Type": "multipart/form-data; boundary=b"}, b"--b\r\nbad\r\n\r\n",
         400, "bad_multipart"),
        ({"Content-Type": "multipart/form-data; boundary=" + "b" * 300}, b"", 400,
         "bad_multipart"),
    ],
)  # fmt: skip
def test_frame_body_that_is_not_a_multipart_form_is_refused(
    api, empty_dataset, headers, content, status, code
):
    path = f"/api/v1/datasets/{empty_dataset}/frames/a"

    response = api.http.put(path, headers=headers, content=content)

    assert (response.status_code, response.json()["code"]) == (status, code)


@pytest.mark.parametrize(
    "key",
    [
        pytest.param("", id="empty"),
        pytest.param("a//b", id="an empty part"),
        pytest.param("a/", id="a slash at the end"),
        pytest.param("%2e%2e/a", id="a way out"),
        pytest.param("a/%2E%2E/b", id="a way round"),
        pytest.param("a/%2e", id="a dot"),
        pytest.param("a%5Cb", id="a backslash"),
        pytest.param("a%00b", id="NUL"),
        pytest.param("a%09b", id="a tabulator"),
        pytest.param("a%0Ab", id="a line end"),
        pytest.param("a%0A", id="a line end at the end"),
        pytest.param("%E2%80%AEa", id="text that runs backwards"),
        pytest.param("a%FF", id="bytes that are no UTF-8"),
        pytest.param("x" * 513, id="513 characters"),
    ],
)
def test_invalid_frame_key_is_refused(api, empty_dataset, key):
    response = api.put(empty_dataset, key)

    assert (response.status_code, response.json()["code"]) == (422, "bad_key")
    assert api.json(f"/datasets/{empty_dataset}/frames")["items"] == []


def test_frame_key_of_512_characters_is_accepted(api):
    dataset, key = api.dataset(), "ü/" * 255 + "xy"

    assert api.upload_frame(dataset, key)["frame"]["key"] == key
    assert api.json(f"/datasets/{dataset}/frames/{key}")["key"] == key
