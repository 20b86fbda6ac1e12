"""Who guesses tokens has to wait; who only shows an old one, or works, has not."""

from __future__ import annotations

import pytest

from app.errors import TooManyRequests
from app.services.failed_logins import WINDOW_S, FailedLogins, place_of

HERE = "192.0.2.1"
MOST = 3


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def logins(clock):
    return FailedLogins(MOST, clock)


def guess(logins, *secrets, address=HERE):
    for secret in secrets:
        logins.check(address, secret)
        logins.failed(address, secret)


def test_different_wrong_tokens_are_counted(logins):
    guess(logins, "a", "b", "c")

    with pytest.raises(TooManyRequests) as refused:
        logins.check(HERE, "d")

    assert refused.value.kind == "too_many_logins"
    assert refused.value.retry_after_s == WINDOW_S


def test_the_same_wrong_token_counts_once(logins):
    guess(logins, *["old"] * 50)

    logins.check(HERE, "new")


def test_one_waits_until_the_oldest_is_a_minute_ago(logins, clock):
    guess(logins, "a")
    clock.now += 20
    guess(logins, "b", "c")
    clock.now += 39.5

    with pytest.raises(TooManyRequests) as refused:
        logins.check(HERE, "d")
    clock.now += 0.5

    assert refused.value.retry_after_s == 1
    guess(logins, "d")
    with pytest.raises(TooManyRequests):
        logins.check(HERE, "e")


def test_elsewhere_one_does_not_wait(logins):
    guess(logins, "a", "b", "c")

    logins.check("192.0.2.2", "d")


def test_what_was_right_before_goes_on_while_a_neighbour_guesses(logins):
    logins.succeeded(HERE, "right")
    guess(logins, "a", "b", "c")

    logins.check(HERE, "right")
    with pytest.raises(TooManyRequests):
        logins.check("192.0.2.1", "right as well, but nobody knows")


def test_what_was_right_and_is_not_any_more_is_a_guess(logins):
    logins.succeeded(HERE, "revoked")
    guess(logins, "a", "b", "revoked")

    with pytest.raises(TooManyRequests):
        logins.check(HERE, "revoked")


def test_no_number_of_addresses_fills_the_memory(logins):
    for number in range(5000):
        address = f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}"
        guess(logins, "a", address=address)
        logins.succeeded(address, "b")

    assert max(len(logins._failed), len(logins._proven)) <= 4096


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::9", "2001:db8:1:2::/64"),
        ("::1", "::/64"),
        ("unix socket", "unix socket"),
        (None, "-"),
    ],
)
def test_one_house_is_one_place(address, place):
    assert place_of(address) == place
