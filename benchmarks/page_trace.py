"""What the page's main thread does per animation frame, from Chromium's own trace."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from playwright.sync_api import CDPSession, Page

_CATEGORIES: Final = ("toplevel", "devtools.timeline", "__metadata")
_FRAME: Final = "FireAnimationFrame"
_TASKS: Final = ("ThreadControllerImpl::RunTask", "RunTask")
_MAIN_THREAD: Final = "CrRendererMain"
_US_PER_MS: Final = 1000
_WAIT_MS: Final = 20


def milliseconds_per_frame(page: Page, interact: Callable[[], None]) -> np.ndarray:
    """Processor time of the page's main thread while `interact` runs, frame by frame.

    Everything counts that runs there from one animation frame to the next: events,
    scripts, layout, recording and, without a graphics card, painting of canvases.
    """
    events = _traced(page, interact)
    thread = _main_thread(events)
    own = [e for e in events if (e["pid"], e["tid"]) == thread]
    starts = np.array(sorted(e["ts"] for e in own if e["name"] == _FRAME))
    tasks = [e for e in own if e["name"] in _TASKS and e["ph"] == "X"]
    sums = np.zeros(len(starts) + 1)
    for task in tasks:
        ends = task["ts"] + task["dur"]
        sums[np.searchsorted(starts, ends)] += task.get("tdur", task["dur"])
    # What lies before the first frame and after the last belongs to no frame.
    return sums[1:-1] / _US_PER_MS


def _traced(page: Page, interact: Callable[[], None]) -> list[dict[str, Any]]:
    session = page.context.new_cdp_session(page)
    config = {"includedCategories": list(_CATEGORIES)}
    streams: list[str] = []
    session.on("Tracing.tracingComplete", lambda done: streams.append(done["stream"]))
    session.send(
        "Tracing.start", {"transferMode": "ReturnAsStream", "traceConfig": config}
    )
    interact()
    session.send("Tracing.end")
    while not streams:
        page.wait_for_timeout(_WAIT_MS)
    content = json.loads(_read(session, streams[0]))
    events: list[dict[str, Any]] = content["traceEvents"]
    return events


def _read(session: CDPSession, stream: str) -> str:
    pieces = []
    while True:
        piece = session.send("IO.read", {"handle": stream, "size": 1 << 22})
        pieces.append(piece["data"])
        if piece["eof"]:
            return "".join(pieces)


def _main_thread(events: list[dict[str, Any]]) -> tuple[int, int]:
    """Process and thread that draw: of all pages' main threads the busiest."""
    mains = {
        (e["pid"], e["tid"])
        for e in events
        if e["name"] == "thread_name" and e["args"]["name"] == _MAIN_THREAD
    }
    frames = [(e["pid"], e["tid"]) for e in events if e["name"] == _FRAME]
    return max(mains, key=frames.count)
