"""`push` sends frames in batches, and reports what became of each, after faults too."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest

from tests.support.batch_server import BatchReply, BatchServer
from tests.support.scripted_server import QUICK_RETRIES, SHORT_RETRIES
from unghost import (
    Client,
    Conflict,
    NoResponse,
    NotSent,
    OutgoingFrame,
    Sent,
    Unauthorized,
    UnexpectedAnswer,
)
from unghost.client.call import MAX_JSON_BYTES
from unghost.client.duplex import MAX_LINE_BYTES

BOX = {"class": "car", "xyxy": [0, 0, 1, 1]}


@pytest.fixture
def batches() -> Iterator[BatchServer]:
    server = BatchServer()
    yield server
    server.close()


@pytest.fixture
def client(batches: BatchServer) -> Iterator[Client]:
    with Client(batches.url, "secret", retry=QUICK_RETRIES) as client:
        yield client


def outgoing_frame(key: str, **files: bytes) -> OutgoingFrame:
    return OutgoingFrame(key, {"boxes": [BOX]}, files)


def many(count: int) -> list[OutgoingFrame]:
    return [outgoing_frame(f"{number}") for number in range(count)]


def outcomes_by_key(outcomes) -> dict[str, str]:
    return {outcome.key: outcome.word for outcome in outcomes}


def test_push_sends_frame_with_annotation_and_files(batches, client, tmp_path):
    (tmp_path / "a.png").write_bytes(b"pixels" * 200_000)
    files = {"image": tmp_path / "a.png", "depth": b"metres"}
    frame = OutgoingFrame("a b/ü?#%2F", {"map": "ü", "boxes": [BOX]}, files)

    (outcome,) = client.push("town", [frame], replace=True)

    assert isinstance(outcome, Sent)
    assert (outcome.word, outcome.counts.rejected) == ("stored", 2)
    (taken,) = batches.taken
    assert (taken.key, taken.annotation) == ("a b/ü?#%2F", dict(frame.annotation))
    assert taken.files == {"image": b"pixels" * 200_000, "depth": b"metres"}
    path, head = batches.heads[0]
    assert path == "/api/v1/datasets/town/batches?replace=true"
    assert head["authorization"] == "Bearer secret"


def test_push_skips_frame_with_unchanged_content(batches, client, tmp_path):
    (tmp_path / "a.png").write_bytes(b"pixels")
    frame = OutgoingFrame("a", {"boxes": [BOX]}, {"image": tmp_path / "a.png"})
    batches.known["a"] = frame.digest()

    assert outcomes_by_key(client.push("town", [frame])) == {"a": "already_there"}
    assert batches.taken == []


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param(outgoing_frame("a", image=b"j"), id="as many other bytes"),
        pytest.param(outgoing_frame("a", depth=b"i"), id="another kind of file"),
        pytest.param(
            OutgoingFrame("a", {"boxes": [{**BOX, "id": "7"}]}, {"image": b"i"}),
            id="another box",
        ),
    ],
)
def test_push_sends_frame_with_changed_content(batches, client, changed):
    batches.known["a"] = outgoing_frame("a", image=b"i").digest()

    assert outcomes_by_key(client.push("town", [changed])) == {"a": "stored"}


def test_push_resends_only_unanswered_frames_after_disconnect(batches, client):
    batches.replies = [BatchReply(lines=4), BatchReply(lines=3), BatchReply()]

    outcomes = list(client.push("town", many(12)))

    assert outcomes_by_key(outcomes) == {frame.key: "stored" for frame in many(12)}
    assert batches.keys == [frame.key for frame in many(12)]


def test_push_retries_are_reset_only_by_answered_frames(batches, client):
    batches.replies = [BatchReply(lines=1)] * 9
    assert len(list(client.push("town", many(9)))) == 9


def test_push_to_a_server_that_stays_away_says_what_is_stored(batches):
    batches.replies = [BatchReply(lines=3), *[BatchReply(lines=0)] * 1000]

    with (
        Client(batches.url, "secret", retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse) as caught,
    ):
        list(client.push("town", many(9)))

    assert str(caught.value) == (
        f"no response from {batches.url}: the connection was closed before the "
        "response was complete; gave up after 0 s; 3 frames are stored, and pushing "
        "the same frames again sends only the others"
    )


def test_push_retries_a_busy_server(batches, client):
    batches.replies = [BatchReply(refusal=(503, "busy", {"Retry-After": "0"}))]

    assert outcomes_by_key(client.push("town", many(2))) == {
        "0": "stored",
        "1": "stored",
    }


def test_push_to_server_without_batches_sends_single_frames(batches, client):
    batches.replies = [BatchReply(refusal=(404, "not_found", {}))] * 2

    outcomes = list(client.push("town", [outgoing_frame("a b"), outgoing_frame("c")]))

    assert outcomes_by_key(outcomes) == {"a b": "stored", "c": "stored"}
    assert batches.put == [
        "/api/v1/datasets/town/frames/a%20b",
        "/api/v1/datasets/town/frames/c",
    ]


def test_push_through_a_proxy_sends_single_frames(batches, client, monkeypatch):
    monkeypatch.setenv("http_proxy", batches.url)
    with Client("http://far.example", "secret", retry=QUICK_RETRIES) as far:
        list(far.push("town", [outgoing_frame("a")]))

    assert batches.put == ["http://far.example/api/v1/datasets/town/frames/a"]
    assert batches.heads == []


def test_push_of_single_frames_goes_on_after_one_that_others_have_answered(
    batches, client
):
    batches.replies = [BatchReply(refusal=(404, "not_found", {}))] * 3
    batches.others_answered = {"a"}

    frames = [outgoing_frame("a"), outgoing_frame("b")]
    outcomes = list(client.push("town", frames, replace=True))

    assert len(batches.put) == 2
    errors = {one.key: str(one.error) for one in outcomes if isinstance(one, NotSent)}
    assert errors == {"a": "by others"}


def test_push_stops_when_unauthorised(batches, client):
    batches.replies = [BatchReply(refusal=(401, "unauthorised", {}))]

    with pytest.raises(Unauthorized):
        list(client.push("town", many(3)))
    assert batches.taken == []


def test_problem_at_the_end_of_a_batch_raises(batches, client):
    batches.replies = [BatchReply(end={"problem": {"status": 409, "code": "odd"}})]

    with pytest.raises(Conflict):
        list(client.push("town", many(1)))


@pytest.mark.parametrize("decisions", [None, {}, "many"])
def test_unreadable_line_of_batch_raises_unexpected_answer(batches, client, decisions):
    batches.replies = [BatchReply(decisions=decisions)]

    with pytest.raises(UnexpectedAnswer, match="has a line that cannot be read"):
        list(client.push("town", many(1)))


def test_overlong_line_of_batch_raises_unexpected_answer(batches, client):
    batches.replies = [BatchReply(decisions="x" * MAX_LINE_BYTES * 2)]

    with pytest.raises(UnexpectedAnswer, match="has a line of more than"):
        list(client.push("town", many(2)))


def test_compressed_refusal_of_batch_raises_unexpected_answer(batches, client):
    gzip = {"Content-Encoding": "gzip"}
    batches.replies = [BatchReply(refusal=(401, "unauthorised", gzip))]

    with pytest.raises(UnexpectedAnswer, match="is encoded as 'gzip'"):
        list(client.push("town", many(2)))


def test_overlong_refusal_of_batch_raises_unexpected_answer(batches, client):
    batches.replies = [BatchReply(refusal=(401, "x" * MAX_JSON_BYTES, {}))]

    with pytest.raises(UnexpectedAnswer, match="is longer than"):
        list(client.push("town", many(2)))


def test_push_continues_after_refused_frames(batches, client, tmp_path):
    missing = OutgoingFrame("b", {"boxes": []}, {"image": tmp_path / "b.png"})
    folder = OutgoingFrame("d", {"boxes": []}, {"image": tmp_path})
    unreadable = NotSent("e", ValueError("line 3"))

    outcomes = client.push(
        "town",
        [
            outgoing_frame("a"),
            missing,
            outgoing_frame("\udcff"),
            outgoing_frame("c"),
            folder,
            unreadable,
        ],
    )

    assert outcomes_by_key(outcomes) == {
        "a": "stored",
        "b": "refused",
        "\udcff": "refused",
        "c": "stored",
        "d": "refused",
        "e": "refused",
    }


def test_frame_whose_file_is_a_pipe_is_refused_at_once(batches, client, tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    pipe = OutgoingFrame("pipe", {"boxes": []}, {"image": tmp_path / "pipe.png"})

    outcomes = outcomes_by_key(client.push("town", [pipe, *many(1)]))

    assert outcomes == {"pipe": "refused", "0": "stored"}


def test_pipe_in_a_single_frame_raises_without_waiting(client, tmp_path):
    os.mkfifo(tmp_path / "pipe.png")

    with pytest.raises(OSError, match="not a regular file"):
        client.put_frame("town", "a", {"boxes": []}, image=tmp_path / "pipe.png")


def test_only_frame_with_file_that_shrinks_during_push_is_refused(
    batches, client, tmp_path
):
    image = tmp_path / "a.png"
    image.write_bytes(b"pixels")

    def frames() -> Iterator[OutgoingFrame]:
        yield from many(240)
        yield OutgoingFrame("a", {"boxes": []}, {"image": image})
        yield from (outgoing_frame(f"after {number}") for number in range(9))
        # 250 frames were taken; the last fifty wait until their batch is full.
        image.write_bytes(b"pix")
        yield outgoing_frame("last")

    outcomes = outcomes_by_key(client.push("town", frames()))

    assert outcomes.pop("a") == "refused"
    assert set(outcomes.values()) == {"stored"}
    # The rest of its batch was sent again, so the server got some frames twice.
    assert set(batches.keys) == set(outcomes)


def test_push_reads_frames_lazily(batches, client):
    taken = 0

    def frames() -> Iterator[OutgoingFrame]:
        nonlocal taken
        for frame in many(20_000):
            taken += 1
            yield frame

    sending = client.push("town", frames(), connections=1)
    next(sending)
    after_one = taken
    sending.close()

    assert after_one <= 1000
    assert len(batches.taken) < 2000


def test_push_limits_keys_per_request_for_known_frames(batches, client):
    list(client.push("town", many(600)))

    assert sum(map(len, batches.asked_about)) == 600
    assert max(map(len, batches.asked_about)) <= 1000


def test_push_survives_server_restart_while_requesting_known_frames(batches, client):
    batches.dropped_requests = 5

    assert outcomes_by_key(client.push("town", many(2))) == {
        "0": "stored",
        "1": "stored",
    }


def test_annotation_may_contain_numbers_and_arrays_of_numpy(batches, client):
    box = {"class": "car", "xyxy": np.array([1, 2, 5, 6.5]), "id": np.int64(7)}
    plain = {"class": "car", "xyxy": [1.0, 2.0, 5.0, 6.5], "id": 7}

    list(client.push("town", [OutgoingFrame("a", {"boxes": [box]})]))

    assert batches.taken[0].annotation == {"boxes": [plain]}


def test_frame_whose_annotation_is_no_json_is_refused_alone(batches, client):
    frames = [outgoing_frame("a"), OutgoingFrame("b", {"boxes": {1, 2}}), *many(1)]
    batches.known["b"] = "other"

    outcomes = {one.key: one for one in client.push("town", frames)}

    words = {key: one.word for key, one in outcomes.items()}
    assert words == {"a": "stored", "b": "refused", "0": "stored"}
    assert "cannot be written as JSON: found a value of type set" in str(
        getattr(outcomes["b"], "error", "")
    )


def test_single_frame_whose_key_is_no_address_is_refused_alone(batches, client):
    batches.replies = [BatchReply(refusal=(404, "not_found", {}))]

    outcomes = client.push("town", [outgoing_frame("../a"), *many(1)])

    assert outcomes_by_key(outcomes) == {"../a": "refused", "0": "stored"}


def test_annotation_that_is_no_mapping_raises_type_error_with_the_key():
    with pytest.raises(TypeError, match="frame 'a': expected a mapping as annotation"):
        OutgoingFrame("a", cast("dict[str, object]", [BOX]))


def test_put_frame_with_unknown_file_kind_raises_type_error(client):
    with pytest.raises(TypeError, match="'seg' is not a file of a frame"):
        client.put_frame("town", "a", {"boxes": []}, seg=b"")
