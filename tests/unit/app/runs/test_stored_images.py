"""A run uses no stored image that earlier versions should not have stored."""

import hashlib

import cv2
import numpy as np
import pytest
from sqlalchemy import select

from app.db.tables import Blob, Frame, FrameFile, Problem
from filter_core.verdicts import Reason
from tests.support import frames as scene
from tests.support.pictures import jpeg, png

KEPT, UNSEEN = int(Reason.VISIBLE), int(Reason.NO_VISIBLE_PIXELS)
UNMEASURED = int(Reason.NO_SEGMENTATION)


def photo():
    """Smooth and noisy, as no sensor of CARLA but the camera writes."""
    noise = np.random.default_rng(0)
    coarse = noise.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    wide = cv2.resize(
        coarse, (scene.WIDTH, scene.HEIGHT), interpolation=cv2.INTER_CUBIC
    )
    fine = noise.integers(-4, 5, wide.shape)
    return np.clip(wide.astype(int) + fine, 0, 255).astype(np.uint8)


def rippled_tags():
    """Raw tags that were a JPEG once: next to each edge is one of another level."""
    tags = scene.tags()
    tags[:, ::4] += 1
    return tags


DEPTH = {"evidence": "depth_center"}


@pytest.mark.parametrize(
    ("kind", "content", "config", "code"),
    [
        ("segmentation", b"\x89PNG once", {"profile": "carlasimu"}, "bad_image"),
        ("ignore_mask", b"\x89PNG once", {"profile": "carlasimu"}, "bad_image"),
        ("segmentation", png(photo()), {"profile": "carlasimu"}, "foreign_colors"),
        ("segmentation", png(rippled_tags()), {"profile": "carlasimu"},
         "lossy_segmentation"),
        ("segmentation", jpeg(np.dstack([scene.tags()] * 3)), {"profile": "carlasimu"},
         "lossy_segmentation"),
        ("depth", png(photo()), DEPTH, "unknown_depth"),
        ("depth", jpeg(photo()), DEPTH, "lossy_depth"),
        ("instances", png(photo()), {"evidence": "instance"}, "bad_instances"),
    ],
)  # fmt: skip
def test_invalid_stored_image_is_not_used_and_is_a_problem(
    services, kind, content, config, code
):
    """Earlier versions checked images less before they stored them."""
    street = services.dataset()
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    street.put("good", scene.annotation(), **files)
    files.setdefault(kind, scene.segmentation())
    street.put("bad", scene.annotation(), **files)
    digest = hashlib.sha256(content).hexdigest()
    services.context.storage.put({digest: content})
    with services.context.database.write() as session:
        blob = Blob(sha256=digest, size_bytes=len(content), media_type="image/png")
        session.merge(blob)
        session.flush()
        of_frame = Frame.dataset_id == street.id, Frame.key == "bad"
        rows = select(FrameFile).join(Frame).where(*of_frame, FrameFile.kind == kind)
        for row in session.scalars(rows):
            row.sha256 = digest

    run = street.run(config)

    assert run.state == "done", run.error
    is_measured = kind not in ("segmentation", "ignore_mask")
    bad = [KEPT, UNSEEN] if is_measured else [UNMEASURED] * 2
    assert list(street.reasons().values()) == [KEPT, UNSEEN, *bad]
    with services.context.database.read() as session:
        (problem,) = session.scalars(
            select(Problem).where(Problem.dataset_id == street.id)
        )
    assert (problem.key, problem.error["code"]) == ("bad", code)
    assert problem.error["errors"][0]["pointer"] == f"/{kind}"
