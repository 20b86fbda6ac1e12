"""Writers on PostgreSQL take turns, with any server settings and if a process hangs."""

import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager

import pytest
from sqlalchemy import text

from app.db.engine import Database, keep_turn
from tests.support.databases import empty_postgres

STOPPED_WRITER = """
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
def stopped_writer(url):
    """A process that is stopped by SIGSTOP within a transaction that writes."""
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED_WRITER, url], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout
            assert process.stdout.readline()
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


def show_setting(session, name):
    return session.execute(text(f"SHOW {name}")).scalar_one()


def test_isolation_levels_do_not_depend_on_the_default_of_the_server(url):
    """With a snapshot from before its turn, it would miss what others then wrote."""
    with closing(Database(url)) as database:
        with database.write() as session:
            name = session.connection().engine.url.database
            level = f"ALTER DATABASE {name} SET default_transaction_isolation"
            session.execute(text(f"{level} = 'serializable'"))
        database.engine.dispose()
        with database.write() as session:
            writing = show_setting(session, "transaction_isolation")
        with database.write_out_of_turn() as session:
            beside = show_setting(session, "transaction_isolation")
        with database.read() as session:
            reading = show_setting(session, "transaction_isolation")

    assert (writing, beside, reading) == (
        "read committed",
        "read committed",
        "repeatable read",
    )


def test_turn_times_out_before_waiting_writers_do_unless_it_is_kept(url):
    """A garbage collection may take long; meanwhile none may refer to its files."""
    timeout = "idle_in_transaction_session_timeout"
    with closing(Database(url)) as database, database.write() as session:
        usual = show_setting(session, timeout), show_setting(session, "lock_timeout")
        keep_turn(session)
        kept = show_setting(session, timeout)

    assert (usual, kept) == (("20s", "30s"), "0")


@pytest.mark.long
def test_process_that_hangs_loses_its_turn(url):
    """Without a timeout, a failed machine would block all writers for hours."""
    with stopped_writer(url), closing(Database(url)) as database:
        begun = time.monotonic()
        with database.write() as session:
            session.execute(text("SELECT 1"))
        took = time.monotonic() - begun

    assert 10 < took < 30
