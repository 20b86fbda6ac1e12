"""An unreachable Dask scheduler is reported by its cause, without a traceback."""

import logging
from asyncio import CancelledError
from itertools import pairwise

import pytest
from distributed.comm import CommClosedError

from app.engine.dask import prepare, reason_of


def caused(*errors: BaseException) -> BaseException:
    """The first error, caused by the second, and so on."""
    for error, cause in pairwise(errors):
        error.__cause__ = cause
    return errors[0]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(111, "Connection refused"), "Connection refused"),
        (caused(OSError("it timed out"), OSError(111, "Refused")), "Refused"),
        (
            caused(OSError("it timed out"), TimeoutError(), CancelledError()),
            "it timed out",
        ),
        (caused(OSError("it timed out"), CancelledError()), "it timed out"),
    ],
)
def test_reason_of_returns_the_last_cause_with_a_message(error, words):
    assert reason_of(error) == words


@pytest.mark.parametrize(
    ("error", "told"), [(CommClosedError("away"), 0), (ValueError("wrong"), 1)]
)
def test_lost_connection_is_not_logged_by_libraries(caplog, error, told):
    prepare()

    logging.getLogger("tornado.application").error("in a callback", exc_info=error)

    assert len(caplog.records) == told
