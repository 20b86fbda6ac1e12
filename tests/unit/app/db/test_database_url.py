"""Which database URLs are accepted; no error message contains a password."""

from __future__ import annotations

import pytest
from pydantic import ValidationError
from sqlalchemy import make_url

from app.settings import Settings

SECRET = "s3cret"
AT_SIGN_MEANS_PASSWORD = "@ : / ? in a password are written as %40 %3A %2F %3F"


@pytest.mark.parametrize(
    "given",
    [
        "postgres://ada:p%40ss@db.example:5433/boxes?sslmode=require",
        "postgresql://ada:p%40ss@db.example:5433/boxes?sslmode=require",
        "postgresql+psycopg://ada:p%40ss@db.example:5433/boxes?sslmode=require",
    ],
)
def test_postgresql_urls_are_changed_to_psycopg_3(given):
    url = Settings(database_url=given).sqlalchemy_url

    assert url == (
        "postgresql+psycopg://ada:p%40ss@db.example:5433/boxes?sslmode=require"
    )


def test_question_mark_in_a_password_is_accepted():
    url = Settings(database_url="postgresql://ada:p?ss@db/b?sslmode=require")

    assert make_url(url.sqlalchemy_url).password == "p?ss"
    assert make_url(url.sqlalchemy_url).host == "db"


def test_sqlite_url_is_unchanged():
    url = "sqlite:////srv/boxes.db"

    assert Settings(database_url=url).sqlalchemy_url == url


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (f"postgresql+psycopg2://a:{SECRET}@db/b", "'postgresql+psycopg2' is not"),
        (f"postgresql+asyncpg://a:{SECRET}@db/b", "'postgresql+asyncpg' is not"),
        (f"mysql://a:{SECRET}@db/b", "'mysql' is not"),
        (f"mongodb://a:{SECRET}@db/b", "SQLite, or PostgreSQL with psycopg 3"),
        (f"postgresql://db:{SECRET}/b", "cannot be read as a URL"),
        (f"postgresql://a:p@{SECRET}@db/b", AT_SIGN_MEANS_PASSWORD),
        (f"postgresql://a:p@{SECRET}/@db/b", AT_SIGN_MEANS_PASSWORD),
        (f"postgresql://a:p@{SECRET}?@db/b", AT_SIGN_MEANS_PASSWORD),
        (f"postgresql://a:p@{SECRET}?@db/b?sslmode=require", AT_SIGN_MEANS_PASSWORD),
        (f"host=db password={SECRET}", "cannot be read as a URL"),
        ("sqlite://", "in memory would be lost"),
        ("sqlite:///:memory:", "in memory would be lost"),
    ],
)
def test_unsupported_database_url_is_refused_without_its_password(given, said):
    with pytest.raises(ValidationError) as refused:
        Settings(database_url=given)

    assert said in str(refused.value)
    assert SECRET not in str(refused.value)
    assert SECRET[:2] not in str(refused.value)


def test_printed_settings_hide_the_password():
    settings = Settings(database_url=f"postgresql://a:{SECRET}@db/b")

    assert SECRET in settings.sqlalchemy_url
    assert SECRET not in repr(settings)
    assert SECRET not in str(settings)
