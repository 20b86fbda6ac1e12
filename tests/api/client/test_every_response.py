"""Every JSON answer has every field of its model, and the client can read it.

The routes and their models come from the OpenAPI document: a route that is not called
here fails the test. Only answers to a cancel are checked where jobs take long enough
to be cancelled, in `tests/api/runs/test_run_cancel.py` and
`tests/api/exports/test_exports.py`.
"""

import re
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.support import archives, frames, sensors
from tests.support.api import BASE, BY_TAGS, Api
from tests.support.event_reader import parsed
from tests.support.response_checks import assert_matches_model, successful_json
from tests.support.servers import RunningServer
from tests.support.waiting import until
from unghost import wire
from unghost.wire.boxes import BOX_COLUMNS
from unghost.wire.model import ResponseModel

Place = tuple[str, str, int]
"""The method, the path of the route, and the status."""
STRICT = {"min_visible_pixels": 10**6}
CANCELS = {
    ("POST", "/api/v1/runs/{run_id}/cancel", 202),
    ("POST", "/api/v1/exports/{export_id}/cancel", 202),
}
LINES = "application/x-ndjson"


class ResponseCollector:
    """Collects the successful JSON answers that a client gets, by where they came from.

    Parameters
    ----------
    document
        The OpenAPI document of the service.
    """

    def __init__(self, document: Any) -> None:
        self.models: dict[Place, type[ResponseModel]] = {
            (method.upper(), path, int(status)): _model(content["application/json"])
            for path, methods in document["paths"].items()
            for method, route in methods.items()
            for status, response in route["responses"].items()
            for content in [response.get("content", {})]
            if status.startswith("2") and "application/json" in content
        }
        self.got: defaultdict[Place, list[Any]] = defaultdict(list)

    def keep(self, response: httpx.Response) -> None:
        """Keep an answer, if it is JSON and not an error."""
        if response.headers.get("content-type") != "application/json":
            return
        response.read()
        request = response.request.method, response.request.url.path
        # The path with the fewest names in it: /boxes/table is no box.
        path = min(
            (
                path
                for method, path, _ in self.models
                if method == request[0]
                and re.fullmatch(re.sub(r"{\w+}", "[^/]+", path), request[1])
            ),
            key=lambda path: path.count("{"),
        )
        place = (request[0], path, response.status_code)
        self.got[place].append(response.json())


def _model(content: Any) -> type[ResponseModel]:
    name = _name(content["schema"])
    item = re.fullmatch("Page_(.*)_", name)
    model = getattr(wire, item[1] if item else name)
    response_model: object = wire.Page.__class_getitem__(model) if item else model
    assert isinstance(response_model, type)
    assert issubclass(response_model, ResponseModel)
    return response_model


def _name(schema: Any) -> str:
    name: str = schema["$ref"].rpartition("/")[2]
    return name


@pytest.fixture
def api(server: RunningServer) -> Iterator[Api]:
    """A client of its own, since the test listens to its answers."""
    api = Api.at(server.url, server.headers)
    with api.http:
        yield api


@pytest.fixture
def street(api: Api) -> str:
    """A dataset with a frame with optional fields, a plain one, and a refused one."""
    name = api.dataset(config=BY_TAGS)
    seen = {"captured_at": "2026-01-01t00:00:00.5z", "weather": {"cloudiness": 10}}
    archive = [
        *archives.frame("a", number=0, **seen),
        *archives.frame("b", number=1),
        *archives.frame("c", boxes=[{"id": 1}]),
    ]
    told = archives.send(api, name, archives.tar_archive(archive))
    assert told.is_success, told.text
    return name


@pytest.fixture
def folder() -> bytes:
    """An archive in KITTI's layout: a good frame, a bad one, and another file."""
    label = b"Car 0.5 1 -1.57 10 20 30 40 1.5 1.6 4 1 2 20 0.1\n"
    files = {
        "training/label_2/000000.txt": label,
        "training/image_2/000000.png": frames.image(0),
        "training/label_2/000001.txt": b"Car\n",
        "training/image_2/000001.png": frames.image(1),
        "README.md": b"",
    }
    return archives.tar_archive(files.items())


def call_access_routes(api: Api) -> None:
    successful_json(api.post("/tokens", {"name": "somebody"}))
    code = successful_json(api.post("/login-codes", {}))
    api.json(f"/login-codes/{code['id']}")
    successful_json(api.post("/session", {"code": code["code"]}))
    api.json(f"/login-codes/{code['id']}")
    for path in ("/tokens", "/session", "/audit"):
        api.json(path)
    for path in ("/version", "/healthz"):
        successful_json(api.http.get(path))
    # On a busy machine the server may not be ready for a moment.
    until(lambda: api.http.get("/readyz").is_success)


def call_hook_routes(api: Api, street: str) -> None:
    body = {"url": "http://127.0.0.1:9/", "dataset": street}
    made = successful_json(api.post("/hooks", body))
    successful_json(api.post(f"/hooks/{made['id']}/ping"))
    assert api.json("/hooks")["items"]
    assert api.json(f"/hooks/{made['id']}/deliveries")["items"]
    assert api.delete(f"/hooks/{made['id']}").status_code == 204


def call_frame_routes(api: Api, street: str) -> None:
    for _ in range(2):
        api.upload_frame(street, "d")
    for frame in api.json(f"/datasets/{street}/frames")["items"]:
        assert api.json(f"/frames/{frame['id']}")["boxes"]
    api.json(f"/datasets/{street}/frames/d")
    body = {"keys": ["run/a", "d", "unknown"]}
    assert (
        len(
            successful_json(api.post(f"/datasets/{street}/known-frames", body))["items"]
        )
        == 2
    )


def call_box_routes(api: Api, street: str) -> None:
    first, *others = api.box_ids(street, count="true")
    queue = api.post(f"/datasets/{street}/queue", {"order": "random"})
    assert successful_json(queue)["items"]
    for seen in range(2):  # the second time it is not stored again
        successful_json(api.review(first, "keep", seen, comment="it is there"))
    many = {"dataset": street, "box_ids": [first, *others], "verdict": "reject"}
    batch = successful_json(api.post("/reviews/bulk", many))
    assert batch["stale"] == [first]
    api.json(f"/boxes/{first}")
    for what in ("history", "alike", "track"):
        api.json(f"/boxes/{first}/{what}")
    measured, files = api.dataset(), sensors.sensors()
    api.upload_frame(measured, "a", annotation=sensors.ANNOTATION, **files)
    api.json(f"/boxes/{api.box_ids(measured)[0]}/slice")
    every = ",".join(BOX_COLUMNS)
    assert api.json("/boxes/table", dataset=street, fields=every)["rows"]
    with (second := api.person()).http:
        successful_json(second.review(first, "keep", seen=1))
    quality = api.json(f"/datasets/{street}/quality")
    assert quality["suggested"]
    assert quality["agreement"]["pairs"]
    compared = api.json(f"/datasets/{street}/evaluations", truth="people")
    assert compared["channels"]["semantic"]["worst"]
    report = sensors.experiment_report()
    successful_json(api.http.put(f"{BASE}/datasets/{street}/experiment", json=report))
    api.json(f"/datasets/{street}/experiment")
    successful_json(api.post(f"/boxes/{first}/reviews/2/undo"))
    successful_json(api.post(f"/review-batches/{batch['id']}/undo"))
    assert any(not box["review"] for box in api.boxes(street))
    box = api.json(f"/boxes/{first}")
    answer = {"frame": box["frame"], "box": box["id"], "verdict": "unsure"}
    answer |= {"reviewer": "elsewhere", "created_at": "2026-01-01T00:00:00Z"}
    successful_json(
        api.post(f"/datasets/{street}/reviews/import", {"answers": [answer]})
    )
    api.json(f"/boxes/{others[0]}")


def call_config_routes(api: Api, street: str) -> None:
    at = f"/datasets/{street}"
    for _ in range(2):
        version = successful_json(api.post(f"{at}/configs", STRICT))
    api.json(f"/configs/{version['digest']}")
    for path in ("config", "configs"):
        api.json(f"{at}/{path}")
    preview = successful_json(api.post(f"{at}/preview", {"config": STRICT}))
    assert preview["flips"]["items"]
    other_pixels = {"config": {"evidence": "lidar"}}
    assert successful_json(api.post(f"{at}/preview", other_pixels))["needs_pixels"]
    api.wait_for_job(
        api.http.put(BASE + f"{at}/config", json={"digest": version["digest"]})
    )


def call_job_routes(api: Api, street: str) -> None:
    at = f"/datasets/{street}"
    run = api.run(street, {"min_visible_pixels": 1})
    assert api.json(f"/runs/{run['id']}/diff", limit=2)["next_cursor"] is not None
    api.json(f"{at}/runs")
    api.json("/runs")
    api.wait_for_job(api.post(f"{at}/evaluations"))
    labels = {"format": "yolo", "options": {"bands": [50]}, "name": "v1"}
    export = api.wait_for_job(api.post(f"{at}/exports", labels))
    successful_json(api.post(f"/exports/{export['id']}/download-links", {}))
    api.json(f"{at}/exports")
    assert api.json(f"{at}/versions")["items"]
    api.json(f"{at}/parts", split="0.8,0.2")


def call_dataset_routes(api: Api, street: str) -> None:
    at = f"/datasets/{street}"
    for path in ("", "/stats", "/histogram", "/report", "/coached"):
        api.json(at + path)
    refused = api.json(f"{at}/problems")["items"]
    assert [frame["key"] for frame in refused] == ["run/c"]
    api.json("/datasets")
    successful_json(api.post("/datasets?exist_ok=true", {"name": street}))
    successful_json(api.http.patch(BASE + at, json={"description": "a street"}))
    api.wait_for_job(api.http.patch(BASE + at, json={"palette": "carla-0.9.14"}))


def test_every_json_response_has_every_field_of_its_model(api, street):
    collector = ResponseCollector(successful_json(api.http.get("/openapi.json")))
    api.http.event_hooks["response"].append(collector.keep)

    call_access_routes(api)
    call_hook_routes(api, street)
    call_frame_routes(api, street)
    call_box_routes(api, street)
    call_config_routes(api, street)
    call_job_routes(api, street)
    call_dataset_routes(api, street)
    renamed = f"{BASE}/datasets/{api.dataset()}/classes/van"
    api.wait_for_job(api.http.patch(renamed, json={"name": "minivan"}))

    assert collector.got.keys() == collector.models.keys() - CANCELS
    for place, bodies in collector.got.items():
        for body in bodies:
            assert_matches_model(collector.models[place], body)


def test_job_events_have_every_field_of_their_model(api, street):
    labels = api.wait_for_job(
        api.post(f"/datasets/{street}/exports", {"format": "coco"})
    )
    run = api.run(street, STRICT)

    for job, model in (
        (f"runs/{run['id']}", wire.Run),
        (f"exports/{labels['id']}", wire.Export),
    ):
        told = list(parsed(iter(api.get(f"/{job}/events").text.splitlines())))

        assert told[-1].name == "end"
        for event in told:
            assert_matches_model(model, event.data)


def test_every_ndjson_line_has_every_field_of_its_model(api, folder):
    name = api.dataset()
    archive = [*archives.frame("a"), *archives.frame("c", boxes=[{"id": 1}])]
    responses = {
        f"{BASE}/folders": api.http.post(
            f"{BASE}/folders", content=folder, headers=archives.TAR
        ),
        f"{BASE}/datasets/{{dataset}}/batches": archives.send(
            api, name, archives.tar_archive(archive)
        ),
    }
    described = {
        path: [_name(each) for each in content[LINES]["itemSchema"]["anyOf"]]
        for path, methods in successful_json(api.http.get("/openapi.json"))[
            "paths"
        ].items()
        for route in methods.values()
        for content in [route["responses"].get("200", {}).get("content", {})]
        if LINES in content
    }

    assert responses.keys() == described.keys()
    for path, names in described.items():
        lines = archives.lines_of(responses[path].text)
        kinds = [_kind_of(line, names) for line in lines]
        assert set(kinds) == set(names)
        for line, kind in zip(lines, kinds, strict=True):
            assert_matches_model(getattr(wire, kind), line)


def test_last_line_for_a_truncated_archive_has_every_field(api):
    whole = archives.tar_archive([*archives.frame("a"), *archives.frame("b")])

    response = archives.send(api, api.dataset(), whole[: len(whole) // 2])

    end = archives.lines_of(response.text)[-1]
    assert end["problem"]["status"] == 422
    assert_matches_model(wire.BatchEnd, end)


def _kind_of(line: Any, names: list[str]) -> str:
    """The only model among `names` that has all keys of the line."""
    (kind,) = (name for name in names if line.keys() <= _keys_of(getattr(wire, name)))
    return kind


def _keys_of(model: type[ResponseModel]) -> set[str]:
    return {field.alias or name for name, field in model.model_fields.items()}
