"""Many frames are sent in a bounded way, and each one's fate is known."""

from __future__ import annotations

import pytest

from tests.unit.unghost.conftest import json_reply, problem
from unghost import Frame, Unauthorized
from unghost.upload import AlreadyThere, Known, NotSent, OutgoingFrame, Sent, Upload

BOX = {"class": "car", "xyxy": [0, 0, 1, 1]}


def outgoing(key: str, boxes: int = 1, **files: bytes) -> OutgoingFrame:
    return OutgoingFrame(key, {"boxes": [BOX] * boxes}, files)


def stored(key: str, status: int = 201):
    return json_reply({"frame": {"id": 1, "key": key}, "decisions": []}, status)


def push(client, frames, **options):
    return list(Upload(client, "town", workers=1, **options).send(frames))


def test_a_frame_is_one_put_with_its_files(scripted, client, tmp_path):
    (tmp_path / "a.png").write_bytes(b"pixels")
    scripted.answer(stored("a/1"))
    frame = OutgoingFrame("a/1", {"boxes": []}, {"image": tmp_path / "a.png"})

    (outcome,) = push(client, [frame])

    assert isinstance(outcome, Sent)
    assert outcome.word == "stored"
    (asked,) = scripted.asked
    assert (asked.method, asked.path) == ("PUT", "/api/v1/datasets/town/frames/a/1")
    assert b'name="image"' in asked.body
    assert b"pixels" in asked.body


def test_the_same_frame_again_is_already_there(scripted, client):
    scripted.answer(stored("a", 200))

    assert push(client, [outgoing("a")])[0].word == "already_there"


def test_what_concerns_one_frame_does_not_stop_the_others(scripted, client, tmp_path):
    scripted.answer(problem(422, "bad_annotation"), stored("c"))
    missing = OutgoingFrame("b", {"boxes": []}, {"image": tmp_path / "b.png"})

    outcomes = push(client, [outgoing("a"), missing, outgoing("c")])

    words = {outcome.key: outcome.word for outcome in outcomes}
    assert words == {"a": "refused", "b": "refused", "c": "stored"}
    errors = [each.error for each in outcomes if isinstance(each, NotSent)]
    assert {type(error).__name__ for error in errors} == {
        "Invalid",
        "FileNotFoundError",
    }


def test_what_concerns_every_frame_stops(scripted, client):
    scripted.answer(*[problem(401, "unauthorised")] * 3)

    with pytest.raises(Unauthorized):
        push(client, [outgoing(str(number)) for number in range(1000)])

    assert len(scripted.asked) <= 3


def test_a_frame_that_is_there_is_not_sent(scripted, client):
    there = {"id": 1, "key": "a", "has_image": True, "counts": {"boxes": 2}}
    known = Known([Frame.read(there)])

    outcomes = push(client, [outgoing("a", boxes=2, image=b"i")], known=known)

    assert outcomes == [AlreadyThere("a")]
    assert scripted.asked == []


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param(outgoing("a", boxes=3, image=b"i"), id="another number of boxes"),
        pytest.param(outgoing("a", boxes=2), id="no image"),
        pytest.param(
            outgoing("a", 2, image=b"i", segmentation=b"s"), id="another file"
        ),
        pytest.param(outgoing("b", boxes=2, image=b"i"), id="another key"),
    ],
)
def test_a_frame_that_looks_different_is_sent(changed):
    there = {"id": 1, "key": "a", "has_image": True, "counts": {"boxes": 2}}

    assert changed not in Known([Frame.read(there)])


def test_frames_are_taken_no_faster_than_they_are_sent(scripted, client):
    scripted.answer(*[stored(str(number)) for number in range(50)])
    taken = 0

    def frames():
        nonlocal taken
        for number in range(50):
            taken += 1
            yield outgoing(str(number))

    sending = Upload(client, "town", workers=1).send(frames())
    next(sending)
    after_one = taken
    sending.close()

    assert after_one <= 3


def test_a_key_is_data_and_not_a_path(scripted, client):
    scripted.answer(stored("x"))

    push(client, [outgoing("a b/ü?#%2F")])

    path = scripted.asked[0].path
    assert path == "/api/v1/datasets/town/frames/a%20b/%C3%BC%3F%23%252F"


def test_a_file_that_no_frame_has_is_a_mistake_of_the_caller(client):
    with pytest.raises(TypeError, match="'seg' is not a file of a frame"):
        client.put_frame("town", "a", {"boxes": []}, seg=b"")
