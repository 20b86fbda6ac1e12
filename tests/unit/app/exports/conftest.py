"""A dataset for the tests of exports."""

from collections.abc import Callable

import pytest

from tests.support import frames as scene
from tests.support.services import ANSWERED_AT, ServiceDataset


@pytest.fixture(scope="module")
def make_street(services) -> Callable[[], ServiceDataset]:
    """Makes three frames of two boxes; the first box has been answered."""

    def make() -> ServiceDataset:
        street: ServiceDataset = services.dataset()
        for number in range(3):
            files = {"image": scene.image(number), "segmentation": scene.segmentation()}
            street.put(f"{number}", scene.annotation(), **files)
        street.review(street.box_ids()[0], "reject", at=ANSWERED_AT)
        return street

    return make
