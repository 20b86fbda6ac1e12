"""Services whose files are in a bucket, behind a gate that can be shut."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.s3_server import S3Server
from tests.support.s3_service import OnS3, served_on_s3


@pytest.fixture(scope="session")
def on_s3(tmp_path_factory: pytest.TempPathFactory, s3: S3Server) -> Iterator[OnS3]:
    """One for all tests; name your datasets apart."""
    with served_on_s3(tmp_path_factory.mktemp("on-s3"), s3) as running:
        yield running
