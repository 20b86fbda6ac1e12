"""Secrets, roles, hosts and origins."""

from __future__ import annotations

import pytest

from app.security import (
    Role,
    bearer_token,
    comes_from_no_other_page,
    comes_from_own_page,
    hash_secret,
    host_name,
    new_token,
    same_hash,
)
from app.services import access

OWN = {"host": "127.0.0.1:8000"}


def test_tokens_are_long_recognisable_and_different():
    tokens = {new_token() for _ in range(100)}

    assert len(tokens) == 100
    assert all(token.startswith("ug_") and len(token) == 46 for token in tokens)


def test_a_hash_says_nothing_and_is_always_the_same():
    assert hash_secret("ug_a") == hash_secret("ug_a") != hash_secret("ug_b")
    assert len(hash_secret("\ud800")) == 64


def test_hashes_are_compared_in_constant_time():
    """By the one function that is made for it, and nowhere without it."""
    assert "compare_digest" in same_hash.__code__.co_names
    for look_up in (access.by_token, access.by_session):
        assert "same_hash" in look_up.__code__.co_names
    assert same_hash("a" * 64, "a" * 64)
    assert not same_hash("a" * 64, "a" * 63 + "b")


@pytest.mark.parametrize(
    ("header", "token"),
    [
        ("Bearer ug_x", "ug_x"),
        ("bearer   ug_x  ", "ug_x"),
        ("Bearer", None),
        ("Bearer ", None),
        ("Basic ug_x", None),
        ("ug_x", None),
        ("", None),
    ],
)
def test_a_bearer_token_is_found(header, token):
    assert bearer_token(header) == token


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("Localhost", "localhost"),
        ("localhost:8000", "localhost"),
        ("[::1]:8000", "[::1]"),
        ("[::1]", "[::1]"),
        ("::1", ":"),
        ("a.example:80:80", "a.example:80"),
        ("", ""),
    ],
)
def test_a_host_is_known_without_its_port(host, name):
    assert host_name(host) == name


@pytest.mark.parametrize(
    ("headers", "own", "not_other"),
    [
        ({}, False, True),
        ({"origin": "http://127.0.0.1:8000"}, True, True),
        ({"origin": "https://127.0.0.1:8000"}, True, True),
        ({"origin": "http://127.0.0.1:8001"}, False, False),
        ({"origin": "http://127.0.0.1"}, False, False),
        ({"origin": "null"}, False, False),
        ({"origin": "127.0.0.1:8000"}, False, False),
        ({"origin": "http://evil.example"}, False, False),
        ({"sec-fetch-site": "same-origin"}, True, True),
        ({"sec-fetch-site": "same-site"}, False, False),
        ({"sec-fetch-site": "cross-site"}, False, False),
    ],
)
def test_a_page_is_told_from_other_pages(headers, own, not_other):
    headers = {**OWN, **headers}

    assert comes_from_own_page(headers) is own
    assert comes_from_no_other_page(headers) is not_other


def test_each_role_includes_the_ones_before():
    included = {
        role: [other for other in Role if role.includes(other)] for role in Role
    }

    assert included == {
        Role.VIEWER: [Role.VIEWER],
        Role.REVIEWER: [Role.VIEWER, Role.REVIEWER],
        Role.ADMIN: [Role.VIEWER, Role.REVIEWER, Role.ADMIN],
    }
