"""The client against a real server: datasets, frames, boxes and reviews."""

from __future__ import annotations

import hashlib

import pytest

import unghost
from tests.support import frames
from unghost import Client

JPEG = b"\xff\xd8"


def ghost(client: Client, dataset: str) -> unghost.Decision:
    return next(client.boxes(dataset, verdict="rejected"))


def test_version_and_readiness(client):
    assert client.version().version
    assert client.ready() is True


def test_dataset_is_created_changed_and_deleted(client, dataset):
    assert dataset in [each.name for each in client.datasets()]
    assert client.dataset(dataset).classes == ("car",)

    changed = client.change_dataset(dataset, description="a street")
    assert isinstance(changed, unghost.Dataset)
    assert changed.description == "a street"

    client.delete_dataset(dataset)
    with pytest.raises(unghost.NotFound):
        client.dataset(dataset)


def test_changing_lossy_segmentation_starts_a_run(client, filled):
    run = client.change_dataset(filled, lossy_segmentation="nearest")

    assert isinstance(run, unghost.Run)
    assert client.wait(run).state == "done"
    assert client.dataset(filled).lossy_segmentation == "nearest"


def test_put_frame_returns_decisions(client, dataset):
    stored = frames.put(client, dataset, "a/b c/ü")

    assert stored.created
    assert stored.frame.key == "a/b c/ü"
    assert stored.segmentation is not None
    assert stored.segmentation.palette == frames.FAMILY
    verdicts = {each.id: each.verdict for each in stored.decisions}
    assert verdicts == {"real": "kept", "ghost": "rejected"}


def test_put_frame_accepts_file_paths(client, dataset, tmp_path):
    (tmp_path / "image.png").write_bytes(frames.image())

    stored = client.put_frame(
        dataset, "a", frames.annotation(), image=tmp_path / "image.png"
    )

    assert stored.frame.has_image
    assert {each.verdict for each in stored.decisions} == {"unmeasured"}


def test_putting_the_same_frame_again_changes_nothing(client, dataset):
    first = frames.put(client, dataset, "a")
    again = frames.put(client, dataset, "a")

    assert (first.created, again.created) == (True, False)
    assert again.frame.id == first.frame.id


def test_other_frame_with_the_same_key_is_a_conflict_unless_replaced(client, dataset):
    frames.put(client, dataset, "a", 1)

    with pytest.raises(unghost.Conflict):
        frames.put(client, dataset, "a", 2)
    assert frames.put(client, dataset, "a", 2, replace=True).frame.revision == 2


def test_refused_frame_raises_invalid_and_is_listed_as_a_problem(client, dataset):
    bad = {"boxes": [{"class": "car", "xyxy": [0, 0, "wide", 1]}]}

    with pytest.raises(unghost.Invalid) as caught:
        client.put_frame(dataset, "bad", bad, image=frames.image())

    assert any("/boxes/0" in fault.pointer for fault in caught.value.errors)
    (problem,) = client.problems(dataset)
    assert problem.key == "bad"
    assert problem.error.errors == caught.value.errors
    assert problem.error.code == caught.value.code


def test_frame_list_is_paginated(client, filled):
    keys = [frame.key for frame in client.frames(filled, limit=2)]

    assert keys == ["run/000000", "run/000001", "run/000002"]


def test_listed_frame_has_counts_and_file_flags(client, filled):
    first = next(client.frames(filled))

    assert (first.counts.boxes, first.counts.kept, first.counts.rejected) == (2, 1, 1)
    assert (first.has_image, first.has_segmentation) == (True, True)


def test_frame_is_found_by_id_and_by_key(client, filled):
    by_key = client.frame_by_key(filled, "run/000001")
    by_id = client.frame(by_key.id)

    assert by_id == by_key
    assert by_id.dataset == filled
    assert {box.id for box in by_id.boxes} == {"real", "ghost"}
    assert by_id.files["image"].sha256 == hashlib.sha256(frames.image(1)).hexdigest()
    assert by_id.previous_id is not None
    assert by_id.next_id is not None


def test_frame_file_returns_the_uploaded_bytes(client, filled):
    frame = next(client.frames(filled))

    assert client.frame_file(frame.id, "segmentation") == frames.segmentation()


def test_missing_frame_file_raises_not_found(client, filled):
    frame = next(client.frames(filled))

    with pytest.raises(unghost.NotFound, match=f"frame {frame.id} has no file 'depth'"):
        client.frame_file(frame.id, "depth")


def test_thumbnail_overlay_and_crop_are_jpeg(client, filled):
    frame = next(client.frames(filled))
    box = ghost(client, filled)

    assert client.thumbnail(frame.id).startswith(JPEG)
    assert client.overlay(frame.id, boxes="kept", layer="blend").startswith(JPEG)
    assert client.crop(box.box_id, pad=0.5).startswith(JPEG)


def test_deleted_frame_is_not_listed(client, filled):
    client.delete_frame(filled, "run/000001")

    keys = [frame.key for frame in client.frames(filled)]
    assert keys == ["run/000000", "run/000002"]


def test_boxes_are_filtered(client, filled):
    rejected = list(client.boxes(filled, verdict="rejected", class_name="car"))

    assert [box.id for box in rejected] == ["ghost"] * 3
    assert all(box.explanation for box in rejected)
    assert list(client.boxes(filled, class_name="truck")) == []


def test_one_box_has_its_numbers_and_neighbours(client, filled):
    box = client.box(ghost(client, filled).box_id)

    assert (box.reason, box.match_percent) == ("no_visible_pixels", 0.0)
    assert box.hidden_by == () or box.hidden_by[0].percent > 0
    assert box.xyxy == tuple(frames.IN_THE_SKY)
    assert box.effective_verdict == "rejected"
    assert isinstance(box.neighbours, tuple)


def test_review_changes_the_effective_verdict_and_is_in_the_history(client, filled):
    box_id = ghost(client, filled).box_id

    review = client.review(box_id, "keep", seen_revision=0, comment="there is one")

    assert (review.revision, review.effective_verdict) == (1, "kept")
    box = client.box(box_id)
    assert box.review is not None
    assert (box.verdict, box.effective_verdict) == ("rejected", "kept")
    assert [entry.kind for entry in client.history(box_id)] == ["review", "decision"]


def test_review_is_undone_once(client, filled):
    box_id = ghost(client, filled).box_id
    client.review(box_id, "unsure", seen_revision=0, comment="far")
    client.review(box_id, "keep", seen_revision=1)

    undone = client.undo_review(box_id, 2)

    assert (undone.revision, undone.verdict, undone.comment) == (3, "unsure", "far")
    assert next(iter(client.history(box_id))).undoes == 2
    with pytest.raises(unghost.Conflict, match="is not in force any more"):
        client.undo_review(box_id, 2)


def test_bulk_review_is_counted_and_undone(client, filled):
    ids = [box.box_id for box in client.boxes(filled, verdict="rejected")]

    batch = client.bulk_review(filled, "keep", ids, comment="all of them")
    assert (batch.count, batch.skipped) == (3, ())
    assert client.stats(filled).effective.kept == 6

    undone = client.undo(batch.id)
    assert (undone.undone, undone.skipped) == (3, ())
    assert client.stats(filled).effective.kept == 3


def test_bulk_review_of_a_stale_selection_raises_stale_review(client, filled):
    seen = client.select_boxes(filled, verdict="rejected", class_name="car")
    (one, *_) = client.boxes(filled, verdict="rejected")
    client.review(one.box_id, "reject", seen_revision=one.revision)

    with pytest.raises(
        unghost.StaleReview, match="boxes now, 3 when they were listed"
    ) as caught:
        client.bulk_review(filled, "keep", seen)
    assert caught.value.code == "stale_snapshot"
    assert (caught.value.current or {})["total"] == 3
    again = client.select_boxes(filled, verdict="rejected", class_name="car")
    batch = client.bulk_review(filled, "keep", again)

    assert (seen.count, again.count, batch.count) == (3, 3, 3)


def test_bulk_review_skips_boxes_with_a_stale_revision(client, filled):
    boxes = list(client.boxes(filled, verdict="rejected"))
    client.review(boxes[0].box_id, "keep", seen_revision=0)

    batch = client.bulk_review(filled, "reject", boxes)
    bare = client.bulk_review(filled, "unsure", [box.box_id for box in boxes])

    assert (batch.count, batch.stale) == (2, (boxes[0].box_id,))
    assert (bare.count, len(bare.stale)) == (0, 3)
    again = client.bulk_review(filled, "unsure", list(client.boxes(filled)))
    assert again.stale == ()


@pytest.mark.parametrize("boxes", [{"verdict": "rejected"}, "both"])
def test_bulk_review_of_a_filter_or_mixed_boxes_raises_type_error(
    client, filled, boxes
):
    if boxes == "both":
        (box, *_) = client.boxes(filled)
        boxes = [box, box.box_id]

    with pytest.raises(TypeError, match="expected decisions"):
        client.bulk_review(filled, "keep", boxes)


def test_push_reports_the_outcome_of_each_frame(client, dataset, tmp_path):
    (tmp_path / "image.png").write_bytes(frames.image())
    good = {"image": tmp_path / "image.png", "segmentation": frames.segmentation()}
    bad = {"boxes": [{"class": "car", "xyxy": [0, 0, "wide", 1]}]}
    outgoing = [
        unghost.OutgoingFrame("a/1", frames.annotation(), good),
        unghost.OutgoingFrame("a/2", bad, good),
        unghost.OutgoingFrame("a/3", frames.annotation(), good),
    ]

    told = {outcome.key: outcome for outcome in client.push(dataset, outgoing)}
    again = {outcome.key: outcome.word for outcome in client.push(dataset, outgoing)}

    assert isinstance(told["a/2"], unghost.NotSent)
    assert isinstance(told["a/3"], unghost.Sent)
    assert (told["a/3"].counts.kept, told["a/3"].counts.rejected) == (1, 1)
    assert again == {"a/1": "already_there", "a/2": "refused", "a/3": "already_there"}
    assert client.frame(told["a/1"].frame_id).key == "a/1"
