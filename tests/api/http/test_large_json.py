"""Large JSON documents are parsed one at a time, beside other requests."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.incoming import in_turn
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationErrors
from tests.support import frames as scene
from tests.support.api import Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.live import live

DATASETS = "/api/v1/datasets"
NUMBERS = {"numbers": list(range(100_000))}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with live(tmp_path_factory.mktemp("json") / "data", workers=2) as running:
        with running.admin() as client:
            assert client.post(DATASETS, json={"name": "street"}).is_success
        yield running


def put(service, key, **changed):
    with service.admin() as client:
        annotation = {**scene.annotation(), **changed}
        return Api(client).put("street", key, annotation).status_code


def send_batch(service):
    with service.admin() as client:
        archive = tar_archive(frame("large", extra=NUMBERS))
        response = send(Api(client), "street", archive)
    return lines_of(response.text)[0]["status"]


def send_body(service):
    with service.admin() as client:
        body = {"name": "avenue", "unknown": NUMBERS["numbers"]}
        return client.post(DATASETS, json=body).status_code


def test_large_json_is_parsed_serially_without_blocking_small_requests(service):
    with ThreadPoolExecutor(3) as senders:
        with in_turn(10**9):
            large = [
                senders.submit(put, service, "large", extra=NUMBERS),
                senders.submit(send_batch, service),
                senders.submit(send_body, service),
            ]
            with service.client() as client:
                for number in range(20):
                    assert put(service, f"small-{number}") == 201
                    assert client.get("/healthz").status_code == 200
            assert not any(request.done() for request in large)

        assert [request.result() for request in large] == [201, 201, 422]


def test_annotation_of_10000_boxes_is_parsed_and_one_of_more_than_200000_keys_refused():
    """The largest form of a box: eight vertices, and every name that a box may have."""
    places = [[10.0 + n % 2, n % 4 / 4, n / 8] for n in range(8)]
    names = {"class": "car", "type_id": "vehicle.audi.tt", "base_type": "car"}
    boxes = [{"id": f"b{n}", **names, "vertices": places} for n in range(10_000)]
    size = {"width": 1920, "height": 1080, "fov": 90}
    camera = {**size, "transform": dict.fromkeys("xyz", 0)}
    keys = dict.fromkeys(map(str, range(200_001)))

    read = parse_annotation(json.dumps({"camera": camera, "boxes": boxes}).encode())
    with pytest.raises(AnnotationErrors) as refused:
        parse_annotation(json.dumps({**scene.annotation(), "extra": keys}).encode())

    assert len(read.boxes) == 10_000
    assert "JSON of more than 200000 keys" in str(refused.value)
