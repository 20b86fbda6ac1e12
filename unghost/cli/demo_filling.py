"""Fills a server that has just started with the demo, through its API like anyone."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from unghost.cli.push import ensure_dataset
from unghost.cli.push_report import PushReport
from unghost.cli.screen import Screen
from unghost.cli.source_options import SourceOptions
from unghost.cli.sources import open_source, outgoing
from unghost.client import Client
from unghost.work_results import Stats

DATASET: Final = "demo"


class Filling:
    """Pushes the street in a thread, since the main thread serves."""

    def __init__(
        self, street: Path, screen: Screen, token_file: Path, *, stop_when_done: bool
    ) -> None:
        self._street = street
        self._screen = screen
        self._token_file = token_file
        self._stop_when_done = stop_when_done
        self._error: Exception | None = None
        self.refused = 0

    def start(self, url: str) -> None:
        """Begin; the server answers from now on."""
        # A daemon: an interruption does not wait for frames that nobody wants.
        threading.Thread(target=self._run, args=(url,), daemon=True).start()

    def raise_if_failed(self) -> None:
        """What went wrong, if something did."""
        if self._error is not None:
            raise self._error

    def _run(self, url: str) -> None:
        try:
            self._fill(url)
        except Exception as error:  # told by the main thread, which it ends
            self._error = error
        if self._error is not None or self._stop_when_done:
            # As Ctrl-C does, which the server takes as the sign to end well.
            signal.raise_signal(signal.SIGINT)

    def _fill(self, url: str) -> None:
        token = self._token_file.read_text(encoding="utf-8").strip()
        with Client(url, token) as client:
            report = _push(client, self._street, self._screen)
            numbers = client.stats(DATASET)
            # Made now: rendering and pushing may take longer than a link is good for.
            login_link = f"{url}/#code={client.create_login_code().code}"
        self.refused = report.refused
        report.print_problems()
        self._screen.record(
            {"login_link": login_link, "dataset": DATASET, "stats": numbers.raw}
        )
        self._screen.table(("boxes", "verdict", "reason"), _rows(numbers))
        self._screen.text(
            f"\nLog in with\n\n    {login_link}\n\n"
            "The link works once, within ten minutes; `unghost login` prints another.\n"
        )


def _push(client: Client, street: Path, screen: Screen) -> PushReport:
    report = PushReport(Screen())
    found = open_source(street, SourceOptions())
    ensure_dataset(client, DATASET, {}, found.classes or ())
    with screen.progress("filter the street", "frames") as advance:
        for outcome in client.push(DATASET, outgoing(found)):
            report.add(outcome)
            advance(report.seen, found.count)
    return report


def _rows(numbers: Stats) -> Iterator[tuple[object, ...]]:
    from filter_core.types import Reason

    verdicts = {reason.label: reason.verdict.value for reason in Reason}
    by_count = sorted(numbers.by_reason.items(), key=lambda item: -item[1])
    for reason, count in by_count:
        yield count, verdicts.get(reason, ""), reason.replace("_", " ")
