"""Calls a function in another thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

_Result = TypeVar("_Result")


def in_thread(call: Callable[..., _Result], *arguments: Any) -> _Result:
    """Call a function that starts an event loop; returns or raises what it does.

    It cannot start one in the thread of the tests, in which Playwright has a running
    event loop as soon as a test in the browser has begun.
    """
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(call, *arguments).result()
