"""A frame that was just stored, described without asking the database for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from app.repositories.frames import FileRow
from app.services.active import ActiveDataset
from app.services.decisions import (
    StoredDecision,
    accepted_tags,
    current_review,
    rounded_edges,
)
from app.services.frame_rows import FrameContent, WrittenFrame
from app.services.statistics import count, summary, tallies_of
from app.verdicts import effective_verdict
from filter_core.decisions.record import decision_dicts
from unghost.wire.frames import FrameDetails, StoredFile


def describe_new(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> dict[str, Any]:
    """A `wire.StoredFrame`; its decisions are dicts, with answers that came along."""
    frame = _frame(active, content, written)
    return {
        "frame": frame,
        "segmentation": frame.segmentation,
        "decisions": _decisions(active, content, written),
    }


def _frame(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> FrameDetails:
    files = {row.kind: row for row in content.files.rows}
    report, raw = content.measured.segmentation, content.annotation.raw
    decided = zip(
        content.measured.evidence.class_index.tolist(),
        written.decisions.reason.tolist(),
        written.decisions.toss_up.tolist(),
        strict=True,
    )
    answers = {row["box_id"]: row["verdict"] for row in written.carried}
    alike = tallies_of(
        (index, reason, toss, answers.get(box_id))
        for box_id, (index, reason, toss) in enumerate(decided, written.first_box_id)
    )
    width, height = content.files.image_wh
    return FrameDetails(
        id=written.frame_id,
        key=content.key,
        revision=written.revision,
        width=width,
        height=height,
        map=content.annotation.map,
        has_image="image" in files,
        has_segmentation="segmentation" in files,
        lossy=content.measured.lossy,
        created_at=written.created_at,
        counts=summary(count(alike)),
        dataset=active.name,
        camera=raw.get("camera"),
        carla_version=content.annotation.carla_version,
        captured_text=content.annotation.captured_at,
        weather=raw.get("weather"),
        superseded=False,
        segmentation=report,
        files=stored_files(written.frame_id, files),
    )


def _decisions(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> list[StoredDecision]:
    measured, geometry = content.measured, content.measured.geometry
    if written.revision > 1:  # answered as if it was read, as it always has been
        edges = [None if one is None else rounded_edges(one) for one in geometry.edges]
        geometry = replace(geometry, edges=edges)
    facts = measured.facts(active.config)
    composed = decision_dicts(
        facts,
        measured.ids,
        measured.evidence,
        written.decisions,
        geometry,
    )
    masks = measured.evidence.accept_mask.tolist()
    tags = {mask: accepted_tags(facts.family, mask) for mask in set(masks)}
    described: list[StoredDecision] = [
        {
            **decision,
            "frame": content.key,
            "box_id": written.first_box_id + position,
            "frame_id": written.frame_id,
            "run": active.row.run_id,
            "config": active.row.config_digest,
            "revision": 0,
            "review": None,
            "effective_verdict": decision["verdict"],
            "accepted_tags": tags[mask],
        }
        for position, (decision, mask) in enumerate(zip(composed, masks, strict=True))
    ]
    for row in written.carried:
        position = row["box_id"] - written.first_box_id
        reason = int(written.decisions.reason[position])
        described[position] |= {
            "revision": row["revision"],
            "review": current_review(row),
            "effective_verdict": effective_verdict(reason, row["verdict"]),
        }
    return described


def stored_files(frame_id: int, files: Mapping[str, FileRow]) -> dict[str, StoredFile]:
    """Files of a frame by kind, and where to get them."""
    return {
        kind: StoredFile(
            url=f"/api/v1/frames/{frame_id}/{kind}",
            sha256=file.sha256,
            media_type=file.media_type,
            size_bytes=file.size_bytes,
        )
        for kind, file in files.items()
    }
