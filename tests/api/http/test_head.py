"""HEAD answers as GET does, with the same roles and headers but without a body."""

import pytest

from tests.support.live import live
from tests.support.routes import NO_ROLE, REQUIRED_ROLES, fill_path
from tests.support.waiting import until

PATHS = sorted(path for method, path in REQUIRED_ROLES if method == "GET")
DRAWINGS = {"/api/v1/frames/{frame_id}/thumbnail", "/api/v1/frames/{frame_id}/overlay"}
DRAWINGS |= {"/api/v1/boxes/{box_id}/crop", "/api/v1/boxes/crops"}
QUERIES = {
    "/api/v1/boxes": "?dataset=street",
    "/api/v1/boxes/table": "?dataset=street",
    "/api/v1/boxes/crops": "?crops={box_id}-0.25-256",
    "/api/v1/runs/{run_id}/diff": "?against=1",
    "/api/v1/exports/{export_id}/file": "?key={key}",
}
CHANGING = {"/metrics", "/readyz"}
HEADERS_OF_EACH = {"date", "x-request-id", "transfer-encoding"}


def url_of(path, path_values):
    """The address of a route, with the query that it needs."""
    return fill_path(path, path_values) + QUERIES.get(path, "").format(**path_values)


def status_and_headers(response, *, less=frozenset()):
    """The status and the headers, without `less` and those that always differ."""
    headers = {
        k: v
        for k, v in response.headers.items()
        if k not in HEADERS_OF_EACH | set(less)
    }
    return response.status_code, headers


@pytest.mark.parametrize("path", PATHS)
def test_head_has_the_status_and_headers_of_get_without_a_body(
    admin, path_values, path
):
    url = url_of(path, path_values)

    def ask():
        get, head = admin.get(url), admin.head(url)
        # On a busy machine the service may not be ready for a moment.
        is_late = path == "/readyz" and not (get.is_success and head.is_success)
        return None if is_late else (get, head)

    get, head = until(ask)

    length = {"content-length"} if path in DRAWINGS | CHANGING else set()
    assert status_and_headers(head, less=length) == status_and_headers(get, less=length)
    assert head.content == b""
    assert get.status_code == 200, get.text


def test_head_needs_the_same_authentication_as_get(anonymous, as_role, path_values):
    viewer = as_role("viewer")

    for path in PATHS:
        url = url_of(path, path_values)
        is_open = REQUIRED_ROLES["GET", path] is NO_ROLE
        for client in (anonymous, viewer) if path != "/readyz" else ():
            get, head = client.get(url), client.head(url)
            assert head.status_code == get.status_code
            assert (get.status_code == 401) == (client is anonymous and not is_open)


def test_head_refuses_unknown_query_parameters(admin, path_values):
    nonsense = {"nonsense": "1"}

    statuses = {
        path: admin.head(fill_path(path, path_values), params=nonsense).status_code
        for path in PATHS
        if path != "/"
    }

    assert set(statuses.values()) == {400}, statuses


@pytest.mark.parametrize("path", sorted(DRAWINGS))
def test_head_of_a_drawn_image_draws_nothing(admin, path_values, path):
    """Otherwise a client could make the server draw without reading any picture."""
    url = url_of(path, path_values)
    head = admin.head(url)
    same = {"If-None-Match": head.headers["etag"]}

    assert head.status_code == 200
    assert "content-length" not in head.headers
    assert admin.head(url, headers=same).status_code == 304


def test_head_of_a_byte_range_matches_get(admin, path_values):
    path = fill_path("/api/v1/frames/{frame_id}/{kind}", path_values)
    some = {"Range": "bytes=3-9"}
    none = {"Range": "bytes=999999-"}

    assert status_and_headers(admin.head(path, headers=some)) == status_and_headers(
        admin.get(path, headers=some)
    )
    assert status_and_headers(admin.head(path, headers=none)) == status_and_headers(
        admin.get(path, headers=none)
    )
    assert admin.head(path, headers=some).status_code == 206


def test_head_of_a_write_only_path_returns_405(admin):
    response = admin.head("/api/v1/reviews/bulk")

    assert (response.status_code, response.headers["allow"]) == (405, "POST")


def test_head_of_an_event_stream_opens_no_stream(tmp_path):
    with (
        live(tmp_path / "data", max_event_streams=1) as service,
        service.admin() as admin,
    ):
        dataset = admin.post("/api/v1/datasets", json={"name": "street"}).json()
        events = f"/api/v1/runs/{dataset['active_run']}/events"
        responses = [admin.head(events) for _ in range(3)]
        seen = admin.get("/metrics").text

    assert [response.status_code for response in responses] == [200] * 3
    assert responses[0].headers["content-type"].startswith("text/event-stream")
    assert "unghost_event_streams_open 0" in seen
