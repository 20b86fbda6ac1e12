"""Asking which of many keys have a stored frame, and with which content."""

import hashlib
import json

from tests.support import frames


def known(api, dataset, *keys):
    response = api.post(f"/datasets/{dataset}/known-frames", {"keys": list(keys)})
    assert response.status_code == 200, response.text
    return {item["key"]: item for item in response.json()["items"]}


def test_known_frames_returns_only_stored_keys_in_their_newest_revision(api):
    dataset = api.dataset()
    before = api.upload_frame(dataset, "run/ü 1", image=frames.image(1))["frame"]
    api.upload_frame(api.dataset(), "elsewhere")

    old = known(api, dataset, "run/ü 1", "elsewhere", "none")
    api.upload_frame(dataset, "run/ü 1", image=frames.image(2), replace=True)
    new = known(api, dataset, "run/ü 1")
    keys = {"keys": [str(number) for number in range(1001)]}
    too_many = api.post(f"/datasets/{dataset}/known-frames", keys)

    ((key, first),), (second,) = old.items(), new.values()
    assert (key, first["frame_id"]) == ("run/ü 1", before["id"])
    assert second["frame_id"] != first["frame_id"]
    assert second["digest"] != first["digest"]
    assert too_many.status_code == 422


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
