"""Serves, examines, backs up and restores data folders."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.maintenance.backup import BackupLabel, make_backup
from app.maintenance.datafolder import Advance
from app.maintenance.doctor import Finding, Severity, examine
from app.maintenance.restore import restore
from app.settings import Settings
from tests.support.api import Api
from tests.support.databases import rows_of, settings_of
from tests.support.servers import RunningServer, running_server


@contextmanager
def served(data: Path, **settings: str) -> Iterator[tuple[RunningServer, Api]]:
    """Serve a data folder; yields the server, and a client with the admin's token."""
    with running_server(data, settings) as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            yield server, api


@contextmanager
def silently(_title: str, _unit: str) -> Iterator[Advance]:
    """A callback for progress that does nothing."""
    yield lambda _done, _total: None


def backed_up(data: Path, target: Path, *, incomplete: bool = False) -> Path:
    """Back up a data folder that is not served, and return the path of the backup."""
    settings = Settings(data=data)
    return make_backup(settings, target, incomplete=incomplete, steps=silently).path


def restored(backup: Path, data: Path) -> tuple[BackupLabel, int]:
    """Restore a backup into a data folder; its label, and how many files it has."""
    return restore(Settings(data=data), backup, silently)


def doctor_findings(data: Path, **settings: object) -> dict[str, Finding]:
    """The findings of `unghost doctor --verify` that are not OK, by their check."""
    chosen = Settings.model_validate({"data": data, **settings_of(data), **settings})
    return {
        finding.check: finding
        for finding in examine(chosen, verify=True, steps=silently)
        if finding.severity is not Severity.OK
    }


def blobs(data: Path) -> list[Path]:
    """The paths of the images and other files that a data folder stores, sorted."""
    return sorted(
        path for path in (data / "blobs").glob("??/*") if len(path.name) == 64
    )


def count(data, table="boxes"):
    ((rows,),) = rows_of(data, f"SELECT count(*) FROM {table}")
    return rows
