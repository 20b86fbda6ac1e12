"""Uploaded files are stored under our own names and served only as data."""

import io
import struct
import zipfile

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.pictures import chunk

PAGE = b"<html><script>alert(1)</script></html>"
SVG = b"<svg xmlns='http://www.w3.org/2000/svg' onload='alert(1)'/>"
PATH = "/api/v1/datasets/files/frames"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    from tests.support.live import live

    with live(tmp_path_factory.mktemp("files") / "data") as running:
        with running.admin() as client:
            client.post("/api/v1/datasets", json={"name": "files"})
        yield running


def upload(client, key, image, name="a.png", media_type="image/png", **more):
    files = {
        "annotation": scene.as_json(scene.annotation()),
        "image": (name, image, media_type),
        **more,
    }
    return client.put(f"{PATH}/{key}", files=files)


def stored(client, key, image, **how):
    response = upload(client, key, image, **how)
    assert response.status_code == 201, response.text
    return response.json()["frame"]["id"]


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(scene.image(1) + PAGE, id="a page behind the picture"),
        pytest.param(
            # After its header, there is one more chunk.
            scene.image(2)[:33]
            + chunk(b"tEXt", b"Comment\0" + PAGE)
            + scene.image(2)[33:],
            id="a page inside it",
        ),
    ],
)
def test_image_with_embedded_html_is_served_as_an_image(admin, image):
    name = "x.html"
    frame_id = stored(admin, f"p{len(image)}", image, name=name, media_type="text/html")

    response = admin.get(f"/api/v1/frames/{frame_id}/image")

    assert response.content == image
    assert response.headers["content-type"] == "image/png"
    assert response.headers["x-content-type-options"] == "nosniff"
    assert response.headers["content-security-policy"] == "default-src 'none'; sandbox"
    assert name not in str(response.headers)


PICTURES = ("image", "segmentation", "depth", "instances", "ignore_mask")


def test_every_file_of_a_frame_is_served_at_its_url(admin):
    sent = {kind: scene.image(number) for number, kind in enumerate(PICTURES)}
    sent["segmentation"] = scene.segmentation()
    files = {kind: (f"{kind}.png", content) for kind, content in sent.items()}
    annotation = {"annotation": scene.as_json(scene.annotation())}

    response = admin.put(f"{PATH}/of-every-kind", files={**annotation, **files})

    assert response.status_code == 201, response.text
    listed = response.json()["frame"]["files"]
    assert {
        kind: admin.get(file["url"]).content for kind, file in listed.items()
    } == sent


@pytest.mark.parametrize("content", [SVG, b"<?xml version='1.0'?>" + SVG, PAGE])
@pytest.mark.parametrize("part", ["image", "segmentation", "ignore_mask", "lidar"])
def test_svg_or_html_file_is_refused_despite_its_media_type(admin, part, content):
    files = {"annotation": scene.as_json(scene.annotation())}
    files |= {part: ("a.png", content, "image/png")}

    response = admin.put(f"{PATH}/refused", files=files)

    code = "bad_lidar" if part == "lidar" else "bad_image"
    assert (response.status_code, response.json()["code"]) == (422, code)
    assert admin.get(f"{PATH}/refused").status_code == 404


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "C:\\x.png", "\\\\host\\share", "/etc/passwd", "a\0b"]
)
def test_uploaded_file_name_is_never_used_as_a_path(service, admin, name):
    before = outside_of_blobs(service)

    upload(admin, "named", scene.image(3), name=name.replace("\0", "%00"))

    assert outside_of_blobs(service) == before
    blobs = (service.settings.data / "blobs").rglob("*")
    names = {path.name for path in blobs if path.is_file()}
    assert all(set(name) <= set("0123456789abcdef") for name in names)


def outside_of_blobs(service):
    folder = service.settings.data
    return sorted(
        path.name for path in folder.iterdir() if not path.name.startswith("unghost.db")
    ) + sorted(path.name for path in folder.parent.iterdir())


def zip_of(*names):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(name, bytes(1_000_000))
    return out.getvalue()


def test_nested_archive_is_not_unpacked(admin):
    members = [("inner.zip", zip_of("b.json")), *frame("nested")]

    response = send(Api(admin), "files", tar_archive(members))

    *_, end = lines_of(response.text)
    assert admin.get(f"{PATH}/b").status_code == 404
    assert end["stored"] <= 1


def test_macos_files_in_an_archive_are_refused_others_are_stored(admin):
    leftovers = [("__MACOSX/._tidy.json", b"\0\5\26\7"), (".DS_Store", b"\0\0\0\1")]

    response = send(Api(admin), "files", tar_archive([*leftovers, *frame("tidy")]))

    *lines, end = lines_of(response.text)
    assert {line["status"] for line in lines} == {201, 422}
    assert (end["stored"], "problem" in end) == (1, False)


@pytest.mark.parametrize("damaged", ["checksum", "pixels"])
def test_damaged_segmentation_is_refused(admin, damaged):
    content = bytearray(scene.segmentation())
    at = content.index(b"IDAT")
    size = struct.unpack(">I", content[at - 4 : at])[0]
    content[at + 4 + (size if damaged == "checksum" else size // 2)] ^= 0xFF

    files = {"segmentation": ("s.png", bytes(content), "image/png")}
    response = upload(admin, f"damaged-{damaged}", scene.image(4), **files)

    assert (response.status_code, response.json()["code"]) == (422, "bad_image")


def test_image_with_damaged_pixels_causes_no_server_error(admin):
    content = bytearray(scene.image(5))
    content[content.index(b"IDAT") + 8] ^= 0xFF

    response = upload(admin, "damaged", bytes(content))

    assert response.status_code in {201, 422}
    if response.status_code == 201:
        frame_id = response.json()["frame"]["id"]
        box = response.json()["decisions"][0]["box_id"]
        frame, box = f"frames/{frame_id}", f"boxes/{box}"
        for drawing in (f"{frame}/thumbnail", f"{frame}/overlay", f"{box}/crop"):
            assert admin.get(f"/api/v1/{drawing}").status_code in {200, 404, 422}
