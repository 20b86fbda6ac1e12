"""Writers on PostgreSQL take turns, with any server settings and if a process hangs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager

import pytest
from sqlalchemy import text

from app.db.engine import Database, keep_turn
from tests.support.databases import empty_postgres

STOPPED = """
import os, signal, sys
from sqlalchemy import text
from app.db.engine import Database
with Database(sys.argv[1]).write() as session:
    session.execute(text("SELECT 1"))
    print("in its turn", flush=True)
    os.kill(os.getpid(), signal.SIGSTOP)
"""


@pytest.fixture(scope="module")
def url():
    with empty_postgres() as url:
        yield url


@contextmanager
def writer_that_stands_still(url):
    """A process that is stopped by SIGSTOP within a transaction that writes."""
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED, url], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout
            assert process.stdout.readline()
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


def shown(session, name):
    return session.execute(text(f"SHOW {name}")).scalar_one()


def test_a_writer_sees_what_the_one_before_it_has_written(url):
    """With a snapshot from before its turn, it would miss what others then wrote."""
    with closing(Database(url)) as database:
        with database.write() as session:
            name = session.connection().engine.url.database
            level = f"ALTER DATABASE {name} SET default_transaction_isolation"
            session.execute(text(f"{level} = 'serializable'"))
        database.engine.dispose()
        with database.write() as session:
            found = shown(session, "transaction_isolation")
        with database.write_beside() as session:
            beside = shown(session, "transaction_isolation")
        with database.read() as session:
            reading = shown(session, "transaction_isolation")

    assert (found, beside, reading) == (
        "read committed",
        "read committed",
        "repeatable read",
    )


def test_a_turn_ends_before_those_who_wait_for_it_give_up(url):
    with closing(Database(url)) as database, database.write() as session:
        waited_for = shown(session, "idle_in_transaction_session_timeout")
        waits = shown(session, "lock_timeout")

    assert (waited_for, waits) == ("20s", "30s")


def test_a_collection_of_garbage_keeps_its_turn(url):
    """Removing files may take long; meanwhile no transaction may refer to them."""
    with closing(Database(url)) as database, database.write() as session:
        keep_turn(session)
        waited_for = shown(session, "idle_in_transaction_session_timeout")

    assert waited_for == "0"


@pytest.mark.long
def test_a_process_that_stands_still_does_not_keep_its_turn(url):
    """Without a timeout, a machine that is gone would block all writers for hours."""
    with writer_that_stands_still(url), closing(Database(url)) as database:
        begun = time.monotonic()
        with database.write() as session:
            session.execute(text("SELECT 1"))
        took = time.monotonic() - begun

    assert 10 < took < 30
