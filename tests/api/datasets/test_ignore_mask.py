"""The ignore mask of a dataset, sent as a PNG."""

import re
from base64 import b64encode

import numpy as np

from tests.support import frames as scene
from tests.support.api import BASE, Api
from tests.support.pictures import png
from tests.support.statements import statements_of

MASK = re.compile(r"datasets\.ignore_mask(?! IS NOT)|measurements\.options")
"""Columns of a statement that have the mask."""


def base64_png(pixels: np.ndarray) -> str:
    return b64encode(png(pixels)).decode()


FULL_MASK = np.full((scene.HEIGHT, scene.WIDTH), 255, np.uint8)


def test_ignore_mask_can_be_a_png_of_the_size_of_the_frames(api):
    fitting, other = (
        api.dataset(ignore_mask={"png": base64_png(mask)})
        for mask in (FULL_MASK, FULL_MASK[1:])
    )

    decisions = api.upload_frame(fitting, "a")["decisions"]
    problem = api.put(other, "a").json()

    assert {each["reason"] for each in decisions} == {"no_visible_pixels"}
    assert api.json(f"/datasets/{fitting}")["has_ignore_mask"] is True
    assert problem["code"] == "image_size_mismatch"
    assert problem["detail"].startswith("frame a: ")
    assert problem["errors"][0]["pointer"] == "/ignore_mask"


def test_invalid_ignore_mask_is_refused(api):
    picture, no_picture = base64_png(FULL_MASK), b64encode(b"GIF89a").decode()
    both = {"png": picture, "polygons": [[[0, 0], [9, 0], [9, 9]]]}
    for mask in ({}, {"png": None}, {"png": "%"}, {"png": no_picture}, both):
        response = api.post("/datasets", {"name": "masked", "ignore_mask": mask})
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "invalid_request"), mask
        assert response.json()["errors"][0]["pointer"].startswith("/ignore_mask")


def test_ignore_mask_is_read_only_where_pixels_are_measured(serve):
    """It may be megabytes: reading it for each dataset of a list took seconds."""
    service = serve()
    engine = service.app.state.database.engine
    with service.admin() as admin, statements_of(engine) as statements:
        api = Api(admin)
        dataset = api.dataset(ignore_mask={"png": base64_png(FULL_MASK)})
        api.upload_frame(dataset, "a")
        statements.clear()
        for path in ("", f"/{dataset}", f"/{dataset}/stats", f"/{dataset}/frames"):
            api.json(f"/datasets{path}")
        api.json("/boxes", dataset=dataset, count=True)
        reading = [statement for statement, _ in statements]
        statements.clear()
        api.http.patch(f"{BASE}/datasets/{dataset}", json={"palette": scene.FAMILY})
        changing = [statement for statement, _ in statements]

    assert not any(MASK.search(statement) for statement in reading)
    assert any(MASK.search(statement) for statement in changing)
