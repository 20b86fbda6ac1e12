"""Which of many frames are stored already, so that nothing is sent twice."""

from __future__ import annotations

from app.http.deps import ReadSession
from app.http.routing import ApiRouter
from app.repositories.datasets import DatasetRepository
from app.repositories.known_frames import known_frames
from app.routes.datasets import DatasetName
from unghost.wire.frames import KnownFrame, KnownFrames, KnownFramesIn

router = ApiRouter(prefix="/api/v1", tag="frames")


@router.post("/datasets/{dataset}/known-frames", response_model=KnownFrames)
def find_known_frames(
    dataset: DatasetName, body: KnownFramesIn, session: ReadSession
) -> KnownFrames:
    """Which of up to 1000 keys are stored, each with the digest of its content."""
    found = DatasetRepository(session).named(dataset)
    rows = known_frames(session, found.id, body.keys)
    return KnownFrames(items=tuple(KnownFrame(**row._asdict()) for row in rows))
