"""`unghost serve` and `unghost demo`: the service and its page, on this machine.

The demo renders a street with ghost boxes and uploads it through the API while the
service runs.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from unghost.cli.options import DataFolder, OutputOptions, settings_of, written_file
from unghost.cli.remote.access import remove_login_pages, show_login_page
from unghost.cli.remote.push import PushReport
from unghost.cli.remote.target import NewDataset, ensure_dataset
from unghost.cli.screen import PARTLY, Screen, most_first, refused_on
from unghost.cli.sources import SourceOptions, open_source, outgoing

if TYPE_CHECKING:
    from unghost.client.client import Client
    from unghost.client.outgoing import OutgoingFrame

_DEMO_DATA: Final = Path("demo-data")
_DEMO_DATASET: Final = "demo"
_BY_TAGS_DATASET: Final = "demo-by-tags"
"""The same street with segmentations only, decided as in the paper."""

Port: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Port to listen on, 0 for any free one; default: UNGHOST_PORT, else 8000.",
        min=0,
        max=65535,
    ),
]


@dataclass(frozen=True, kw_only=True)
class ServeOptions(OutputOptions):
    data: DataFolder = None
    config: Annotated[
        Path | None,
        written_file(
            metavar="FILE",
            help="A filter configuration (YAML): the first one of every new dataset.",
        ),
    ] = None
    host: Annotated[
        str | None,
        typer.Option(
            help="Address to listen on; default: UNGHOST_HOST, else 127.0.0.1."
        ),
    ] = None
    port: Port = None
    open: Annotated[
        bool, typer.Option("--open", help="Open the review page in the browser.")
    ] = False


def serve(options: ServeOptions) -> None:
    """Serve the review page and the API until interrupted.

    Prints a login link when it is ready.
    """
    from app import serve as startup

    screen = options.screen
    settings = settings_of(
        data=options.data, config=options.config, host=options.host, port=options.port
    )
    stop = threading.Event()
    opened: list[threading.Thread] = []

    def ready(link: str, is_over: Callable[[], bool]) -> None:
        # Left behind by a service that was killed.
        remove_login_pages(settings.data)
        record = {"login_link": link, "data": str(settings.data)}
        screen.record(record, startup.ready_text(link))
        if options.open:
            arguments = (link, settings.data, is_over, stop)
            opened.append(threading.Thread(target=show_login_page, args=arguments))
            opened[0].start()

    try:
        with refused_on(startup.CannotServe):
            startup.serve(settings, on_ready=ready)
    finally:
        stop.set()
        for thread in opened:
            thread.join()


@dataclass(frozen=True, kw_only=True)
class DemoOptions(OutputOptions):
    frames: Annotated[
        int, typer.Option(min=1, max=10_000, help="Number of frames to render.")
    ] = 48
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number that the street is drawn from; each gives another street.",
        ),
    ] = 0
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Data folder; default: UNGHOST_DATA, else ./demo-data.",
            file_okay=False,
        ),
    ] = None
    port: Port = None
    exit_when_ready: Annotated[
        bool, typer.Option("--exit-when-ready", help="Exit when the demo is ready.")
    ] = False


def demo(options: DemoOptions) -> None:
    """Render a small street with ghost boxes, filter it, and serve the review page.

    The page is there at once, and its frames appear while they are rendered, which is
    done once: they stay in the data folder. Serves until interrupted.
    """
    screen = options.screen
    folder = options.data
    if folder is None and "UNGHOST_DATA" not in os.environ:
        folder = _DEMO_DATA
    # A log line per request would hide the bars, so by default there are none.
    quiet = None if "UNGHOST_LOG_LEVEL" in os.environ else "warning"
    settings = settings_of(data=folder, port=options.port, log_level=quiet)
    filling = _Filling(options, settings.data, settings.token_file)
    # Before the import of the service, which takes as long as a frame.
    filling.render()
    from app import serve as startup

    with refused_on(startup.CannotServe):

        def ready(link: str, _is_over: Callable[[], bool]) -> None:
            screen.record(
                {"login_link": link, "data": str(settings.data)},
                startup.ready_text(link),
            )
            filling.start(link.partition("/#")[0])

        startup.serve(settings, on_locked=filling.is_locked.set, on_ready=ready)
    filling.raise_if_failed()
    if filling.refused:
        raise typer.Exit(PARTLY)


def rendered_frames(
    data: Path, options: DemoOptions, is_locked: threading.Event
) -> Iterator[dict[str, object]]:
    """Lines of the street's manifest, with absolute paths, as its frames get ready.

    The street is rendered unless that was done before. Nothing is written before the
    data folder is locked.
    """
    from app.storage.durable import make_folder
    from filter_core.formats.manifest import FRAME_FILES
    from filter_core.formats.reading import MANIFEST_NAME
    from unghost.street.street import render_street

    folder = street_folder(data, options)
    # Renamed when complete, so that an interrupted rendering is never used.
    partial = folder.with_name(f"{folder.name}.part")

    def made_folder() -> Path:
        is_locked.wait()
        make_folder(partial)
        return partial

    def frames() -> Iterator[dict[str, object]]:
        lines: Iterable[dict[str, object]]
        if folder.exists():
            text = (folder / MANIFEST_NAME).read_text("utf-8")
            place, lines = folder, map(json.loads, text.splitlines())
        else:
            lines = render_street(made_folder, options.frames, options.seed)
            place = partial
        for line in lines:
            kinds = (kind for kind in FRAME_FILES if kind in line)
            yield line | {kind: str(place / str(line[kind])) for kind in kinds}
        # Another demo may have rendered it before this one had locked the folder.
        if place is partial and not folder.exists():
            partial.rename(folder)

    return frames()


def street_folder(data: Path, options: DemoOptions) -> Path:
    """Where the demo's street is kept in a data folder."""
    return data / "demo" / f"street-{options.seed}-{options.frames}"


class _Filling:
    """Renders the street in one thread, and uploads it in another.

    The main thread runs the server. Uploading begins when it is ready.
    """

    def __init__(self, options: DemoOptions, data: Path, token_file: Path) -> None:
        self._options = options
        self._is_new = not street_folder(data, options).exists()
        self._rendered: SimpleQueue[dict[str, object] | Exception | None] = (
            SimpleQueue()
        )
        self._is_sent = threading.Event()
        self.is_locked = threading.Event()
        """Set once the data folder is this server's alone."""
        self._screen = options.screen
        self._data = data
        self._token_file = token_file
        self._error: Exception | None = None
        self.refused = 0

    def render(self) -> None:
        """Start rendering, while the server starts."""
        # Its modules are imported by this thread, which then imports the server's.
        lines = rendered_frames(self._data, self._options, self.is_locked)
        # A daemon thread, as the other: an interruption does not wait for the frames.
        threading.Thread(target=self._render, args=(lines,), daemon=True).start()

    def start(self, url: str) -> None:
        """Start uploading; called when the server is ready."""
        threading.Thread(target=self._run, args=(url,), daemon=True).start()

    def raise_if_failed(self) -> None:
        """Raise the error of the thread, if there was one."""
        if self._error is not None:
            raise self._error

    def _render(self, lines: Iterator[dict[str, object]]) -> None:
        end = None
        try:
            for number, line in enumerate(lines, 1):
                self._rendered.put(line)
                if number == self._options.frames:
                    self._is_sent.wait()  # then the folder of the files is renamed
        except Exception as error:  # raised again by the thread that uploads
            end = error
        self._rendered.put(end)

    def _frames(self) -> Iterator[dict[str, object]]:
        for number in itertools.count(1):
            line = self._rendered.get()
            if isinstance(line, Exception):
                raise line
            if line is None:
                return
            yield line
            if number == self._options.frames:
                self._is_sent.set()

    def _run(self, url: str) -> None:
        try:
            from filter_core.verdicts import Reason
            from unghost.client.client import Client

            token = self._token_file.read_text(encoding="utf-8").strip()
            report = PushReport(Screen())
            with Client(url, token) as client:
                client.create_dataset(_DEMO_DATASET, exist_ok=True, coached=True)
                title = f"{'render and ' if self._is_new else ''}filter the street"
                with self._screen.progress(title, "frames") as bar:
                    for line in self._frames():
                        for outcome in client.push(_DEMO_DATASET, [_outgoing(line)]):
                            report.add(outcome)
                        bar(report.seen, self._options.frames)
                self._make_by_tags(client)
                numbers = client.stats(_DEMO_DATASET)
            self.refused = report.refused
            report.print_problems()
            self._screen.record({"dataset": _DEMO_DATASET, "stats": numbers.raw})
            verdicts = {reason.label: reason.verdict.value for reason in Reason}
            rows = (
                (count, verdicts.get(reason, ""), reason.replace("_", " "))
                for reason, count in most_first(numbers.by_reason)
            )
            self._screen.table(("boxes", "verdict", "reason"), rows)
        except Exception as error:  # raised again by the main thread
            self._error = error
        if self._error is not None or self._options.exit_when_ready:
            # As for Ctrl-C, on which the server shuts down in order.
            signal.raise_signal(signal.SIGINT)

    def _make_by_tags(self, client: Client) -> None:
        """Make the demo's second dataset, decided by tags, unless there is one.

        The folder of the street must be complete.
        """
        if _BY_TAGS_DATASET in {dataset.name for dataset in client.datasets()}:
            return
        folder = street_folder(self._data, self._options)
        frames = open_source(folder, "manifest", SourceOptions().description_of(folder))
        ensure_dataset(client, _BY_TAGS_DATASET, NewDataset(), self._screen)
        plain = (replace(frame, others={}) for frame in frames)
        sent = replace(frames, frames=lambda: plain)
        for _ in client.push(_BY_TAGS_DATASET, outgoing(sent)):
            pass
        # Not created with this profile: by default the order of boxes is measured, too,
        # so that the page can switch to it without reading images.
        version = client.add_config(_BY_TAGS_DATASET, {"profile": "paper"})
        client.wait(client.set_config(_BY_TAGS_DATASET, version.digest))


def _outgoing(line: dict[str, object]) -> OutgoingFrame:
    """A frame to be sent, from its line of the manifest, which has absolute paths."""
    from filter_core.formats.manifest import FRAME_FILES
    from unghost.client.outgoing import OutgoingFrame

    annotation = dict(line)
    key = str(annotation.pop("key"))
    paths = {kind: annotation.pop(kind, None) for kind in FRAME_FILES}
    files = {kind: Path(str(path)) for kind, path in paths.items() if path}
    return OutgoingFrame(key, annotation, files)
