"""Large request bodies are parsed in a thread, small ones in the event loop."""

import asyncio
import threading
from typing import Any

import pytest
from fastapi import FastAPI

from app.context import ServiceContext
from app.errors import Unprocessable
from app.http.admission import Admission
from app.http.bodies import StrictRequest, run_off_loop
from tests.support.threads import in_thread


def request_with(body):
    app = FastAPI()
    unused: Any = None
    app.state.services = ServiceContext(*[unused] * 7)
    app.state.services.keep(Admission(1))

    async def receive():
        return {"type": "http.request", "body": body, "more_body": False}

    scope = {"type": "http", "app": app, "method": "POST", "headers": []}
    return StrictRequest(scope, receive)


def test_event_loop_runs_while_a_large_body_is_parsed():
    let_go = threading.Event()

    async def main():
        request = request_with(b"")
        work = run_off_loop(request, bytes(5000), lambda _: let_go.wait(60))
        working = asyncio.create_task(work)
        asyncio.get_running_loop().call_soon(let_go.set)
        return await working

    assert in_thread(asyncio.run, main())


def test_small_body_is_parsed_in_the_event_loop_thread():
    async def main():
        request = request_with(b"")
        working = await run_off_loop(request, b"x", lambda _: threading.get_ident())
        return working, threading.get_ident()

    working, looping = in_thread(asyncio.run, main())
    assert working == looping


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"{", "json_invalid"),
        (b'"\xff"', "json_invalid"),
        (b'"\\ud800"', "json_invalid"),
        (b"[" * 40, "json_too_large"),
        (b"[" + b"1," * 320_000 + b"1]", "json_too_large"),
        (b"{" + b'"":1,' * 10_000 + b'"":1}', "json_too_large"),
    ],
)
def test_invalid_or_too_large_json_body_has_one_error(body, code):
    with pytest.raises(Unprocessable) as refused:
        in_thread(asyncio.run, request_with(body).json())

    (fault,) = refused.value.faults
    assert (refused.value.kind, fault.code) == ("invalid_request", code)
    assert fault.detail.startswith("expected JSON in UTF-8, found ")
