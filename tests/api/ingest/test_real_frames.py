"""Real CARLA frames that others have made, uploaded over HTTP."""

from filter_core.formats.registry import read_source
from tests.support.shared_data import shared


def test_frames_without_segmentation_wait_for_review(api):
    dataset = api.dataset()

    for frame in read_source(shared("data/ee267-trojanhorsepower")):
        assert frame.image is not None
        image = frame.image.read_bytes()
        api.upload_frame(dataset, frame.key, frame.annotation, image=image)

    stats = api.json(f"/datasets/{dataset}/stats")
    assert (stats["frames"], stats["to_review"]) == (13, 117)
    waiting = api.boxes(dataset, review="undecided", sort="doubt", limit=1000)
    assert len(waiting) == 117
    kept = api.review(waiting[0]["box_id"], "keep")
    assert kept.json()["effective_verdict"] == "kept"
    assert api.json(f"/datasets/{dataset}/stats")["effective"]["kept"] == 1
