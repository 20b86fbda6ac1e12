"""The client against a real server: queue, tokens, counts and the audit log."""

from __future__ import annotations

import pytest

import unghost
from unghost import Client


def test_queue_returns_boxes_with_a_claim(client, filled):
    queue = client.queue(filled, order="random", limit=4)

    assert (len(queue.items), queue.remaining) == (4, 6)
    assert all(box.claim is not None for box in queue.items)
    more = client.queue(filled, exclude=[box.box_id for box in queue.items], limit=50)
    assert len(more.items) == 2


def test_queue_applies_filters_and_omits_answered_boxes(client, filled):
    (box, *_) = client.queue(filled, filters={"verdict": "rejected"}).items

    client.review(box.box_id, "reject", seen_revision=0)

    assert client.queue(filled, filters={"verdict": "rejected"}).remaining == 2


def test_token_is_created_used_and_revoked(client, server):
    made = client.create_token("ada", "viewer")

    with Client(server.url, made.token) as ada:
        assert (ada.session().name, ada.session().role) == ("ada", "viewer")
        with pytest.raises(unghost.Forbidden):
            ada.create_dataset("not-for-viewers")
        client.revoke_token(made.id)
        with pytest.raises(unghost.Unauthorized):
            ada.session()
    (listed,) = [token for token in client.tokens() if token.id == made.id]
    assert listed.revoked_at is not None
    assert made.token not in repr(made)


def test_count_boxes_returns_the_number_that_match_the_filters(client, filled):
    assert client.count_boxes(filled, verdict="rejected", class_name="car") == 3


def test_audit_log_entry_has_actor_action_and_details(client):
    made = client.create_token("audited", "viewer")

    entry = next(one for one in client.audit() if one.subject == "audited")

    assert (entry.actor, entry.action) == ("admin", "token.created")
    assert entry.details["token_id"] == made.id
    assert entry.created_at is not None


def test_audit_log_has_the_newest_entries_first(client):
    for name in ("earlier", "later"):
        client.create_token(name, "viewer")

    subjects = [one.subject for one in client.audit()]

    assert subjects.index("later") < subjects.index("earlier")
