"""Boxes as columns, and filters of boxes by what is known of their frames."""

import gzip
import json
from typing import Any

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from unghost.wire.boxes import BOX_COLUMNS, USUAL_COLUMNS, BoxTable

NAME = "places"
PLACES = (
    ("a/1", "Town01", "front", "drive-1"),
    ("a/2", "Town01", "rear", "drive-1"),
    ("b/1", "Town02", "front", "drive-2"),
    ("c/1", None, None, None),
)


@pytest.fixture(scope="module")
def boxes(own_api: Api) -> Api:
    """An API with a dataset of four frames, of two boxes each."""
    own_api.dataset(name=NAME, classes=["car"])
    for key, town, camera, sequence in PLACES:
        annotation: dict[str, Any] = scene.annotation()
        annotation |= {"map": town, "sequence": sequence}
        annotation["camera"] |= {} if camera is None else {"name": camera}
        own_api.upload_frame(NAME, key, annotation)
    return own_api


def table(api: Api, **query: Any) -> Any:
    response = api.http.get("/api/v1/boxes/table", params={"dataset": NAME, **query})
    assert response.status_code == 200, response.text
    table = response.json()
    assert all(len(column) == table["rows"] for column in table["columns"].values())
    return table


def listed(api: Api, **query: Any) -> Any:
    response = api.http.get("/api/v1/boxes", params={"dataset": NAME, **query})
    return response.json()["items"]


def test_table_has_the_values_of_the_list(boxes):
    columns = table(boxes, fields=",".join(BOX_COLUMNS))["columns"]

    BoxTable.model_validate({"columns": columns, "rows": 8, "next_cursor": None})
    rows = [
        dict(zip(columns, row, strict=True))
        for row in zip(*columns.values(), strict=True)
    ]
    for row, box in zip(rows, listed(boxes), strict=True):
        same = set(box) & set(row) - {"hidden_by", "review"}
        assert {name: row[name] for name in same} == {name: box[name] for name in same}
        assert len(same) == 22
        assert row["box"] == box["id"]
        assert [row[name] for name in ("x_min", "y_min", "x_max", "y_max")] == box[
            "xyxy"
        ]


def test_usual_columns_are_those_that_are_fast(boxes):
    assert tuple(table(boxes)["columns"]) == USUAL_COLUMNS
    assert list(table(boxes, fields="class,box")["columns"]) == ["box", "class"]


def test_pages_of_a_table_have_whole_frames_and_a_link(boxes):
    first = boxes.http.get("/api/v1/boxes/table", params={"dataset": NAME, "limit": 3})
    keys, cursor = first.json()["columns"]["frame"], first.json()["next_cursor"]
    while cursor is not None:
        page = table(boxes, limit=3, cursor=cursor)
        keys += page["columns"]["frame"]
        cursor = page["next_cursor"]

    assert first.json()["rows"] == 2
    assert (
        boxes.http.get(first.links["next"]["url"]).json()["columns"]["frame"]
        == ["a/2"] * 2
    )
    assert keys == [key for key, *_ in PLACES for _ in range(2)]


@pytest.mark.parametrize("path", ["/boxes", "/boxes/table"])
def test_unknown_field_is_named_with_the_nearest(boxes, path):
    response = boxes.get(path, dataset=NAME, fields="frame,verdikt")

    assert (response.status_code, response.json()["code"]) == (400, "unknown_field")
    assert response.json()["detail"].endswith(
        "found 'verdikt'; did you mean 'verdict'?"
    )


def test_list_of_boxes_has_only_the_fields_that_were_asked_for(boxes):
    whole = boxes.json("/boxes", dataset=NAME)["items"]
    some = boxes.json("/boxes", dataset=NAME, fields="frame, id,class,question")

    names = ("frame", "id", "class", "question")
    assert some["items"] == [{name: box[name] for name in names} for box in whole]
    assert [*some["items"][0]] == [*names]


@pytest.mark.parametrize(
    ("query", "keys"),
    [
        ({"frame": "a/2"}, ["a/2"]),
        ({"map": "Town01"}, ["a/1", "a/2"]),
        ({"camera": "front"}, ["a/1", "b/1"]),
        ({"sequence": "drive-1", "camera": "rear"}, ["a/2"]),
        ({"frame": "a"}, []),
        ({"map": "Town01", "verdict": "rejected"}, ["a/1", "a/2"]),
    ],
)
def test_boxes_are_filtered_by_what_is_known_of_their_frames(boxes, query, keys):
    expected = [key for key in keys for _ in range(1 if "verdict" in query else 2)]
    counted = boxes.http.get(
        "/api/v1/boxes", params={"dataset": NAME, "count": True, **query}
    ).json()
    of_frames = boxes.http.get(f"/api/v1/datasets/{NAME}/frames", params=query).json()

    assert (
        sorted(box["frame"] for box in listed(boxes, sort="doubt", **query)) == expected
    )
    assert table(boxes, **query)["columns"]["frame"] == expected
    assert counted["total"] == len(expected)
    assert [frame["key"] for frame in of_frames["items"]] == keys


def test_name_of_a_camera_must_be_a_text(boxes):
    annotation: dict[str, Any] = scene.annotation()
    annotation["camera"] |= {"name": 7}
    response = boxes.put(NAME, "d/1", annotation)

    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == "/camera/name"


@pytest.mark.parametrize(
    ("accepted", "encoding"),
    [
        ("gzip, br", "gzip"),
        ("br;q=1, GZIP;q=0.5", "gzip"),
        ("gzip;q=0", None),
        ("identity", None),
    ],
)
def test_json_is_compressed_for_those_that_accept_it(boxes, accepted, encoding):
    request = boxes.http.build_request(
        "GET",
        "/api/v1/boxes",
        params={"dataset": NAME},
        headers={"Accept-Encoding": accepted},
    )
    response = boxes.http.send(request, stream=True)
    sent = b"".join(response.iter_raw())
    plain = sent if encoding is None else gzip.decompress(sent)

    assert response.headers.get("content-encoding") == encoding
    assert int(response.headers["content-length"]) == len(sent)
    assert json.loads(plain)["items"] == listed(boxes)
    assert encoding is None or len(sent) < len(plain) / 4
