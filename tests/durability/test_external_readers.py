"""Another process that reads the SQLite file and closes it does the service no harm."""

import subprocess
import sys

import pytest

from tests.support.services import running_services

pytestmark = pytest.mark.sqlite_files("SQLite keeps its log beside its file")

COUNT_DATASETS = (
    "import sqlite3, sys; database = sqlite3.connect(sys.argv[1]); "
    "print(*database.execute('SELECT count(*) FROM datasets').fetchone()); "
    "database.close()"
)


def count_datasets_in_another_process(file):
    """The number of datasets that another process reads before it closes the file."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT_DATASETS, str(file)],
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout)


def test_rows_written_after_another_process_read_the_database_are_kept(tmp_path):
    """The last connection to close deletes SQLite's log; the service still has one."""
    file = tmp_path / "data" / "unghost.db"
    with running_services(tmp_path / "data"):
        pass  # creates the database, which the next start opens

    with running_services(tmp_path / "data") as services:
        services.dataset()
        first = count_datasets_in_another_process(file)
        services.dataset()
        second = count_datasets_in_another_process(file)
        has_log = file.with_name("unghost.db-wal").exists()

    assert (first, second, has_log) == (1, 2, True)
    assert count_datasets_in_another_process(file) == 2
