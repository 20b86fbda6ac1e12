"""Ids of deleted datasets are not reused, so no old link leads to another dataset."""

from app.datasets.service import remove_dataset
from tests.support.services import running_services


def test_id_of_a_deleted_dataset_is_not_reused(tmp_path):
    with running_services(tmp_path / "data") as services:
        first = services.dataset()
        with services.context.database.write() as session:
            remove_dataset(services.context, session, first.name, first.name)

        second = services.dataset()

    assert second.id > first.id
