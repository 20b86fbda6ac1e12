"""Datasets, and the numbers over a whole one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from unghost.calls.base import Calls, dataset_path, read
from unghost.results import Dataset, RefusedFrame
from unghost.transport import API, Call, body_of
from unghost.work_results import Histogram, Preview, Run, Stats


class DatasetCalls(Calls):
    """Methods on datasets."""

    def datasets(self) -> Iterator[Dataset]:
        """Every dataset, by name."""
        return self._all(Dataset, f"{API}/datasets")

    def dataset(self, name: str) -> Dataset:
        """One dataset."""
        return self._get(Dataset, dataset_path(name))

    def create_dataset(self, name: str, **options: object) -> Dataset:
        """Make a dataset; `options` are classes, palette, encoding, channel_order,
        lossy_segmentation, ignore_mask and description.
        """
        given = {key: value for key, value in options.items() if value is not None}
        return self._post(Dataset, f"{API}/datasets", {"name": name, **given})

    def change_dataset(self, name: str, **options: object) -> Dataset | Run:
        """Change options, as in `create_dataset`.

        What concerns pixels is returned as the run that measures again; the dataset
        changes when that is done.
        """
        response = self._transport.send(Call("PATCH", dataset_path(name), json=options))
        if response.status_code == 202:
            return read(Run, body_of(response), response)
        return read(Dataset, body_of(response), response)

    def delete_dataset(self, name: str) -> None:
        """Delete a dataset with everything in it, reviews included."""
        self._transport.send(
            Call("DELETE", dataset_path(name), params={"confirm": name})
        )

    def stats(self, dataset: str) -> Stats:
        """Counts by verdict, reason and class, and of the reviews."""
        return self._get(Stats, dataset_path(dataset, "stats"))

    def histogram(self, dataset: str, *, bins: int = 50) -> Histogram:
        """Boxes per bin of match percent, for each class."""
        return self._get(Histogram, dataset_path(dataset, "histogram"), {"bins": bins})

    def preview(
        self, dataset: str, config: Mapping[str, Any], *, limit: int = 100
    ) -> Preview:
        """What a config would decide, and up to `limit` boxes that would flip."""
        body = {"config": config, "limit": limit}
        return self._post(Preview, dataset_path(dataset, "preview"), body)

    def problems(self, dataset: str) -> Iterator[RefusedFrame]:
        """The frames that were sent and refused, with their errors."""
        return self._all(RefusedFrame, dataset_path(dataset, "problems"))
