"""The client against a real server: what needs both, and no other test promises."""

from __future__ import annotations

import zipfile

import pytest

import unghost
from tests.support import frames
from tests.support.waiting import until

RIFF = b"RIFF"


def test_version_and_readiness(client):
    assert client.version().version
    assert until(client.ready) is True


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


def test_put_frame_returns_decisions_and_whether_it_is_new(client, dataset):
    stored = frames.put(client, dataset, "a/b c/ü")
    again = frames.put(client, dataset, "a/b c/ü")

    assert (stored.created, again.created) == (True, False)
    assert stored.frame.key == "a/b c/ü"
    assert again.frame.id == stored.frame.id
    assert client.frame_by_key(dataset, "a/b c/ü") == client.frame(stored.frame.id)
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


def test_frame_file_returns_the_uploaded_bytes(client, filled_dataset):
    frame = next(client.frames(filled_dataset))

    assert client.frame_file(frame.id, "segmentation") == frames.segmentation()


def test_bulk_review_of_a_stale_selection_raises_stale_review(client, filled_dataset):
    seen = client.select_boxes(filled_dataset, verdict="rejected", class_name="car")
    (one, *_) = client.boxes(filled_dataset, verdict="rejected")
    client.review(one.box_id, "reject", seen_revision=one.revision)

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


def test_export_is_created_and_downloaded(client, filled_dataset, tmp_path):
    export = client.wait_for_export(client.start_export(filled_dataset, "yolo"))

    path = client.download(export, tmp_path / "labels.zip")

    assert export.id in [each.id for each in client.exports(filled_dataset)]
    names = zipfile.ZipFile(path).namelist()
    assert any(name.endswith("data.yaml") for name in names)
    assert sum(name.endswith("000001.txt") for name in names) == 1


def test_run_events_continue_until_the_run_is_done(client, filled_dataset):
    run = client.start_run(filled_dataset, {"min_visible_pixels": 500})

    told = list(client.events(run))

    assert told[-1].state == "done"
    assert told[-1].changed == 3
    assert {each.id for each in told} == {run.id}


def test_events_of_a_missing_run_raise_not_found(client):
    with pytest.raises(unghost.NotFound):
        list(client.events(10**9))


def test_pictures_of_a_frame_and_a_box_are_webp_files(client, filled_dataset):
    frame, box = next(client.frames(filled_dataset)), next(client.boxes(filled_dataset))

    assert client.thumbnail(frame.id).startswith(RIFF)
    assert client.overlay(frame.id, boxes="kept", layer="blend").startswith(RIFF)
    assert client.crop(box.box_id, pad=0.5).startswith(RIFF)


def test_token_is_created_used_and_revoked_and_noted(client, server):
    made = client.create_token("ada", "viewer")

    with unghost.Client(server.url, made.token) as ada:
        assert (ada.session().name, ada.session().role) == ("ada", "viewer")
        with pytest.raises(unghost.Forbidden):
            ada.create_dataset("not-for-viewers")
        client.revoke_token(made.id)
        with pytest.raises(unghost.Unauthorized):
            ada.session()

    (listed,) = [token for token in client.tokens() if token.id == made.id]
    assert listed.revoked_at is not None
    noted = [entry for entry in client.audit() if entry.subject == "ada"]
    assert [entry.action for entry in noted[:2]] == ["token.revoked", "token.created"]
    assert noted[1].details["token_id"] == made.id


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
