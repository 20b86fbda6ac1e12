"""Undoing an answer on one box: what the box gets, and what else follows from it."""


def undo(api, box_id, revision):
    return api.post(f"/boxes/{box_id}/reviews/{revision}/undo")


def test_first_answer_is_undone_to_none(api, dataset, ghosts):
    before = api.json(f"/datasets/{dataset}/stats")
    api.review(ghosts[0], "keep")

    assert undo(api, ghosts[0], 1).json()["verdict"] == "clear"

    assert api.json(f"/boxes/{ghosts[0]}")["review"] is None
    assert api.json(f"/datasets/{dataset}/stats") == before


def test_answer_that_another_one_followed_is_not_undone(api, ghosts):
    for ghost, verdict in zip(ghosts, ("keep", "clear"), strict=False):
        api.review(ghost, "reject")
        api.review(ghost, verdict, 1)

        refused = undo(api, ghost, 1)

        assert (refused.status_code, refused.json()["code"]) == (409, "not_in_force")
        assert api.json(f"/boxes/{ghost}")["revision"] == 2


def test_missing_answer_is_404_and_an_impossible_revision_422(api, ghosts):
    api.review(ghosts[0], "keep")

    for revision in (2, 2**31 - 1):
        missing = undo(api, ghosts[0], revision)
        assert missing.status_code == 404
        words = f"answer on box {ghosts[0]} with revision {revision}"
        assert words in missing.text
    for impossible in ("0", "2147483648", "4294967296", "x"):
        assert undo(api, ghosts[0], impossible).status_code == 422, impossible
