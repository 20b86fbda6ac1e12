"""Asking which of many keys have a stored frame, and with which content."""

import hashlib
import json

from tests.support import frames


def known(api, dataset, *keys):
    response = api.post(f"/datasets/{dataset}/known-frames", {"keys": list(keys)})
    assert response.status_code == 200, response.text
    return {item["key"]: item for item in response.json()["items"]}


def test_known_frames_returns_only_stored_keys(api):
    dataset = api.dataset()
    frame = api.upload_frame(dataset, "run/ü 1")["frame"]
    api.upload_frame(api.dataset(), "elsewhere")

    frames = known(api, dataset, "run/ü 1", "elsewhere", "none")

    assert list(frames) == ["run/ü 1"]
    assert frames["run/ü 1"]["frame_id"] == frame["id"]


def test_frame_digest_is_computed_as_documented(api):
    dataset = api.dataset()
    annotation = {
        "map": "Ünterwegs",
        "boxes": [{"class": "car", "xyxy": [1, 2, 3.5, 1e3]}],
    }
    files = {"segmentation": frames.segmentation(), "image": frames.image()}
    api.upload_frame(dataset, "a", annotation, **files)

    lines = ["frame 1"]
    for kind in sorted(files):
        lines.append(f"{kind} {hashlib.sha256(files[kind]).hexdigest()}")
    lines.append(json.dumps(annotation, sort_keys=True, separators=(",", ":")))
    expected = hashlib.sha256("\n".join(lines).encode()).hexdigest()

    assert known(api, dataset, "a")["a"]["digest"] == expected


def test_known_frame_has_the_digest_of_its_newest_revision(api):
    dataset = api.dataset()
    before = api.upload_frame(dataset, "a", image=frames.image(1))["frame"]
    old = known(api, dataset, "a")["a"]
    api.upload_frame(dataset, "a", image=frames.image(2), replace=True)

    new = known(api, dataset, "a")["a"]

    assert old["frame_id"] == before["id"]
    assert (new["frame_id"], new["digest"]) != (old["frame_id"], old["digest"])


def test_more_than_a_thousand_keys_are_refused(api):
    dataset = api.dataset()

    response = api.post(
        f"/datasets/{dataset}/known-frames", {"keys": [str(n) for n in range(1001)]}
    )

    assert response.status_code == 422
