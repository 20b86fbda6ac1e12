"""A service whose files are in a bucket.

Between the two is a gate that tests can shut, to make the bucket unreachable.
"""

from collections.abc import Iterator

import pytest

from tests.support.s3_server import S3Server
from tests.support.s3_service import S3Service, served_on_s3


@pytest.fixture(scope="session")
def on_s3(
    tmp_path_factory: pytest.TempPathFactory, s3: S3Server
) -> Iterator[S3Service]:
    """One such service for all tests, which give their datasets different names."""
    with served_on_s3(tmp_path_factory.mktemp("on-s3"), s3) as running:
        yield running
