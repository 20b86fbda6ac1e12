"""What the fields and parameters of the API mean, each with an example.

Fields that have the same name mean the same, so each is described once; `Model.field`
is for one that means something else there. A model describes a field itself, by
``Field(description=...)``, where the text is about that model alone. The OpenAPI
document takes the description and the example from here for what has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple, TypeAlias


class Described(NamedTuple):
    """The meaning of a field, and a value that it may have (None: no example)."""

    text: str
    example: object = None


_TIME: Final = "2026-01-31T12:00:00Z"
_DIGEST: Final = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

_Said: TypeAlias = "str | tuple[str, object]"
"""A meaning, perhaps with an example."""


def _described(said: Mapping[str, _Said]) -> dict[str, Described]:
    return {
        name: Described(entry) if isinstance(entry, str) else Described(*entry)
        for name, entry in said.items()
    }


FIELDS: Final = _described(
    {
        # Who, when, what.
        "id": ("Its number on the server.", 7),
        "name": ("Its name.", "town10"),
        "created_at": ("When it was created (RFC 3339, UTC).", _TIME),
        "created_by": ("Name of the token that asked for it.", "ann"),
        "started_at": ("When its work began; null while it waits.", _TIME),
        "finished_at": ("When it ended; null until then.", _TIME),
        "expires_at": ("When it ends; null for never.", _TIME),
        "revoked_at": "When it was revoked; null if it was not.",
        "used_at": "When it was used; null if it was not.",
        "last_used_at": ("When it was used last; null for never.", _TIME),
        "at": ("When it happened (RFC 3339, UTC).", _TIME),
        "dataset": ("Name of the dataset.", "town10"),
        "description": ("Text for people about the dataset.", "Town10, rain"),
        "items": "The items of this page.",
        "next_cursor": "Send it as `cursor` for the next page; null on the last.",
        "cursor": "`next_cursor` of the page before; none for the first page.",
        "limit": ("Maximum number of items.", 100),
        "sort": "The order of the list; `-` reverses it.",
        "role": (
            "What it may do; each role may do what the one before may.",
            "reviewer",
        ),
        "status": ("The status of HTTP.", 201),
        "detail": "What is wrong, as a sentence for people.",
        "errors": "The single errors, at most a hundred.",
        "more_errors": ("How many errors there are besides those listed.", 12),
        "notes": "Sentences that people should read.",
        # Boxes.
        "box_id": ("Number of the box on the server.", 1201),
        "frame": ("Key of the frame.", "town/000007"),
        "frame_id": ("Number of the frame on the server.", 42),
        "key": ("Key of the frame in its dataset; it may contain `/`.", "town/000007"),
        "class": ("Name of the class.", "car"),
        "class_name": ("Name of the class.", "car"),
        "verdict": ("The verdict of the filter.", "kept"),
        "effective_verdict": (
            "A person's keep or reject if there is one, else the filter's verdict.",
            "kept",
        ),
        "effective": ("The effective verdict: a person's, else the filter's.", "kept"),
        "reason": ("The rule that gave the verdict.", "below_threshold"),
        "explanation": (
            "The verdict and its reason as a sentence.",
            "rejected: 3.1 % of 840 pixels match car; 8 % are needed",
        ),
        "evidence": (
            "The kind of evidence that decided; null where nothing was measured.",
            "semantic",
        ),
        "match_percent": ("Share of the box's pixels that match, in percent.", 43.5),
        "threshold": ("Share that it needs, in percent; null where none applied.", 8.0),
        "margin": ("`match_percent` less `threshold`.", 35.5),
        "toss_up": (
            "Whether it has too few pixels to be certain on which side of the "
            "threshold it is.",
            False,
        ),
        "large": ("Whether it counts as a large box.", False),
        "matched_pixels": ("Pixels of the box that match.", 365),
        "box_pixels": ("Pixels of the box.", 840),
        "unknown_pixels": (
            "Pixels of the box whose tag or colour is not known; null without a "
            "segmentation.",
            0,
        ),
        "area_percent": ("Share of the image that the box covers, in percent.", 0.1),
        "crowding": (
            "The largest share of the box, in percent, that one other box of a fitting "
            "class covers.",
            12.5,
        ),
        "explained_by": (
            "Id of the nearer box that takes most of its pixels; null if none does."
        ),
        "hidden_by": (
            "Up to three of the most frequent tags that its class does not accept."
        ),
        "accepted_tags": "The tags whose pixels count for its class.",
        "lossy": ("Whether the colours of the segmentation were not exact.", False),
        "distance": ("Metres from the camera; null if not known.", 12.5),
        "distance_range": (
            "Between how many metres it is; null if not known.",
            [50, 80],
        ),
        "xyxy": (
            "Left, top, right, bottom in pixels: the rectangle that was measured; null "
            "if it is outside of the image.",
            [83, 410, 466, 640],
        ),
        "amodal_xyxy": (
            "Of a 3D box: the rectangle of the whole, which may leave the image."
        ),
        "visible_xyxy": "Of a 3D box: the part of it inside the image.",
        "tight_xyxy": "The rectangle around its own pixels, by instance or depth.",
        "visible_pixels": ("Its own pixels, by instance or depth.", 300),
        "occluded": (
            "KITTI's level: 0 visible, 1 partly, 2 largely hidden, 3 unknown.",
            0,
        ),
        "truncated": ("Share of a 3D box outside of the image, 0 to 1.", 0.0),
        "edges": "Of a 3D box: its projected edges, each by its two ends.",
        "config": ("Digest of the configuration.", _DIGEST),
        "run": ("Number of the run.", 3),
        "revision": ("Number of the revision, from 1.", 1),
        "review": ("The answers that boxes have.", "undecided"),
        "tag": ("Number of the tag in CARLA.", 10),
        "rgb": ("Its colour in the palette: red, green, blue, 0 to 255.", [0, 0, 142]),
        "percent": ("In percent.", 71.4),
        # Filters.
        "match_max": ("Only boxes with at most this `match_percent`.", 20),
        "margin_max": ("Only boxes at most so far from their threshold.", 2),
        "distance_min": (
            "Only boxes at least so many metres away; all of their `distance_range`.",
            0,
        ),
        "distance_max": (
            "Only boxes at most so many metres away; all of their `distance_range`.",
            50,
        ),
        # Answers of people.
        "comment": ("A comment of the person.", "behind a tree"),
        "reviewer": ("Name of the person who answered.", "ann"),
        "answers": "Answers.",
        "box_ids": ("Numbers of the boxes, instead of `filter`.", [1201, 1202]),
        "filter": "All boxes that match, instead of `box_ids`.",
        "batch": "Number of the bulk answer that it was given in.",
        "undoes": "Revision of the answer that it undoes.",
        "undone": ("How many boxes have their former answer again.", 12),
        "skipped": "Boxes that were left as they are.",
        "imported": ("Answers that were stored.", 12),
        "carried_from": "The box of an earlier revision that it was given on.",
        "imported_by": "Who imported it.",
        "activated": ("Whether the run changed the verdict.", True),
        "looked_ms": ("Milliseconds that the box was on the screen.", 1400),
        "chosen_by": ("Order of the queue that chose the box.", "random"),
        "chosen_from": "Filters of the queue that chose the box.",
        "kind": "Of which kind it is.",
        "order": ("The order of the queue.", "doubt"),
        "claim": "Until when it is reserved for the caller.",
        "claimed_by_others": ("Boxes that are reserved for others.", 0),
        # Counts.
        "boxes": ("Number of boxes.", 840),
        "frames": ("Number of frames.", 200),
        "counts": "How many there are of each.",
        "kept": ("Boxes that the filter keeps.", 700),
        "rejected": ("Boxes that the filter rejects.", 120),
        "unmeasured": ("Boxes without a verdict.", 20),
        "reviewed": ("Boxes with keep or reject of a person.", 55),
        "to_review": ("Boxes that should be looked at.", 31),
        "unsure": ("Boxes that a person was unsure about.", 2),
        "problems": ("Frames that were refused and not stored since.", 0),
        "conflicts": ("Boxes where a person contradicts the filter.", 4),
        "toss_ups": ("Boxes too small to be certain.", 9),
        "by_reason": "Boxes by the rule that decided them.",
        "by_class": "The same for each class.",
        "reasons_by_class": "Boxes by rule, for each class.",
        "by_distance": "The same for each band of distance.",
        "total": ("Number of frames altogether.", 200),
        "done": ("Number of frames that are done.", 120),
        "stored": ("Frames that were stored.", 198),
        "refused": ("Frames that were refused.", 2),
        "unmatched": ("Files that belong to no frame.", 0),
        # Datasets and frames.
        "classes": ("Names of the classes in their order.", ["car", "van"]),
        "classes_frozen": ("Whether no class can be added or changed.", False),
        "palette": ("The table of tags of the segmentations.", "auto"),
        "encoding": ("How tags are written in the segmentations.", "auto"),
        "channel_order": ("Order of the segmentations' colour channels.", "auto"),
        "lossy_segmentation": (
            "What happens to a segmentation whose colours are not exact.",
            "refuse",
        ),
        "ignore_mask": "Pixels that are never counted.",
        "has_ignore_mask": ("Whether there is a mask of ignored pixels.", False),
        "active_run": ("Number of the run that decided the current verdicts.", 3),
        "thumbnail_frame_id": ("A frame whose picture stands for all.", 42),
        "width": ("Width of the image in pixels.", 1280),
        "height": ("Height of the image in pixels.", 720),
        "map": ("CARLA's map.", "Town10HD"),
        "camera": "The camera, as it was sent.",
        "carla_version": ("The version of CARLA, as it was sent.", "0.9.15"),
        "weather": "The weather, as it was sent.",
        "files": "The stored files by kind.",
        "has_image": ("Whether there is an image.", True),
        "has_segmentation": ("Whether there is a segmentation.", True),
        "segmentation": "What was recognised in the segmentation.",
        "previous_id": ("The frame before, by key; null for the first.", 41),
        "next_id": ("The frame after, by key; null for the last.", 43),
        "keys": ("Keys of frames.", ["town/000007"]),
        "unknown_percent": ("Share of pixels whose tag is not known, in percent.", 0.0),
        "url": ("Path of the address.", "/api/v1/frames/42/image"),
        "sha256": ("SHA-256 of the content, in hexadecimal.", _DIGEST),
        "media_type": ("Media type of the content.", "image/png"),
        "size_bytes": ("Size in bytes.", 81234),
        "decisions": "The decisions on the boxes.",
        "error": "Why it failed; null unless it did.",
        "problem": "Why the frame was refused.",
        "depth": "How depth images are written.",
        "annotation": "The frame's annotation.",
        "layer": ("What the picture shows.", "image"),
        # Configurations, runs, exports.
        "digest": ("Digest of the configuration.", _DIGEST),
        "unused_keys": ("Keys that have no effect.", []),
        "active": ("Whether it decides the current verdicts.", True),
        "state": ("Its state; `done`, `failed` and `cancelled` are final.", "done"),
        "activate": ("Whether it becomes the active run when it is done.", True),
        "scope": ("What is decided: the whole dataset.", "dataset"),
        "needs_pixels": ("Whether images have to be measured again.", False),
        "flips": "Which verdicts change.",
        "before": "The state before.",
        "after": "The state after.",
        "kept_to_rejected": ("Boxes that change from kept to rejected.", 5),
        "rejected_to_kept": ("Boxes that change from rejected to kept.", 1),
        "against": ("Number of the run that it is compared with.", 2),
        "bins": ("Number of bins of the histogram.", 50),
        "thresholds": "The thresholds by class, in percent.",
        "format": ("The format.", "yolo"),
        "options": "Its options.",
        "download": "Path of the file; null until there is one.",
        # Quality.
        "truth": ("The ground truth.", "people"),
        "precision": "Share of the kept boxes that are right.",
        "recall": "Share of the boxes to be kept that are kept.",
        "f1": "Harmonic mean of precision and recall.",
        "kept_keep": ("Kept by the filter, keep by the truth.", 50),
        "kept_reject": ("Kept by the filter, reject by the truth.", 2),
        "rejected_keep": ("Rejected by the filter, keep by the truth.", 1),
        "rejected_reject": ("Rejected by the filter, reject by the truth.", 20),
        "kept_visible": ("Kept boxes whose object is visible.", 50),
        "kept_hidden": ("Kept boxes whose object is not visible.", 2),
        "rejected_visible": ("Rejected boxes whose object is visible.", 1),
        "rejected_hidden": ("Rejected boxes whose object is not visible.", 20),
        "value": ("The share, 0 to 1.", 0.96),
        "low": ("Lower end of the interval.", 0.91),
        "high": ("Upper end of the interval.", 0.98),
        "agreed": ("Boxes on which they agreed.", 40),
        "interval": "The 95 % interval, low and high.",
        "kappa": ("Cohen's kappa.", 0.81),
        "pairs": "Each two people who decided the same boxes.",
        "a": ("Name of one of the two.", "ann"),
        "b": ("Name of the other.", "bob"),
        "keep": ("Boxes with the answer keep.", 40),
        "reject": ("Boxes with the answer reject.", 12),
        "plan": "A random sample that would tell more; null if none is needed.",
        "confusion": "Verdicts of the filter against the truth.",
        "reviewers": "The people who answered.",
        "agreement": "How far people agree.",
        "suggested": ("The suggested threshold, in percent.", 9.0),
        "current": ("The current threshold, in percent.", 8.0),
        "f1_current": ("F1 with the current threshold.", 0.95),
        "f1_suggested": ("F1 with the suggested threshold.", 0.96),
        "curve": "Scores of other thresholds.",
        "not_measured": "Channels for which no frame has the files.",
        "channels": "The scores by channel.",
        # The server.
        "ready": ("Whether it can take work.", True),
        "checks": "The result of each check, `ok` or what is wrong.",
        "version": ("Version of the program.", "0.1.0"),
        "api": ("Version of the API.", "v1"),
        "python": ("Version of Python.", "3.11.9"),
        "token": "A token.",
        "session": "The secret of the session, shown only here.",
        "code": ("The code for programs; see the table of error codes.", "not_found"),
        "token_id": ("Number of the token.", 2),
        "details": "What else is known.",
        # Folders.
        "end": ("Always true: this is the last line.", True),
        "inspection": "How the folder was understood.",
        "fault": "Why the frame cannot be read; null if it can.",
        "remarks": "Sentences about the folder, with what helps.",
        "facts": "The folder in a few lines.",
        "streams": "The images by role.",
        "painted": "Some frames with the verdicts of their boxes.",
        "images": ("Number of images.", 200),
        "text": "The text.",
        "path": ("Path of the file in the folder.", "README.md"),
        "why": ("Why it belongs to no frame.", "neither an image nor a label"),
        # Errors.
        "type": ("Always `about:blank`.", "about:blank"),
        "title": ("Name of the status.", "Not Found"),
        "instance": ("Path of the request.", "/api/v1/datasets/town10"),
        "request_id": "Identifies the request in the server's log.",
        # Parameters in paths.
        "export_id": ("Number of the export.", 5),
        "run_id": ("Number of the run.", 3),
        "batch_id": ("Number of the bulk answer.", 4),
        "code_id": ("Number of the login link.", 6),
        "hook_id": ("Number of the hook.", 1),
        # Hooks.
        "events": ("Of what it is told.", ["run.ended"]),
        "event": ("What has happened.", "run.ended"),
    }
)
"""By the name that a field or a parameter has in JSON and in URLs."""

OF_MODEL: Final = _described(
    {
        "Alive.status": ("Always `ok`.", "ok"),
        "BatchLine.decisions": "Boxes by verdict; null of a refused frame.",
        "BoxSelection.verdict": ("Only boxes with this verdict of the filter.", "kept"),
        "BoxSelection.effective": ("Only boxes with this effective verdict.", "kept"),
        "BoxSelection.class": ("Only boxes of this class.", "car"),
        "BoxSelection.toss_up": ("Only toss-ups, or only others.", True),
        "BulkIn.verdict": ("The answer of the person.", "keep"),
        "ConfigVersion.config": "All keys with their values.",
        "Dataset.name": ("Name of the dataset.", "town10"),
        "Failure.code": ("The code for programs.", "cancelled"),
        "Fault.code": ("Code of the kind of error.", "not_finite"),
        "FolderClass.name": ("Name of the class in the labels.", "car"),
        "FolderFact.name": ("What the line is about.", "images"),
        "FolderRemedy.value": ("The value that helps.", "percent"),
        "Frame.boxes": "Its boxes and their decisions.",
        "HiddenBy.name": ("Name of the tag.", "Vegetation"),
        "HiddenBy.percent": ("Share of the box's pixels, in percent.", 71.4),
        "AcceptedTag.name": ("Name of the tag.", "Car"),
        "Histogram.classes": "Boxes per bin, by class.",
        "Histogram.edges": "Edges of the bins, in percent.",
        "ImportedAnswer.verdict": ("The answer of the person.", "reject"),
        "LogIn.code": "The code of a login link, instead of `token`.",
        "NewLoginCode.code": "The code of the link, shown only here.",
        "NewSession.name": ("Name of the person.", "ann"),
        "NewToken.name": ("Name of the person.", "ann"),
        "PaintedFrame.boxes": "Its boxes with their verdicts.",
        "Quality.suggested": "The suggested thresholds.",
        "ReviewBatch.verdict": ("The answer of the person.", "keep"),
        "ReviewIn.verdict": ("The answer of the person.", "keep"),
        "Review.verdict": ("The answer of the person.", "keep"),
        "ReviewMark.verdict": ("The answer of the person.", "keep"),
        "Reviewer.name": ("Name of the person.", "ann"),
        "RunIn.config": "The configuration: its digest, or keys and values.",
        "PreviewIn.config": "The configuration: keys and values.",
        "Session.name": ("Name of the person.", "ann"),
        "StoredFrame.frame": "The frame without its boxes.",
        "Token.name": ("Name of the person.", "ann"),
        "WrongBox.error": ("In which way the channel is wrong.", "kept_hidden"),
    }
)
"""By `Model.field`, where the name means something else than elsewhere."""


def described(name: str, model: str = "") -> Described | None:
    """The meaning of a field of a model, or of a parameter; None if it is not known."""
    return OF_MODEL.get(f"{model}.{name}") or FIELDS.get(name)
