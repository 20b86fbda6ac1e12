"""The cache of callers keeps each for one second, and none after a revocation."""

import time

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.orm import Session

from app.access import gate as callers
from app.access.gate import RecentCallers
from app.security import Principal

ADA = Principal(1, "ada", "reviewer")


NOW = 1000.0


@pytest.fixture
def recent(monkeypatch):
    monkeypatch.setattr(time, "monotonic", lambda: NOW)
    recent = RecentCallers()
    recent.remember("token x", ADA, recent.revocations)
    return recent


def test_only_a_remembered_credential_is_found_for_a_second(recent, monkeypatch):
    assert recent.find("token x") == ADA
    assert recent.find("session x") is None
    monkeypatch.setattr(time, "monotonic", lambda: NOW + callers.REMEMBERED_S)

    assert recent.find("token x") is None


@pytest.mark.parametrize("ends", ["commit", "rollback"])
def test_callers_are_forgotten_on_commit_but_not_on_rollback(recent, ends):
    with Session(create_engine("sqlite://")) as session:
        recent.forget_on_commit(session)
        session.execute(text("select 1"))
        assert recent.find("token x") == ADA
        getattr(session, ends)()

    assert (recent.find("token x") is None) == (ends == "commit")


def test_token_looked_up_before_its_revocation_is_not_remembered(recent):
    before = recent.revocations
    with Session(create_engine("sqlite://")) as session:
        recent.forget_on_commit(session)
        session.execute(text("select 1"))
        session.commit()

    recent.remember("token x", ADA, before)

    assert recent.find("token x") is None
