"""Files and pictures of a frame: exact bytes, caching, and requests for parts."""

import io
import os
import tarfile

import cv2
import numpy as np
import pytest

from app.boxes.drawing import PICTURES, make_room_for_pictures
from filter_core.segmentation.palettes import FAMILIES
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.pictures import png

CONTENT = scene.segmentation()
SIZE = len(CONTENT)


@pytest.fixture(scope="module")
def stored(api):
    return api.upload_frame(api.dataset(), "a")


@pytest.fixture(scope="module")
def path(stored):
    return f"{BASE}/frames/{stored['frame']['id']}/segmentation"


def decoded(response):
    return cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR)


def test_file_is_returned_with_immutable_cache_headers(api, stored, path):
    response = api.http.get(path)

    sha256 = stored["frame"]["files"]["segmentation"]["sha256"]
    names = ("etag", "content-type", "cache-control", "content-security-policy")
    assert response.content == CONTENT
    assert [response.headers[name] for name in names] == [
        f'"{sha256}"',
        "image/png",
        "private, max-age=31536000, immutable",
        "default-src 'none'; sandbox",
    ]
    assert response.headers["x-content-type-options"] == "nosniff"


def test_if_none_match_of_a_file_returns_304_and_another_if_range_the_file(api, path):
    etag = api.http.get(path).headers["etag"]

    for form in ("{}", "W/{}", '"other", {}', "*"):
        response = api.http.get(path, headers={"If-None-Match": form.format(etag)})
        assert (response.status_code, response.content) == (304, b""), form
        assert response.headers["etag"] == etag
    headers = {"Range": "bytes=0-3", "If-Range": '"another"'}
    assert api.http.get(path, headers=headers).content == CONTENT


@pytest.mark.parametrize(
    ("byte_range", "status", "part"),
    [
        ("bytes=0-3", 206, CONTENT[:4]),
        ("bytes=-5", 206, CONTENT[-5:]),
        ("bytes=8-", 206, CONTENT[8:]),
        (f"bytes={SIZE - 1}-{SIZE * 9}", 206, CONTENT[-1:]),
        ("bytes=0-1,4-5", 200, CONTENT),
        ("bytes=5-2", 200, CONTENT),
        ("bytes=", 200, CONTENT),
        ("bytes=a-b", 200, CONTENT),
        ("pixels=0-1", 200, CONTENT),
        ("bytes=\xb2-", 200, CONTENT),
        ("bytes=" + "9" * 5000 + "-", 200, CONTENT),
        (f"bytes={SIZE}-", 416, None),
        ("bytes=-0", 416, None),
    ],
)
def test_single_byte_range_is_served_and_invalid_range_ignored(
    api, path, byte_range, status, part
):
    """Superscript digits and numbers of five thousand digits used to give a 500."""
    response = api.http.get(path, headers=[(b"Range", byte_range.encode("latin-1"))])

    assert response.status_code == status
    if part is None:
        assert response.headers["content-range"] == f"bytes */{SIZE}"
        assert response.json()["code"] == "range_not_satisfiable"
    else:
        assert response.content == part


def test_missing_file_of_a_frame_returns_404(api, stored):
    frame = stored["frame"]["id"]

    responses = [api.get(f"/frames/{frame}/{kind}") for kind in ("depth", "lidar")]

    assert [response.status_code for response in responses] == [404, 404]
    assert responses[0].json()["detail"] == f"frame {frame} has no file 'depth'"


def test_segmentation_overlay_without_boxes_has_exact_palette_colours(api, stored):
    frame = stored["frame"]["id"]

    response = api.get(f"/frames/{frame}/overlay", layer="segmentation", boxes="")

    painted = FAMILIES[scene.FAMILY].paint(scene.tags())
    assert response.headers["content-type"] == "image/png"
    np.testing.assert_array_equal(decoded(response)[..., ::-1], painted)


def test_segmentation_of_a_changed_carla_is_measured_and_painted_by_its_names(api):
    config = {"palette": "carla-0.9.10", "tags": {"100": "Car", "40": "Pedestrian"}}
    dataset = api.dataset(config=config)
    numbers = np.full((scene.HEIGHT, scene.WIDTH), 7, np.uint8)  # Road of 0.9.10
    numbers[10:30, 10:30] = 100
    frame = {"boxes": [{"class": "car", "xyxy": [10, 10, 30, 30]}]}

    stored = api.upload_frame(dataset, "a", frame, segmentation=png(numbers))

    assert stored["frame"]["counts"]["kept"] == 1
    drawn = api.get(
        f"/frames/{stored['frame']['id']}/overlay", layer="segmentation", boxes=""
    )
    newest = FAMILIES["carla-0.9.14"]
    tags = np.where(numbers == 100, newest.tag_of("Car"), newest.tag_of("Road"))
    painted = newest.paint(tags.astype(np.uint8))
    np.testing.assert_array_equal(decoded(drawn)[..., ::-1], painted)


def test_boxes_are_drawn_by_their_effective_verdict(api):
    dataset = api.dataset()
    frame = api.upload_frame(dataset, "a")["frame"]["id"]
    first = api.get(f"/frames/{frame}/overlay", boxes="kept")
    ghost = api.boxes(dataset, verdict="rejected")[0]["box_id"]

    assert api.review(ghost, "keep").status_code == 201
    again = api.http.get(first.url, headers={"If-None-Match": first.headers["etag"]})

    assert first.headers["content-type"] == "image/webp"
    assert again.status_code == 200
    assert decoded(again).shape == (scene.HEIGHT, scene.WIDTH, 3)
    x, y = scene.IN_THE_SKY[:2]
    assert decoded(first)[y, x].max() < 40
    assert decoded(again)[y, x].max() > 90


def test_thumbnail_is_small_and_returns_304_for_its_etag(api, stored):
    url = f"{BASE}/frames/{stored['frame']['id']}/thumbnail"

    response = api.http.get(url)
    again = api.http.get(url, headers={"If-None-Match": response.headers["etag"]})

    assert decoded(response).shape == (scene.HEIGHT, scene.WIDTH, 3)
    assert again.status_code == 304


def test_picture_with_a_version_in_its_address_is_drawn_once_and_kept(
    api, server, stored
):
    box = stored["decisions"][0]["box_id"]

    responses = [api.get(f"/boxes/{box}/crop", height=48, v=word) for word in ("", "1")]

    assert [response.headers["cache-control"] for response in responses] == [
        *("private, no-cache", "private, max-age=31536000, immutable")
    ]
    tag = responses[0].headers["etag"].strip('"')
    kept = server.data / PICTURES / tag[:2] / tag
    assert kept.read_bytes() == responses[0].content == responses[1].content


def test_oldest_pictures_make_room_for_others(tmp_path):
    for number, name in enumerate(("aa/old", "bb/new")):
        path = tmp_path / name
        path.parent.mkdir()
        path.write_bytes(bytes(100))
        os.utime(path, (number, number))

    make_room_for_pictures(tmp_path, most_bytes=150)

    assert [path.name for path in tmp_path.glob("*/*")] == ["new"]


def test_crop_of_each_layer_has_the_requested_height(api, stored):
    path = f"/boxes/{stored['decisions'][0]['box_id']}/crop"

    for layer in ("image", "segmentation", "blend"):
        response = api.get(path, layer=layer, pad=0, height=32)
        assert decoded(response).shape == (32, 40, 3), layer


def test_invalid_crop_parameters_are_refused(api, stored):
    path = f"{BASE}/boxes/{stored['decisions'][0]['box_id']}/crop"

    for query in ("pad=NaN", "height=1", "layer=radar"):
        assert api.http.get(f"{path}?{query}").status_code == 422, query
    assert api.http.get(f"{path}?zoom=2").status_code == 400
    for crops in ("", "1", "1-0.5", "1-0.5-8", "1-11-64", "1-.5-64,"):
        response = api.http.get(f"{BASE}/boxes/crops", params={"crops": crops})
        assert response.status_code == 422, crops
        assert response.json()["errors"][0]["pointer"] == "/query/crops"


def test_crops_of_several_boxes_are_those_of_each(api, stored):
    boxes = [decision["box_id"] for decision in stored["decisions"]]
    words = [f"{boxes[0]}-0.5-64", f"{boxes[1]}-0-32", "999999-0.25-64"]

    response = api.get("/boxes/crops", crops=",".join(words))

    assert response.headers["content-type"] == "application/x-tar"
    with tarfile.open(fileobj=io.BytesIO(response.content)) as archive:
        names = archive.getnames()
        files = [archive.extractfile(name) for name in names]
        contents = [file.read() for file in files if file is not None]
    assert names == [f"{word}.webp" for word in words]
    assert contents == [
        api.get(f"/boxes/{boxes[0]}/crop", pad=0.5, height=64).content,
        api.get(f"/boxes/{boxes[1]}/crop", pad=0, height=32).content,
        b"",
    ]


def test_crops_of_intact_images_come_beside_a_damaged_one(api, server):
    dataset = api.dataset()
    frames = [
        api.upload_frame(dataset, key, image=scene.image(level))
        for key, level in (("a", 40), ("b", 90))
    ]
    boxes = [frame["decisions"][0]["box_id"] for frame in frames]
    files = api.get(f"/frames/{frames[0]['frame']['id']}").json()["files"]
    (path,) = server.data.glob(f"blobs/**/{files['image']['sha256']}*")
    path.unlink()

    response = api.get("/boxes/crops", crops=f"{boxes[0]}-0.5-64,{boxes[1]}-0.5-64")

    with tarfile.open(fileobj=io.BytesIO(response.content)) as archive:
        assert archive.getnames() == [f"{boxes[1]}-0.5-64.webp"]


def test_crop_of_a_box_outside_is_404_and_without_image_is_grey(api):
    boxes = [
        {"id": "out", "class": "car", "xyxy": [90, 0, 99, 9]},
        {"id": "in", "class": "car", "xyxy": scene.ON_THE_CAR},
    ]
    stored = api.upload_frame(
        api.dataset(),
        "a",
        {**scene.annotation(), "boxes": boxes},
        segmentation=scene.segmentation(),
    )
    outside, inside = (box["box_id"] for box in stored["decisions"])

    nowhere = api.get(f"/boxes/{outside}/crop")
    assert nowhere.status_code == 404
    assert nowhere.json()["detail"] == (
        f"there is no rectangle in the image of box {outside}"
    )
    grey = decoded(api.get(f"/boxes/{inside}/crop"))[5, 5]
    assert grey == pytest.approx([96, 96, 96], abs=1)
    frame = stored["frame"]["id"]
    thumbnail = api.get(f"/frames/{frame}/thumbnail")
    assert thumbnail.status_code == 404
    assert thumbnail.json()["detail"] == f"there is no image of frame {frame}"
