"""A worker that cannot reach its database waits, and then gives up with a message."""

import signal

import pytest

from tests.support.ports import reserved_port

SECRET = "hidden-word"


@pytest.fixture
def settings_without_database():
    """A setting with the address of a PostgreSQL server that is not running."""
    with reserved_port() as port:
        address = f"postgresql://postgres:{SECRET}@127.0.0.1:{port}/nothing"
        yield {"UNGHOST_DATABASE_URL": address}


def test_worker_without_a_database_exits_with_69_and_a_message(
    made, settings_without_database
):
    """Formerly it ended with a traceback, and with the exit code of wrong settings."""
    worker = made.worker("--patience", "1", joined=False, **settings_without_database)

    assert worker.wait_for_exit() == 69
    assert "the database does not respond" in worker.log_text
    assert SECRET not in worker.log_text
    assert "Traceback" not in worker.log_text


def test_worker_waiting_for_its_database_stops_on_sigterm(
    made, settings_without_database
):
    worker = made.worker(joined=False, **settings_without_database)
    worker.wait_for_log("waiting for the database")

    worker.process.send_signal(signal.SIGTERM)

    assert worker.wait_for_exit() == 0, worker.log_text
