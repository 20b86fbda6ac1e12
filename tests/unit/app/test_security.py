"""Secrets and their hashes, roles, host names, and requests from other pages."""

from typing import get_args

import pytest

from app.access import service as access
from app.security import (
    DOWNLOAD_PREFIX,
    LOGIN_CODE_PREFIX,
    SESSION_PREFIX,
    TOKEN_PREFIX,
    bearer_token,
    comes_from_no_other_page,
    hash_secret,
    host_name,
    includes,
    new_secret,
    same_hash,
)
from unghost.wire.words import Role

OWN_HOST = {"host": "127.0.0.1:8000"}


def test_secrets_are_unique_and_have_their_prefix_and_length():
    """They have 256 random bits; the prefix says what kind of secret it is."""
    kinds = (TOKEN_PREFIX, SESSION_PREFIX, LOGIN_CODE_PREFIX, DOWNLOAD_PREFIX)
    for kind, prefix in zip(kinds, ("ug_", "us_", "uc_", "ud_"), strict=True):
        secrets = {new_secret(kind) for _ in range(100)}

        assert len(secrets) == 100
        assert {secret[:3] for secret in secrets} == {prefix}
        assert {len(secret) for secret in secrets} == {46}


def test_hash_of_a_secret_is_deterministic():
    assert hash_secret("ug_a") == hash_secret("ug_a") != hash_secret("ug_b")
    assert len(hash_secret("\ud800")) == 64


def test_hashes_are_compared_in_constant_time():
    """All look-ups use `same_hash`, which uses `compare_digest`."""
    assert "compare_digest" in same_hash.__code__.co_names
    for look_up in (access.by_token, access.by_session, access.by_code):
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
def test_bearer_token_is_parsed_from_the_header(header, token):
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
def test_host_name_is_returned_without_its_port(host, name):
    assert host_name(host) == name


@pytest.mark.parametrize(
    ("headers", "not_other"),
    [
        ({}, True),
        ({"origin": "http://127.0.0.1:8000"}, True),
        ({"origin": "https://127.0.0.1:8000"}, True),
        ({"origin": "http://127.0.0.1:8001"}, False),
        ({"origin": "http://127.0.0.1"}, False),
        ({"origin": "null"}, False),
        ({"origin": "127.0.0.1:8000"}, False),
        ({"origin": "http://evil.example"}, False),
        ({"sec-fetch-site": "same-origin"}, True),
        ({"sec-fetch-site": "same-site"}, False),
        ({"sec-fetch-site": "cross-site"}, False),
    ],
)
def test_cross_origin_requests_are_recognised(headers, not_other):
    headers = {**OWN_HOST, **headers}

    assert comes_from_no_other_page(headers) is not_other


def test_each_role_includes_the_lower_roles():
    included = {
        role: [other for other in get_args(Role) if includes(role, other)]
        for role in get_args(Role)
    }

    assert included == {
        "viewer": ["viewer"],
        "reviewer": ["viewer", "reviewer"],
        "admin": ["viewer", "reviewer", "admin"],
    }
