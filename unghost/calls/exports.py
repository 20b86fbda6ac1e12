"""Exports: made by the server, then downloaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path

from unghost.calls.base import dataset_path
from unghost.calls.followed import FollowedCalls
from unghost.download import Download, fetch
from unghost.errors import run_failed
from unghost.retry import PATIENCE
from unghost.transport import API
from unghost.work_results import Export


class ExportCalls(FollowedCalls):
    """Methods on exports."""

    def exports(self, dataset: str) -> Iterator[Export]:
        """The exports of a dataset, newest first."""
        return self._all(Export, dataset_path(dataset, "exports"))

    def start_export(self, dataset: str, format: str, **options: object) -> Export:
        """Have the labels written in a ZIP archive: "yolo", "coco", "kitti", "voc" and
        others; formats and options as in the documentation of the formats.
        """
        body = {"format": format, "options": options}
        return self._post(Export, dataset_path(dataset, "exports"), body)

    def cancel_export(self, export: Export | int) -> Export:
        """End an export that is not over; `Conflict` if it is."""
        return self._post(Export, f"{API}/exports/{_id_of(export)}/cancel")

    def export(self, export_id: int) -> Export:
        """One export as it is now."""
        return self._get(Export, f"{API}/exports/{export_id}")

    def export_events(self, export: Export | int) -> Iterator[Export]:
        """An export each time that it changes, until it is over.

        A stream that breaks off is taken up where it was.
        """
        return self._events(Export, f"{API}/exports/{_id_of(export)}/events")

    def wait_for_export(
        self,
        export: Export | int,
        *,
        progress: Callable[[Export], object] | None = None,
        timeout_s: float | None = None,
    ) -> Export:
        """The export when it is done; raises as `wait` does for a run."""
        export_id = _id_of(export)
        ended = self._ended(
            lambda: self.export_events(export_id),
            lambda: self._get(Export, f"{API}/exports/{export_id}", patience=PATIENCE),
            progress,
            timeout_s,
        )
        if ended.state != "done":
            raise run_failed(f"export {export_id}", ended.state, ended.error)
        return ended

    def download(
        self,
        export: Export,
        path: str | PathLike[str],
        *,
        progress: Callable[[int, int | None], object] | None = None,
    ) -> Path:
        """Fetch a finished export to `path`, which appears whole or not at all.

        An interrupted download goes on where it stopped when it is asked for again.
        """
        url = export.download or f"{API}/exports/{export.id}/download"
        wanted = Download(url, Path(path), export.sha256, export.size_bytes)
        return fetch(self._transport, wanted, progress)


def _id_of(export: Export | int) -> int:
    return export if isinstance(export, int) else export.id
