"""What generated requests do not reach: ranges, cached files, streams, archives."""

import pytest

from tests.support import archives
from tests.support.hostile.openapi_cases import DATASET, SCHEMA, populate
from unghost.wire.runs import Export, Run

pytestmark = pytest.mark.long

BASE = "/api/v1"
FILE = "/frames/{frame_id}/{kind}"
THUMBNAIL = "/frames/{frame_id}/thumbnail"
DOWNLOAD = "/exports/{export_id}/download"
WHOLE, PART, SAME, NO_PART = 200, 206, 304, 416


@pytest.fixture(scope="module")
def path_values(api):
    """Values for the paths to the dataset that `populate` makes."""
    populate(api)
    frames = api.json(f"/datasets/{DATASET}/frames")["items"]
    exports = api.json(f"/datasets/{DATASET}/exports")["items"]
    runs = api.json(f"/datasets/{DATASET}/runs")["items"]
    return {
        "frame_id": frames[0]["id"],
        "kind": "segmentation",
        "export_id": exports[0]["id"],
        "run_id": runs[0]["id"],
    }


def check_response_is_documented(response, method, path):
    """Check that the document has the answer's status, type and form; return it."""
    SCHEMA[BASE + path][method].validate_response(response)
    return response


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        (FILE, {}, WHOLE),
        (FILE, {"Range": "bytes=0-9"}, PART),
        (FILE, {"Range": "bytes=999999-"}, NO_PART),
        (FILE, {"If-None-Match": "*"}, SAME),
        (THUMBNAIL, {}, WHOLE),
        (THUMBNAIL, {"If-None-Match": "*"}, SAME),
        (DOWNLOAD, {}, WHOLE),
        (DOWNLOAD, {"Range": "bytes=-5"}, PART),
        (DOWNLOAD, {"Range": "bytes=-5", "If-Range": '"other"'}, WHOLE),
        (DOWNLOAD, {"Range": "bytes=999999-"}, NO_PART),
        (DOWNLOAD, {"If-None-Match": "*"}, SAME),
    ],
)
def test_file_and_range_responses_match_the_openapi_document(
    api, path_values, path, headers, status
):
    response = api.http.get(BASE + path.format(**path_values), headers=headers)

    assert check_response_is_documented(response, "GET", path).status_code == status


@pytest.mark.parametrize(
    ("path", "name", "model"),
    [
        ("/runs/{run_id}/events", "run_id", Run),
        ("/exports/{export_id}/events", "export_id", Export),
    ],
)
def test_event_stream_matches_the_openapi_document(api, path_values, path, name, model):
    response = check_response_is_documented(
        api.get(path.format(**path_values)), "GET", path
    )

    blocks = response.text.strip().split("\n\n")[1:]
    events = [
        dict(line.split(": ", 1) for line in block.splitlines()) for block in blocks
    ]
    assert events[-1]["event"] == "end"
    not_modified = check_response_is_documented(
        api.http.get(
            BASE + path.format(**path_values),
            headers={"Last-Event-ID": events[-1]["id"]},
        ),
        "GET",
        path,
    )
    assert not_modified.status_code == 204
    assert {model.model_validate_json(event["data"]).id for event in events} == {
        path_values[name]
    }


@pytest.mark.parametrize(
    ("body", "media_type", "status"),
    [
        (archives.tar_archive(archives.frame("a")), "application/x-tar", 200),
        (archives.tar_archive(archives.frame("a"))[:700], "application/x-tar", 200),
        (b"no archive" * 100, "application/x-tar", 422),
        (b"", "application/x-tar", 422),
        (b"{}", "application/json", 415),
    ],
)
def test_batch_responses_match_the_openapi_document(
    api, path_values, body, media_type, status
):
    path = "/datasets/{dataset}/batches"
    response = api.http.post(
        BASE + path.format(dataset=DATASET),
        content=body,
        headers={"Content-Type": media_type},
    )

    assert check_response_is_documented(response, "POST", path).status_code == status


def test_post_with_an_invalid_idempotency_key_returns_400(api, path_values):
    for path in ("known-frames", "preview", "queue", "configs"):
        response = api.http.post(
            f"{BASE}/datasets/{DATASET}/{path}",
            json={"keys": [], "config": {}},
            headers={"Idempotency-Key": "no spaces"},
        )
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (400, "bad_idempotency_key"), path


def test_openapi_maximum_of_queue_seed_is_the_64_bit_maximum():
    seed = SCHEMA.raw_schema["components"]["schemas"]["QueueIn"]["properties"]["seed"]

    assert seed["anyOf"][0]["maximum"] == 2**63 - 1
