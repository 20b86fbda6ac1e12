"""Names in an archive, and keys in its annotations, that no key of a frame can be."""

import tarfile

import pytest

from tests.support.archives import batch_results, frame, send, tar_archive

NOT_JSON = b"{"


def send_members(api, dataset, members):
    return batch_results(send(api, dataset, tar_archive(members, tarfile.PAX_FORMAT)))


@pytest.mark.parametrize("key", ["\ud800", "a\udfffb", "a\0b"])
def test_invalid_key_in_a_batch_is_refused_and_other_frames_are_stored(api, key):
    dataset = api.dataset()

    statuses, end = send_members(api, dataset, [*frame("a", key=key), *frame("b")])

    assert statuses == [("a", 422), ("run/b", 201)]
    assert "problem" not in end
    (problem,) = api.json(f"/datasets/{dataset}/problems")["items"]
    (fault,) = problem["error"]["errors"]
    assert (problem["key"], fault["code"]) == ("a", "bad_key")


def test_key_of_a_problem_is_truncated_to_512_characters(api):
    """PostgreSQL refused longer ones, which ended the batch."""
    dataset, name = api.dataset(), "ü" * 600

    statuses, _ = send_members(api, dataset, [(f"{name}.json", NOT_JSON), *frame("b")])

    assert statuses == [(name, 422), ("run/b", 201)]
    (problem,) = api.json(f"/datasets/{dataset}/problems")["items"]
    assert problem["key"] == "ü" * 512
