"""The client against a real server: what needs both, and no other test promises."""

import pytest

import unghost
from tests.support import frames

RIFF = b"RIFF"


def test_changed_dataset_or_the_run_that_measures_again_is_returned(
    client, filled_dataset
):
    changed = client.change_dataset(filled_dataset, description="a street")
    run = client.change_dataset(filled_dataset, lossy_segmentation="nearest")

    assert isinstance(changed, unghost.Dataset)
    assert changed.description == "a street"
    assert isinstance(run, unghost.Run)
    assert client.wait(run).state == "done"
    assert client.dataset(filled_dataset).lossy_segmentation == "nearest"


def test_put_frame_accepts_file_paths(client, dataset, tmp_path):
    (tmp_path / "image.png").write_bytes(frames.image())

    stored = client.put_frame(
        dataset, "a", frames.annotation(), image=tmp_path / "image.png"
    )

    assert stored.frame.has_image
    assert {each.verdict for each in stored.decisions} == {"unmeasured"}


def test_bulk_review_of_a_stale_selection_raises_stale_review(client, filled_dataset):
    seen = client.select_boxes(filled_dataset, verdict="rejected", class_name="car")
    (box, *_) = client.boxes(filled_dataset, verdict="rejected")
    client.review(box.box_id, "reject", seen_revision=box.revision)

    with pytest.raises(
        unghost.StaleReview, match="boxes now, 3 when they were listed"
    ) as caught:
        client.bulk_review(filled_dataset, "keep", seen)
    assert caught.value.code == "stale_snapshot"
    assert (caught.value.current or {})["total"] == 3
    again = client.select_boxes(filled_dataset, verdict="rejected", class_name="car")
    batch = client.bulk_review(filled_dataset, "keep", again)

    assert (seen.count, again.count, batch.count) == (3, 3, 3)
    assert client.count_boxes(filled_dataset, verdict="rejected", class_name="car") == 3


def test_selection_of_several_reasons_in_an_order_can_be_answered(
    client, filled_dataset
):
    reasons = sorted({box.reason for box in client.boxes(filled_dataset)})

    selection = client.select_boxes(
        filled_dataset, reason=reasons, sort="-match_percent", limit=5
    )
    batch = client.bulk_review(filled_dataset, "keep", selection)

    assert len(reasons) > 1
    assert batch.count == selection.count == client.count_boxes(filled_dataset)


def test_pictures_of_a_frame_and_a_box_are_webp_files(client, filled_dataset):
    frame, box = next(client.frames(filled_dataset)), next(client.boxes(filled_dataset))

    assert client.thumbnail(frame.id).startswith(RIFF)
    assert client.overlay(frame.id, boxes="kept", layer="blend").startswith(RIFF)
    assert client.crop(box.box_id, pad=0.5).startswith(RIFF)


def test_differences_of_two_runs_and_the_history_of_a_box_are_read(
    client, filled_dataset
):
    run = client.wait(client.start_run(filled_dataset, {"min_visible_pixels": 500}))

    diff, flips = client.diff(run), list(client.flips(run))
    history = list(client.history(flips[0].box_id))

    assert (diff.total, diff.kept_to_rejected, diff.by_class) == (3, 3, {"car": 3})
    assert {flip.before.verdict for flip in flips} == {"kept"}
    assert {flip.after.reason for flip in flips} == {"no_visible_pixels"}
    assert run.id in {entry.run for entry in history}
