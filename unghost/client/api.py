"""Every call of the REST API, grouped by resource.

Each method describes a call as data (`Call`); the client that inherits `Api` sends it
(see `call.endpoint`). Paths and queries are those of docs/api.md. Three requests are
not described here, because their responses are streamed: the events of a job and the
file of an export (`jobs`), and batches of frames (`batches`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar
from urllib.parse import quote

import httpx

from unghost import wire
from unghost.client.call import (
    API,
    MAX_FILE_BYTES,
    Call,
    Listing,
    answer,
    body_of,
    content,
    endpoint,
    fetched,
    listing,
    nothing,
    posted,
    read_object,
    result,
)
from unghost.client.outgoing import OutgoingFrame, checked_file_name
from unghost.client.tables import box_listing

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from unghost.client.keywords import (
        BoxFilters,
        CropOptions,
        DatasetChanges,
        DatasetOptions,
        ExportChoices,
        FrameFiles,
        FrameFilters,
        OverlayOptions,
    )
    from unghost.wire.model import Json
    from unghost.wire.words import (
        Answer,
        ExportFormat,
        HookEvent,
        JobState,
        QueueOrder,
        Role,
        ThresholdTarget,
        Truth,
    )

T = TypeVar("T")


def dataset_path(dataset: str, *rest: str) -> str:
    """The path of a dataset or of something in it."""
    return "/".join((f"{API}/datasets/{quote(dataset, safe='')}", *rest))


def frame_path(dataset: str, key: str) -> str:
    """The path of a frame by its key, whose slashes stay slashes."""
    return dataset_path(dataset, "frames", quote(key, safe="/"))


def class_path(dataset: str, name: str) -> str:
    """The path of a class of a dataset."""
    return dataset_path(dataset, "classes", quote(name, safe=""))


def run_path(run: wire.Run | int) -> str:
    """The path of a run, by itself or by its id."""
    return f"{API}/runs/{id_of(run)}"


def export_path(export: wire.Export | int) -> str:
    """The path of an export, by itself or by its id."""
    return f"{API}/exports/{id_of(export)}"


def id_of(job: wire.Run | wire.Export | int) -> int:
    """The id of a run or an export; an id is returned as it is."""
    return job if isinstance(job, int) else job.id


class Api:
    """The calls of all resources, as methods of the client that inherits them."""

    # Datasets, and counts over all boxes of one.

    @listing
    def datasets(self) -> Listing[wire.Dataset]:
        """Every dataset, by name."""
        return Listing(f"{API}/datasets", wire.Dataset)

    @endpoint
    def dataset(self, name: str) -> Call[wire.Dataset]:
        """One dataset."""
        return fetched(wire.Dataset, dataset_path(name))

    @endpoint
    def create_dataset(
        self, /, name: str, *, exist_ok: bool = False, **options: Unpack[DatasetOptions]
    ) -> Call[wire.Dataset]:
        """Make a dataset.

        `config` is a mapping of keys, `recording` what a recording.yaml says.

        With `exist_ok`, a dataset of this name is returned as it is, whatever its
        options are; without, `Conflict` is raised.
        """
        settings = {key: value for key, value in options.items() if value is not None}
        body = {"name": name, **settings}
        params = {"exist_ok": exist_ok or None}
        read = result(wire.Dataset)
        return Call("POST", f"{API}/datasets", read, json=body, params=params)

    @endpoint
    def change_dataset(
        self, /, name: str, **options: Unpack[DatasetChanges]
    ) -> Call[wire.Dataset | wire.Run]:
        """Change options, as in `create_dataset`.

        If the change affects how segmentations are read, the result is the run that
        measures again, and the dataset changes when that run is done.
        """
        path = dataset_path(name)
        return Call("PATCH", path, _changed_dataset, json=options, repeatable=False)

    @endpoint
    def rename_class(self, dataset: str, name: str, new: str) -> Call[wire.Run]:
        """Rename a class; the run that is returned makes the change when it is done."""
        return _changed_class(dataset, name, {"name": new})

    @endpoint
    def merge_class(self, dataset: str, name: str, into: str) -> Call[wire.Run]:
        """Move a class's boxes to another class, by the run that is returned.

        Frames that are sent later with the former name get the other class, too.
        """
        return _changed_class(dataset, name, {"merge_into": into})

    @endpoint
    def remove_class(self, dataset: str, name: str) -> Call[None]:
        """Remove a class that has no boxes; `Conflict` if it has any."""
        return Call("DELETE", class_path(dataset, name), nothing)

    @endpoint
    def delete_dataset(self, name: str) -> Call[None]:
        """Delete a dataset with everything in it, reviews included."""
        return Call("DELETE", dataset_path(name), nothing, params={"confirm": name})

    @endpoint
    def stats(self, dataset: str) -> Call[wire.Stats]:
        """Counts of boxes by verdict, reason, class and answer."""
        return fetched(wire.Stats, dataset_path(dataset, "stats"))

    @endpoint
    def report(self, dataset: str) -> Call[wire.Report]:
        """Where the ghosts are: by distance, map and weather, and the worst frames."""
        return fetched(wire.Report, dataset_path(dataset, "report"))

    @endpoint
    def coached(self, dataset: str) -> Call[wire.Coached]:
        """The boxes by which the caller learns to answer; their truth is known."""
        return fetched(wire.Coached, dataset_path(dataset, "coached"))

    @endpoint
    def histogram(self, dataset: str, *, bins: int = 50) -> Call[wire.Histogram]:
        """Boxes per bin of match percent, for each class."""
        return fetched(wire.Histogram, dataset_path(dataset, "histogram"), bins=bins)

    @endpoint
    def preview(
        self, dataset: str, config: Mapping[str, object], *, limit: int = 100
    ) -> Call[wire.Preview]:
        """What a configuration would decide, and up to `limit` boxes that change."""
        body = {"config": config, "limit": limit}
        return posted(wire.Preview, dataset_path(dataset, "preview"), body)

    @listing
    def problems(self, dataset: str) -> Listing[wire.RefusedFrame]:
        """The frames that were sent and refused, with their errors."""
        return Listing(dataset_path(dataset, "problems"), wire.RefusedFrame)

    # Frames: stored one by one, listed, fetched, deleted.

    @endpoint
    def put_frame(
        self,
        /,
        dataset: str,
        key: str,
        annotation: Mapping[str, object] | None = None,
        *,
        replace: bool = False,
        **files: Unpack[FrameFiles],
    ) -> Call[wire.StoredFrame]:
        """Store a frame with its boxes and files, and decide about every box.

        A file is bytes, the path of one, an array of numpy or an image of PIL (see
        `OutgoingFrame`). Sending the same frame again changes nothing
        (`created` is False). Other content under the same key raises `Conflict`,
        unless `replace` is set.
        """
        contents: dict[str, Any] = {
            name: content for name, content in files.items() if content is not None
        }
        boxes = {"boxes": []} if annotation is None else annotation
        frame = OutgoingFrame(key, boxes, contents)
        return frame_stored(dataset_path(dataset), frame, replace=replace)

    @listing
    def frames(
        self, /, dataset: str, **filters: Unpack[FrameFilters]
    ) -> Listing[wire.FrameSummary]:
        """The frames of a dataset, without their boxes; filters as in the API.

        All of them: `limit` is how many one request fetches.
        """
        path = dataset_path(dataset, "frames")
        return Listing(path, wire.FrameSummary, _as_in_api(filters))

    @endpoint
    def frame(self, frame_id: int) -> Call[wire.Frame]:
        """One frame with its boxes."""
        return fetched(wire.Frame, f"{API}/frames/{frame_id}")

    @endpoint
    def frame_by_key(self, dataset: str, key: str) -> Call[wire.Frame]:
        """One frame with its boxes, by the key it was stored under."""
        return fetched(wire.Frame, frame_path(dataset, key))

    @endpoint
    def delete_frame(self, dataset: str, key: str) -> Call[None]:
        """Delete a frame with its boxes."""
        return Call("DELETE", frame_path(dataset, key), nothing)

    @endpoint
    def frame_file(self, frame_id: int, name: str) -> Call[bytes]:
        """A file of a frame as it was stored: "image", "segmentation", ..."""
        path = f"{API}/frames/{frame_id}/{checked_file_name(name)}"
        return Call("GET", path, content, max_bytes=MAX_FILE_BYTES)

    # Pictures that the server draws, as encoded images.

    @endpoint
    def thumbnail(self, frame_id: int) -> Call[bytes]:
        """A frame's image, small, as WebP."""
        return Call("GET", f"{API}/frames/{frame_id}/thumbnail", content)

    @endpoint
    def overlay(
        self, /, frame_id: int, **options: Unpack[OverlayOptions]
    ) -> Call[bytes]:
        """A frame with its boxes drawn; options `boxes`, `layer` and `edges`."""
        path = f"{API}/frames/{frame_id}/overlay"
        return Call("GET", path, content, params=options)

    @endpoint
    def crop(self, /, box_id: int, **options: Unpack[CropOptions]) -> Call[bytes]:
        """The part of the image around a box: `pad`, `least`, `layer`, `height`."""
        return Call("GET", f"{API}/boxes/{box_id}/crop", content, params=options)

    # Boxes, their history, the review queue, and people's answers.

    @box_listing
    def boxes(
        self, /, dataset: str, **filters: Unpack[BoxFilters]
    ) -> Listing[wire.Decision]:
        """The boxes of a dataset; filters and `sort` as in the API.

        `class_name` is for `class`. Several classes or reasons may be given as a list.
        All matching boxes are listed, once: `limit` is how many one request fetches.

        `to_pandas()`, `to_polars()` and `to_arrow()` of the result read them as a table
        instead, in the order of frames; they refuse a `sort`.
        """
        params = {"dataset": dataset, **_as_in_api(filters)}
        return Listing(f"{API}/boxes", wire.Decision, params)

    @endpoint
    def count_boxes(self, /, dataset: str, **filters: Unpack[BoxFilters]) -> Call[int]:
        """How many boxes `boxes` would list."""
        return _counted(dataset, filters, lambda body: int(body["total"]))

    @endpoint
    def select_boxes(
        self, /, dataset: str, **filters: Unpack[BoxFilters]
    ) -> Call[wire.Selection]:
        """All boxes that match a filter, as they are now, for `bulk_review`."""
        # As a filter in JSON, which has no order and separates several values likewise.
        conditions = {
            name: ",".join(value) if isinstance(value, list | tuple) else value
            for name, value in _as_in_api(filters).items()
            if name not in ("sort", "limit")
        }

        def read(body: Json) -> wire.Selection:
            return wire.Selection(
                dataset=dataset,
                filter=conditions,
                count=int(body["total"]),
                snapshot=str(body["snapshot"]),
            )

        return _counted(dataset, filters, read)

    @endpoint
    def box(self, box_id: int) -> Call[wire.Box]:
        """One box with its decision and its neighbours."""
        return fetched(wire.Box, f"{API}/boxes/{box_id}")

    @endpoint
    def alike(self, box_id: int) -> Call[wire.Alike]:
        """Boxes without an answer of the same class, reason, cause, hider and band."""
        return fetched(wire.Alike, f"{API}/boxes/{box_id}/alike")

    @endpoint
    def track(self, box_id: int) -> Call[wire.Track]:
        """The same object in the frames of its recording before and after."""
        return fetched(wire.Track, f"{API}/boxes/{box_id}/track")

    @endpoint
    def depth_slice(self, box_id: int) -> Call[wire.DepthSlice]:
        """Where a box and the pixels in it are on the axis of depth."""
        return fetched(wire.DepthSlice, f"{API}/boxes/{box_id}/slice")

    @listing
    def history(self, box_id: int) -> Listing[wire.HistoryEntry]:
        """Every decision and review of a box, newest first."""
        path = f"{API}/boxes/{box_id}/history"
        return Listing(path, wire.HistoryEntry, {"limit": None})

    @endpoint
    def queue(
        self,
        dataset: str,
        *,
        order: QueueOrder = "doubt",
        limit: int = 10,
        filters: Mapping[str, object] | None = None,
        exclude: Sequence[int] = (),
    ) -> Call[wire.Queue]:
        """The next boxes to review, reserved (claimed) for this token for five minutes.

        `filters` are those of `boxes`, with the names of the API; `exclude` lists ids
        of boxes that the caller already has.
        """
        body = {
            "order": order,
            "limit": limit,
            "filters": filters or {},
            "exclude": list(exclude),
        }
        return posted(wire.Queue, dataset_path(dataset, "queue"), body)

    @endpoint
    def review(
        self, box_id: int, verdict: Answer, *, seen_revision: int, comment: str = ""
    ) -> Call[wire.Review]:
        """Answer on one box; `StaleReview` if someone answered since.

        `seen_revision` is the `revision` of the decision that was seen.
        """
        body = {"verdict": verdict, "seen_revision": seen_revision, "comment": comment}
        return posted(wire.Review, f"{API}/boxes/{box_id}/reviews", body)

    @endpoint
    def undo_review(self, box_id: int, revision: int) -> Call[wire.Review]:
        """Undo the answer that gave a box this revision; the box gets the one before.

        `Conflict` if somebody has answered since, or the answer was undone already.
        """
        return posted(wire.Review, f"{API}/boxes/{box_id}/reviews/{revision}/undo")

    @endpoint
    def bulk_review(
        self,
        dataset: str,
        verdict: Answer,
        boxes: Sequence[wire.Decision] | Sequence[int] | wire.Selection,
        *,
        comment: str = "",
    ) -> Call[wire.ReviewBatch]:
        """Give one answer on many boxes; `undo` undoes it on all of them.

        `boxes` are decisions (those that somebody has answered since they were read are
        not changed), ids (those that have an answer are not changed), or a selection:
        all of its boxes are answered, or none if any has changed since `select_boxes`.

        In the result, `stale` lists boxes that were not changed because they have an
        answer that the caller has not seen, `skipped` boxes that no longer exist.
        Raises StaleReview if boxes of the selection have been added, deleted, decided
        again or answered since; `total` in `current` is their present number.
        """
        body = {"dataset": dataset, "verdict": verdict, "comment": comment}
        bulk = {**body, **_which(boxes)}
        return posted(wire.ReviewBatch, f"{API}/reviews/bulk", bulk)

    @endpoint
    def import_answers(
        self, dataset: str, answers: Sequence[Mapping[str, object]]
    ) -> Call[wire.ImportedAnswers]:
        """Store answers that were given elsewhere, at most 200; needs the role admin.

        Each has `frame` (its key), `box`, `verdict`, `reviewer`, `created_at` (RFC
        3339) and perhaps `comment`. The result says how many were stored, were there
        already, or were not stored because the box has a newer answer or does not
        exist.
        """
        body = {"answers": [dict(entry) for entry in answers]}
        return posted(
            wire.ImportedAnswers, dataset_path(dataset, "reviews/import"), body
        )

    @endpoint
    def undo(self, batch_id: int) -> Call[wire.UndoneBatch]:
        """Undo a batch of reviews, except where someone answered since."""
        return posted(wire.UndoneBatch, f"{API}/review-batches/{batch_id}/undo")

    # Filter configurations: immutable versions, and which one is active.

    @listing
    def configs(self, dataset: str) -> Listing[wire.ConfigVersion]:
        """Every version of a dataset's configuration, newest first."""
        return Listing(dataset_path(dataset, "configs"), wire.ConfigVersion)

    @endpoint
    def add_config(
        self, dataset: str, config: Mapping[str, object] | str
    ) -> Call[wire.ConfigVersion]:
        """Store a version: a mapping, or the text of a YAML file as it is."""
        path = dataset_path(dataset, "configs")
        read = result(wire.ConfigVersion)
        if isinstance(config, str):
            yaml = {"Content-Type": "application/yaml"}
            return Call("POST", path, read, content=config.encode(), headers=yaml)
        return Call("POST", path, read, json=config)

    @endpoint
    def config(self, digest: str) -> Call[wire.ConfigVersion]:
        """One version by its digest."""
        return fetched(wire.ConfigVersion, f"{API}/configs/{quote(digest, safe='')}")

    @endpoint
    def active_config(self, dataset: str) -> Call[wire.ConfigVersion]:
        """The version in force."""
        return fetched(wire.ConfigVersion, dataset_path(dataset, "config"))

    @endpoint
    def set_config(
        self,
        dataset: str,
        config: str | Mapping[str, object] | PathLike[str],
        *,
        instead_of: str | None = None,
    ) -> Call[wire.Run]:
        """Activate a configuration; the run that applies it is returned at once.

        `config` is a mapping of keys, the path of a YAML file (a text that ends in
        ``.yaml`` or ``.yml``, too), or the digest of a stored version. Keys that are
        not named have their defaults.

        With `instead_of`, the digest of the version that you have seen as the active
        one, `StaleReview` is raised if another is or becomes active.
        """
        path = dataset_path(dataset, "config")
        headers = {} if instead_of is None else {"If-Match": f'"{instead_of}"'}
        is_digest = isinstance(config, str) and not config.endswith((".yaml", ".yml"))
        if is_digest:
            body: dict[str, object] = {"digest": config}
        elif isinstance(config, Mapping):
            body = {"config": config}
        else:
            yaml = {**headers, "Content-Type": "application/yaml"}
            text = Path(config).read_bytes()
            return Call("PUT", path, result(wire.Run), content=text, headers=yaml)
        return Call("PUT", path, result(wire.Run), json=body, headers=headers)

    # Runs: one configuration applied to a whole dataset.

    @listing
    def runs(
        self, dataset: str | None = None, *, state: JobState | None = None
    ) -> Listing[wire.Run]:
        """The runs of a dataset or of all, newest first."""
        path = f"{API}/runs" if dataset is None else dataset_path(dataset, "runs")
        return Listing(path, wire.Run, {"state": state})

    @endpoint
    def start_run(
        self,
        dataset: str,
        config: Mapping[str, object] | str,
        *,
        activate: bool = False,
        measure_again: bool = False,
    ) -> Call[wire.Run]:
        """Apply a config (a mapping, or the digest of a stored one).

        `measure_again`: read the images again if an earlier version of Unghost has
        measured the numbers, also where those would do.
        """
        path = dataset_path(dataset, "runs")
        body: dict[str, object] = {"config": config, "activate": activate}
        if measure_again:  # which older servers do not know
            body["measure_again"] = True
        return Call("POST", path, result(wire.Run), json=body)

    @endpoint
    def run(self, run_id: int) -> Call[wire.Run]:
        """One run as it is now."""
        return fetched(wire.Run, run_path(run_id))

    @endpoint
    def cancel(self, run: wire.Run | int) -> Call[wire.Run]:
        """Cancel a run, so that nothing changes; `Conflict` if it has ended."""
        return posted(wire.Run, f"{run_path(run)}/cancel")

    @endpoint
    def diff(
        self, run: wire.Run | int, against: wire.Run | int | None = None
    ) -> Call[wire.Diff]:
        """Counts of the boxes that a run decides otherwise than another run.

        The default of the other run is the one that was active before it.
        """
        return fetched(wire.Diff, f"{run_path(run)}/diff", **_against(against), limit=1)

    @listing
    def flips(
        self, run: wire.Run | int, against: wire.Run | int | None = None
    ) -> Listing[wire.Flip]:
        """The boxes that `diff` counts, nearest to a threshold first."""
        return Listing(f"{run_path(run)}/diff", wire.Flip, _against(against))

    # Exports: made by the server, then downloaded.

    @listing
    def exports(self, dataset: str) -> Listing[wire.Export]:
        """The exports of a dataset, newest first."""
        return Listing(dataset_path(dataset, "exports"), wire.Export)

    @listing
    def versions(self, dataset: str) -> Listing[wire.Export]:
        """The versions of a dataset, that is, exports with a name, newest first."""
        return Listing(dataset_path(dataset, "versions"), wire.Export)

    @endpoint
    def start_export(
        self,
        /,
        dataset: str,
        format: ExportFormat,
        *,
        name: str | None = None,
        since: str | None = None,
        **options: Unpack[ExportChoices],
    ) -> Call[wire.Export]:
        """Start writing the labels to a ZIP archive.

        docs/formats.md lists the formats and their options. With a `name` it is a
        version, whose file is kept. With `since`, the name of a version, only frames
        that are new or have changed are written.
        """
        path = dataset_path(dataset, "exports")
        body: dict[str, object] = {"format": format, "options": options}
        named = {"name": name, "since": since}
        body |= {key: value for key, value in named.items() if value is not None}
        return Call("POST", path, result(wire.Export), json=body)

    @endpoint
    def parts(self, dataset: str, split: Sequence[float] = ()) -> Call[wire.Parts]:
        """The parts that an export with these shares of train, val and test would have.

        Without shares, those that the frames have.
        """
        return fetched(wire.Parts, dataset_path(dataset, "parts"), split=split)

    @endpoint
    def cancel_export(self, export: wire.Export | int) -> Call[wire.Export]:
        """Cancel an export; `Conflict` if it has ended."""
        return posted(wire.Export, f"{export_path(export)}/cancel")

    @endpoint
    def delete_export(self, export: wire.Export | int) -> Call[None]:
        """Delete an export with its file; `Conflict` if it has not ended."""
        return Call("DELETE", export_path(export), nothing)

    @endpoint
    def export(self, export_id: int) -> Call[wire.Export]:
        """One export as it is now."""
        return fetched(wire.Export, export_path(export_id))

    # Sessions, tokens, login codes, and the log of who did what.

    @endpoint
    def session(self) -> Call[wire.Session]:
        """The name and the role of this client's token."""
        return fetched(wire.Session, f"{API}/session")

    @listing
    def tokens(self) -> Listing[wire.Token]:
        """Every token, oldest first, revoked ones included. For admins."""
        return Listing(f"{API}/tokens", wire.Token)

    @endpoint
    def create_token(
        self,
        name: str,
        role: Role = "reviewer",
        *,
        expires_at: datetime | None = None,
        expires_in_days: int | None = None,
    ) -> Call[wire.NewToken]:
        """Create a token; its secret is in this response and nowhere else. For admins.

        It lasts until it is revoked, unless a time or a number of days is given. If the
        response is lost, this is not retried: the token may exist, but without its
        secret.
        """
        body: dict[str, object] = {"name": name, "role": role}
        if expires_at is not None:
            body["expires_at"] = expires_at.isoformat()
        else:
            body["expires_in_days"] = expires_in_days
        return posted(wire.NewToken, f"{API}/tokens", body, repeatable=False)

    @endpoint
    def revoke_token(self, token_id: int) -> Call[None]:
        """Revoke a token, with the sessions that it opened. For admins."""
        return Call("DELETE", f"{API}/tokens/{token_id}", nothing)

    @endpoint
    def create_login_code(self) -> Call[wire.NewLoginCode]:
        """Create a code that signs a browser in as you, once, within ten minutes.

        The link to open is the address of the server, `/#code=`, and the code.
        """
        return posted(wire.NewLoginCode, f"{API}/login-codes", {}, repeatable=False)

    @endpoint
    def login_code(self, code_id: int) -> Call[wire.LoginCode]:
        """Whether a login code of yours was used."""
        return fetched(wire.LoginCode, f"{API}/login-codes/{code_id}")

    @listing
    def audit(self) -> Listing[wire.AuditEntry]:
        """The entries of the audit log, newest first; for admins."""
        return Listing(f"{API}/audit", wire.AuditEntry)

    # Hooks: addresses that are told when work has ended.

    @listing
    def hooks(self) -> Listing[wire.Hook]:
        """Every hook, newest first; for admins."""
        return Listing(f"{API}/hooks", wire.Hook)

    @endpoint
    def create_hook(
        self,
        url: str,
        events: Sequence[HookEvent] = ("run.ended", "export.ended", "dataset.reviewed"),
        *,
        dataset: str | None = None,
    ) -> Call[wire.NewHook]:
        """Let the server send events to an address, of one dataset or of all.

        The secret that signs them is in this response and nowhere else, so that this is
        not retried. For admins; the server's setting `UNGHOST_HOOK_HOSTS` lists the
        hosts that are allowed.
        """
        body = {"url": url, "events": list(events), "dataset": dataset}
        return posted(wire.NewHook, f"{API}/hooks", body, repeatable=False)

    @endpoint
    def delete_hook(self, hook_id: int) -> Call[None]:
        """Delete a hook with the log of its deliveries. For admins."""
        return Call("DELETE", f"{API}/hooks/{hook_id}", nothing)

    @listing
    def hook_deliveries(self, hook_id: int) -> Listing[wire.Delivery]:
        """What was and will be sent to a hook, newest first. For admins."""
        return Listing(f"{API}/hooks/{hook_id}/deliveries", wire.Delivery)

    @endpoint
    def ping_hook(self, hook_id: int) -> Call[wire.Delivery]:
        """Send an event `ping` to a hook; `hook_deliveries` has the outcome."""
        return posted(wire.Delivery, f"{API}/hooks/{hook_id}/ping", {})

    # Quality: the accuracy of the filter and of each channel.

    @endpoint
    def quality(
        self,
        dataset: str,
        *,
        target: ThresholdTarget = "f1",
        recall: float | None = None,
        truth: Truth = "people",
    ) -> Call[wire.Quality]:
        """The accuracy of the filter, and suggested thresholds.

        The filter is compared with people's answers, or with `truth="instances"` with
        instance images (`evaluate` measures them). The suggested thresholds have the
        best F1 or, with `target="recall"`, are the highest that reach `recall`.
        """
        path = dataset_path(dataset, "quality")
        return fetched(wire.Quality, path, target=target, truth=truth, recall=recall)

    @endpoint
    def evaluate(self, dataset: str) -> Call[wire.Run]:
        """Measure every channel for which frames have the files; no verdict changes.

        Returns a run; when it is done, `evaluations` has all channels.
        """
        return posted(wire.Run, dataset_path(dataset, "evaluations"))

    @endpoint
    def evaluations(
        self, dataset: str, *, truth: Truth = "instances"
    ) -> Call[wire.Evaluation]:
        """Precision, recall and F1 of every channel that was measured so far."""
        path = dataset_path(dataset, "evaluations")
        return fetched(wire.Evaluation, path, truth=truth)

    @endpoint
    def set_experiment(
        self, dataset: str, report: Mapping[str, object]
    ) -> Call[wire.Experiment]:
        """Keep a report of `unghost worth-it` with a dataset, in place of the last."""
        path = dataset_path(dataset, "experiment")
        return Call("PUT", path, result(wire.Experiment), json=report)

    @endpoint
    def experiment(self, dataset: str) -> Call[wire.Experiment]:
        """The report that is kept with a dataset; `NotFound` if there is none."""
        return fetched(wire.Experiment, dataset_path(dataset, "experiment"))

    # The server itself.

    @endpoint
    def version(self) -> Call[wire.Version]:
        """The program's version."""
        return fetched(wire.Version, "/version")


def _changed_dataset(response: httpx.Response) -> wire.Dataset | wire.Run:
    if response.status_code == httpx.codes.ACCEPTED:
        return result(wire.Run)(response)
    return result(wire.Dataset)(response)


def _changed_class(dataset: str, name: str, change: Json) -> Call[wire.Run]:
    path = class_path(dataset, name)
    return Call("PATCH", path, result(wire.Run), json=change, repeatable=False)


def frame_stored(
    dataset: str, frame: OutgoingFrame, *, replace: bool
) -> Call[wire.StoredFrame]:
    """Store one frame in the dataset with this path; OSError if a file is missing."""
    return Call(
        "PUT",
        f"{dataset}/frames/{quote(frame.key, safe='/')}",
        _stored_frame,
        params={"replace": replace or None},
        files=frame.form(),
    )


def _stored_frame(response: httpx.Response) -> wire.StoredFrame:
    created = response.status_code == httpx.codes.CREATED
    read = partial(wire.StoredFrame.answered, created=created)
    return read_object(read, body_of(response), response)


def known_frames(dataset: str, keys: Sequence[str]) -> Call[dict[str, wire.KnownFrame]]:
    """The stored frames with these keys (at most 1,000), by key."""
    read = answer(
        lambda body: {frame.key: frame for frame in wire.KnownFrames.read(body).items}
    )
    return Call("POST", f"{dataset}/known-frames", read, json={"keys": keys})


def _counted(
    dataset: str, filters: Mapping[str, object], read: Callable[[Json], T]
) -> Call[T]:
    """The number of boxes of a filter, without the boxes."""
    params = {"dataset": dataset, **_as_in_api(filters), "count": True, "limit": 1}
    return Call("GET", f"{API}/boxes", answer(read), params=params)


def _as_in_api(filters: Mapping[str, object]) -> dict[str, object]:
    # `class` is a keyword of Python: the filter is `class_name` here.
    return {
        "class" if name == "class_name" else name: value
        for name, value in filters.items()
    }


def _which(
    boxes: Sequence[wire.Decision] | Sequence[int] | wire.Selection,
) -> dict[str, object]:
    """The keys of a bulk review's body that select the boxes and their seen state."""
    if isinstance(boxes, wire.Selection):
        return {"filter": boxes.filter, "snapshot": boxes.snapshot}
    if isinstance(boxes, Mapping):
        raise TypeError(
            "expected decisions, ids or a result of select_boxes, found a mapping"
        )
    seen = [box for box in boxes if isinstance(box, wire.Decision)]
    if not seen:
        return {"box_ids": list(boxes)}
    if len(seen) != len(boxes):
        raise TypeError("expected decisions or ids, found both")
    return {
        "box_ids": [box.box_id for box in seen],
        "seen_revisions": [box.revision for box in seen],
    }


def _against(run: wire.Run | int | None) -> dict[str, int]:
    return {} if run is None else {"against": id_of(run)}


READINESS: Final = Call("GET", "/readyz", nothing, retried=False)
"""Whether the server can take work now: Unavailable if not; asked once."""
