"""Undoing an answer on one box: what the box gets, and what else follows from it."""

import pytest


def undo(api, box_id, revision):
    return api.post(f"/boxes/{box_id}/reviews/{revision}/undo")


def answer_of(api, box_id):
    review = api.json(f"/boxes/{box_id}")["review"]
    return review and (review["verdict"], review["comment"])


def test_first_answer_is_undone_to_none(api, dataset, ghosts):
    before = api.json(f"/datasets/{dataset}/stats")
    api.review(ghosts[0], "keep")

    assert undo(api, ghosts[0], 1).json()["verdict"] == "clear"

    assert answer_of(api, ghosts[0]) is None
    assert api.json(f"/datasets/{dataset}/stats") == before


@pytest.mark.parametrize("verdict", ["keep", "clear"])
def test_answer_that_another_one_followed_is_not_undone(api, ghosts, verdict):
    api.review(ghosts[0], "reject")
    api.review(ghosts[0], verdict, 1)

    refused = undo(api, ghosts[0], 1)

    assert (refused.status_code, refused.json()["code"]) == (409, "not_in_force")
    assert api.json(f"/boxes/{ghosts[0]}")["revision"] == 2


@pytest.mark.parametrize("revision", [2, 2**31 - 1])
def test_missing_answer_is_404(api, ghosts, revision):
    api.review(ghosts[0], "keep")

    refused = undo(api, ghosts[0], revision)

    assert refused.status_code == 404
    assert f"answer on box {ghosts[0]} with revision {revision}" in refused.text


@pytest.mark.parametrize("revision", ["0", "2147483648", "4294967296", "x"])
def test_impossible_revision_is_refused(api, ghosts, revision):
    assert undo(api, ghosts[0], revision).status_code == 422
