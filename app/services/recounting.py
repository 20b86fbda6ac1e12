"""Numbers for another configuration without pixels, from the tag histograms."""

from __future__ import annotations

from collections.abc import Mapping

from app.db.evidence_record import (
    pack_numbers,
    to_evidence,
    unpack_numbers,
    unpack_tag_counts,
)
from app.repositories.evidence import EvidenceRow
from filter_core.config.measure import MeasureConfig
from filter_core.evidence.semantic import with_accept_sets
from filter_core.types import Evidence


def recount(
    row: EvidenceRow, classes: Mapping[str, int], config: MeasureConfig
) -> Evidence:
    """A frame's evidence with the accept sets of another configuration."""
    evidence = to_evidence(
        unpack_numbers([row.numbers], [row.box_count]),
        list(classes),
        list(classes.values()),
        unpack_tag_counts(row.tag_counts, row.box_count),
    )
    family = (row.segmentation or {}).get("palette")
    return with_accept_sets(evidence, config, family)


def recounted_row(
    row: EvidenceRow,
    evidence: Evidence,
    classes: Mapping[str, int],
    measurement_id: int,
) -> dict[str, object]:
    """The evidence row of recounted numbers; what was seen is the same."""
    return {
        "frame_id": row.frame_id,
        "measurement_id": measurement_id,
        "numbers": pack_numbers(evidence, list(classes.values())),
        "tag_counts": row.tag_counts,
        "geometry": row.geometry,
        "channels": row.channels,
        "segmentation": row.segmentation,
        "lossy": bool((row.segmentation or {}).get("lossy")),
    }
