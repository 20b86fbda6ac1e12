"""A cursor that the service did not make is refused by all lists in the same way."""

BY_NAME = {"/api/v1/datasets", "/api/v1/datasets/{dataset}/frames"}
"""Lists by name: their cursors are names, so any text that can be a name is valid."""
OF_BOXES = {"/api/v1/boxes", "/api/v1/boxes/table"}
INVALID_CURSORS = (
    *("x", "-1", "0", "1.5", "1~", "\u0661", "9" * 30, "W1tbW1tb" * 200),
    *("WzEsMl0", "WzAsSW5maW5pdHksMF0", "WzAsMCwxMDAwMDAwMDAwMDAwMDAwMDAwMDAwMDBd"),
)
INVALID_NAMES = ("\x00", "a\x07", "\u202e")


def lists(api):
    """The paths that take a cursor, as the OpenAPI document has them."""
    paths = api.http.get("/openapi.json").json()["paths"]
    return [
        path
        for path, methods in paths.items()
        for parameter in methods.get("get", {}).get("parameters", ())
        if parameter["name"] == "cursor"
    ]


def test_invalid_cursor_is_refused_by_every_paginated_list(api):
    dataset = api.dataset()
    api.upload_frame(dataset, "a")
    run = api.run(dataset, {"min_visible_pixels": 5}, activate=False)
    box_id = api.boxes(dataset)[0]["box_id"]
    hook = {"url": "http://127.0.0.1:9/", "dataset": dataset}
    hook_id = api.http.post("/api/v1/hooks", json=hook).json()["id"]
    lists_to_read = [
        *((path, "", INVALID_NAMES) for path in BY_NAME),
        *((path, "", INVALID_CURSORS) for path in lists(api) if path not in BY_NAME),
        ("/api/v1/datasets/{dataset}/frames", "id", INVALID_CURSORS),
        ("/api/v1/boxes", "doubt", INVALID_CURSORS),
    ]

    assert len(lists_to_read) > 10
    for path, sort, cursors in lists_to_read:
        url = path.format(
            dataset=dataset, run_id=run["id"], box_id=box_id, hook_id=hook_id
        )
        needed = {"dataset": dataset} if path in OF_BOXES else {}
        needed |= {"sort": sort} if sort else {}
        for cursor in cursors:
            response = api.http.get(url, params={**needed, "cursor": cursor})
            problem = response.json()
            assert (response.status_code, problem.get("code")) == (400, "bad_cursor"), (
                path,
                cursor,
            )
            assert (
                problem["detail"]
                == f"cursor {cursor[:80]!r} is not a cursor of this list"
            )
