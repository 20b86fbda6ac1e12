"""Addresses that the service cannot listen on are refused, and no socket stays open."""

from __future__ import annotations

import gc
import warnings

import pytest

from app.serve import CannotServe, check_free, listen
from app.settings import Settings


def test_a_socket_that_cannot_listen_is_closed():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with pytest.raises(OverflowError):
            listen("127.0.0.1", 70_000)
        gc.collect()

    assert [str(one.message) for one in told] == []


@pytest.mark.parametrize("host", ["x" * 64 + ".example", "a..b"])
def test_invalid_host_name_raises_cannot_serve(tmp_path, host):
    with pytest.raises(CannotServe, match="cannot listen on"):
        check_free(Settings(data=tmp_path, host=host, allowed_hosts=["*"]))
