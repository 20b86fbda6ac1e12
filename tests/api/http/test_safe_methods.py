"""GET changes nothing, and text from users is never sent as HTML."""

from tests.support.filled_database import contents
from tests.support.routes import REQUIRED_ROLES, fill_path

MARKUP = "<img src=x onerror=alert(1)>"


def paths_of_get_routes(values):
    return [
        fill_path(path, values)
        for method, path in sorted(REQUIRED_ROLES)
        if method == "GET"
    ]


def rows_of(service):
    """Every row of the database, but without the time when a token was last used.

    The service writes that time once a minute, and no GET does: see
    test_token_lifetimes.
    """
    rows = contents(service.app.state.database.engine)
    rows["tokens"] = [{**row, "last_used_at": None} for row in rows["tokens"]]
    return rows


def files_of(service):
    """Every stored file with its content, but not the files of the database."""
    files = (path for path in service.settings.data.rglob("*") if path.is_file())
    kept = (path for path in files if not path.name.startswith("unghost.db"))
    return {path: path.read_bytes() for path in kept}


def test_no_get_has_a_side_effect(service, admin, path_values):
    """An image on any page of the web can make a browser send a GET."""
    rows, files = rows_of(service), files_of(service)
    data = service.settings.data

    for path in paths_of_get_routes(path_values):
        admin.get(path)
        admin.get(path, params={"confirm": "street"})

    assert rows_of(service) == rows
    left = files_of(service)
    # Pictures may be drawn and kept; they show only what the image does.
    folders = {path.relative_to(data).parts[0] for path in left.keys() - files.keys()}
    assert folders <= {"pictures"}
    assert files.items() <= left.items()


def test_only_the_page_and_the_api_docs_are_html(admin, path_values):
    pages, with_markup = set(), 0
    for path in paths_of_get_routes(path_values):
        response = admin.get(path)
        if response.headers.get("content-type", "").startswith("text/html"):
            pages.add(path)
            assert "onerror" not in response.text
        with_markup += MARKUP in response.text.replace("\\u003c", "<")
        assert response.headers["x-content-type-options"] == "nosniff"
        assert "unsafe" not in response.headers["content-security-policy"]

    assert pages == {"/", "/docs"}
    assert with_markup >= 3


def test_markup_in_a_path_or_an_accept_header_of_html_is_answered_with_json(
    admin, path_values
):
    for query, status in (("", 404), ("?callback=alert", 400), ("?jsonp=alert", 400)):
        response = admin.get(f"/api/v1/datasets/{MARKUP}{query}")
        assert response.headers["content-type"] == "application/problem+json"
        assert response.status_code == status
    types = {
        admin.get(path, headers={"Accept": "text/html"})
        .headers["content-type"]
        .partition(";")[0]
        for path in ("/api/v1/datasets", "/api/v1/datasets/street", "/no/such/page")
    }

    assert types == {"application/json", "application/problem+json"}


def test_get_with_a_method_override_does_not_delete(admin, path_values):
    tricks = {"X-HTTP-Method-Override": "DELETE", "X-Method-Override": "DELETE"}

    response = admin.get("/api/v1/datasets/street", headers=tricks)

    assert response.status_code == 200
    assert admin.get("/api/v1/datasets/street?_method=DELETE").status_code == 400
