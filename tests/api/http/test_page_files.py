"""The HTML and the files of the page, and the description of the API."""

import base64
import hashlib
import re

import pytest

from app.errors import NotFound
from app.http.static import content_security_policy, page_file, version_of
from app.package import static_dir

FILES = sorted(
    path.relative_to(static_dir()).as_posix()
    for path in static_dir().rglob("*")
    if path.suffix in (".css", ".js", ".html", ".json", ".svg")
)
TYPES = {
    "css": "text/css; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "svg": "image/svg+xml",
}


def test_page_has_two_scripts_with_all_of_its_modules(anonymous):
    """Each of nearly a hundred modules would be a request, many after one another."""
    page = anonymous.get("/").text
    path = versioned_static_path(anonymous)
    named = re.findall(r'<script type="module" src="([^"]+)"', page)
    modules = {
        name for name in FILES if re.match(r"js/(?!core/theme_first).*\.js", name)
    }

    first, later = (anonymous.get(f"{path}{name}") for name in ("first.js", "later.js"))

    assert named == [f"{path}first.js"]
    assert first.headers["content-type"] == TYPES["js"]
    assert "immutable" in first.headers["cache-control"]
    both = first.text + later.text
    assert {name for name in modules if f"// {name}\n" not in both} == set()
    assert "vendor/uplot" not in first.text, "loaded with a view that has a chart"
    assert "vendor/uplot" in later.text


def test_page_has_one_style_sheet_with_all_of_its_styles(anonymous):
    """A dozen of them would be a dozen requests before anything is drawn."""
    page = anonymous.get("/").text
    named = re.findall(r'rel="stylesheet" href="([^"]+)"', page)
    source = (static_dir() / "index.html").read_text("utf-8")
    sheets = re.findall(r'rel="stylesheet" href="/static/([^"]+)"', source)

    assert named == [f"{versioned_static_path(anonymous)}styles.css"]
    response = anonymous.get(named[0])

    assert response.headers["content-type"] == TYPES["css"]
    assert "immutable" in response.headers["cache-control"]
    places = [
        response.text.index((static_dir() / sheet).read_text("utf-8"))
        for sheet in sheets
    ]
    assert places == sorted(places)
    assert {"css/base.css", "css/grid.css", "vendor/uplot-1.6.32.css"} < set(sheets)
    # They would be searched for in the folder of the one sheet.
    assert "url(" not in response.text
    assert "@import" not in response.text


@pytest.mark.parametrize(
    "name", {name.rpartition(".")[2]: name for name in FILES}.values()
)
def test_static_file_has_its_content_type(anonymous, name):
    response = anonymous.get(f"/static/{name}")

    assert response.content == (static_dir() / name).read_bytes()
    assert response.headers["content-type"] == TYPES[name.rpartition(".")[2]]
    assert response.headers["x-content-type-options"] == "nosniff"


def test_if_none_match_of_a_static_file_or_the_openapi_document_returns_304(anonymous):
    for url in (f"/static/{FILES[0]}", "/openapi.json"):
        # Weak, since the response is compressed.
        etag = anonymous.get(url).headers["etag"].removeprefix("W/")

        again = anonymous.get(url, headers={"If-None-Match": f'"other", W/{etag}'})
        other = anonymous.get(url, headers={"If-None-Match": '"other"'})

        assert (again.status_code, again.content, other.status_code) == (304, b"", 200)
        assert again.headers["etag"].removeprefix("W/") == etag
    assert other.headers["content-type"] == "application/json"


def versioned_static_path(client):
    """The path, with its version, below which the page names its files."""
    return re.findall(r'"(/static/v-\w+/)first.js"', client.get("/").text)[0]


def test_only_static_files_of_the_present_version_are_cached_as_immutable(anonymous):
    page = anonymous.get("/")
    present = versioned_static_path(anonymous)
    paths = (present, "/static/", "/static/v-0123456789abcdef/")

    responses = [anonymous.get(f"{path}{FILES[0]}") for path in paths]

    cached = [response.headers["cache-control"] for response in responses]
    assert "immutable" in cached[0]
    assert [page.headers["cache-control"], *cached[1:]] == ["no-cache"] * 3
    content = (static_dir() / FILES[0]).read_bytes()
    assert [response.content for response in responses] == [content] * 3
    assert re.findall(r'"/static/(?!v-)[^"]*', page.text) == []


def test_static_version_and_etag_change_with_any_file_change(tmp_path):
    file, other = tmp_path / "a.js", tmp_path / "b.js"
    file.write_text("1")
    versions, before = [version_of(tmp_path)], page_file(tmp_path, "a.js")
    for change in (lambda: file.write_text("22"), other.touch, file.unlink):
        change()
        versions.append(version_of(tmp_path))
        if file.exists():
            after = page_file(tmp_path, "a.js")

    assert len(set(versions)) == 4
    assert (before.content, after.content) == (b"1", b"22")
    assert before.etag != after.etag


@pytest.mark.parametrize(
    "name",
    [
        "../pyproject.toml",
        "%2e%2e/pyproject.toml",
        "..%2fpyproject.toml",
        "js/../../pyproject.toml",
        "/etc/hostname.txt",
        "//etc/passwd",
        "..\\pyproject.toml",
        "js%00.js",
        "js",
        "",
        "x" * 5000 + ".js",
    ],
)
def test_path_traversal_in_a_static_path_returns_404(service, name):
    """The path is sent unchanged: most clients would normalise it first."""
    import http.client

    connection = http.client.HTTPConnection(service.url.removeprefix("http://"))
    connection.request("GET", f"/static/{name}")
    status = connection.getresponse().status
    connection.close()

    assert status == 404


def test_symlink_out_of_the_static_folder_is_not_followed(tmp_path):
    (tmp_path / "secret.js").write_text("secret")
    page = tmp_path / "page"
    page.mkdir()
    (page / "link.js").symlink_to(tmp_path / "secret.js")

    with pytest.raises(NotFound, match=r"no file 'link.js'"):
        page_file(page, "link.js")


def test_page_has_no_inline_script_blocked_by_its_policy(anonymous):
    page = anonymous.get("/")

    scripts = re.findall(r"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", page.text, re.S)
    policy = page.headers["content-security-policy"]
    for text in scripts:
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert digest in policy
    assert policy.count("sha256-") == len(scripts)


def test_content_security_policy_allows_only_the_import_map(tmp_path):
    text = b'{"imports": {"preact": "/static/vendor/preact.js"}}'
    index = tmp_path / "index.html"
    index.write_bytes(
        b'<script type="importmap">' + text + b"</script><script>x</script>"
    )

    policy = content_security_policy(index)

    digest = base64.b64encode(hashlib.sha256(text).digest()).decode()
    assert f"script-src 'self' 'sha256-{digest}';" in policy
    assert policy.count("sha256-") == 1


def test_api_docs_page_names_every_route(admin):
    schema = admin.get("/openapi.json").json()

    page = admin.get("/docs")

    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert "<script" not in page.text
    # Nothing comes from elsewhere.
    assert re.search(r"""(?:src|href|url)\W{1,3}https?:""", page.text) is None
    assert [path for path in schema["paths"] if path not in page.text] == []
    assert 'href="/static/css/docs.css"' in page.text
