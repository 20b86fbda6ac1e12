"""The memory that all connections to SQLite use for their caches is bounded."""

import subprocess
import sys
from pathlib import Path

import pytest

from app.db.engine import CACHE_KIB

READERS = 32
STORED_MIB = 48
READ_BY_MANY = """
import sys
from contextlib import ExitStack
from pathlib import Path
from sqlalchemy import text
from app.db.engine import Database

def resident_kib():
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])

database = Database(f"sqlite:///{sys.argv[1]}")
with database.write() as session:
    session.execute(text("CREATE TABLE pages (content BLOB)"))
    session.execute(
        text("INSERT INTO pages WITH RECURSIVE number(n) AS (SELECT 1 UNION ALL"
             " SELECT n + 1 FROM number WHERE n < :rows)"
             " SELECT zeroblob(1000) FROM number"),
        {"rows": int(sys.argv[3]) * 1000},
    )
with ExitStack() as opened:
    readers = [opened.enter_context(database.read()) for _ in range(int(sys.argv[2]))]
    before = resident_kib()
    for reader in readers:
        reader.execute(text("SELECT sum(length(content)) FROM pages")).scalar_one()
    print(resident_kib() - before)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for its memory")
def test_cache_memory_of_many_readers_is_bounded(tmp_path: Path):
    command = [sys.executable, "-c", READ_BY_MANY, str(tmp_path / "some.db")]
    counts = [str(READERS), str(STORED_MIB)]

    ended = subprocess.run(
        [*command, *counts], check=True, capture_output=True, text=True
    )

    grown_mib = int(ended.stdout) / 1024
    # A cached page needs a little more memory than its content.
    assert grown_mib < 1.5 * READERS * CACHE_KIB / 1024
