"""The OpenAPI document, which the service takes long to make."""

from typing import Any

import pytest

from app.main import create_app
from app.settings import Settings


@pytest.fixture(scope="session")
def document() -> dict[str, Any]:
    """The document of the service, without the routes that tests add; not changed."""
    return create_app(Settings()).openapi()
