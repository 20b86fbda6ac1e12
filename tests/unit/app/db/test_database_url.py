"""Which database URLs are accepted; no error message contains a password."""

import pytest
from pydantic import ValidationError
from sqlalchemy import make_url

from app.settings import Settings

SECRET = "s3cret"
AT_SIGN_MEANS_PASSWORD = "@ : / ? in a password are written as %40 %3A %2F %3F"


PLACE = f"ada:p%40{SECRET}@db.example:5433/boxes?sslmode=require"


@pytest.mark.parametrize(
    ("url", "driver_url"),
    [
        (f"postgres://{PLACE}", f"postgresql+psycopg://{PLACE}"),
        (f"postgresql://{PLACE}", f"postgresql+psycopg://{PLACE}"),
        (f"postgresql+psycopg://{PLACE}", f"postgresql+psycopg://{PLACE}"),
        ("sqlite:////srv/boxes.db", "sqlite:////srv/boxes.db"),
    ],
)
def test_url_is_that_of_the_driver_and_is_not_printed(url, driver_url):
    settings = Settings(database_url=url)

    assert settings.sqlalchemy_url == driver_url
    assert SECRET not in repr(settings) + str(settings)


def test_question_mark_in_a_password_is_accepted():
    url = Settings(database_url="postgresql://ada:p?ss@db/b?sslmode=require")

    assert make_url(url.sqlalchemy_url).password == "p?ss"
    assert make_url(url.sqlalchemy_url).host == "db"


@pytest.mark.parametrize(
    ("url", "said"),
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
def test_unsupported_database_url_is_refused_without_its_password(url, said):
    with pytest.raises(ValidationError) as refused:
        Settings(database_url=url)

    assert said in str(refused.value)
    assert SECRET not in str(refused.value)
    assert SECRET[:2] not in str(refused.value)
