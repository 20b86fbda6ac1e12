"""Results as the API has them: their nested objects, defaults and times.

`test_model.py` tests what all models of responses share.
"""

from datetime import datetime, timedelta, timezone

import pytest

from tests.support.response_checks import COUNTS, DECISION
from unghost import Decision, Frame, HistoryEntry
from unghost.wire import NewLoginCode, NewSession, NewToken

FRAME = {
    "id": 1,
    "key": "a",
    "dataset": "town",
    "created_at": "2026-01-01T00:00:00Z",
    "counts": COUNTS,
}
NOON = "2026-01-01T12:00:00Z"
TOKEN = {"id": 1, "name": "ada", "role": "viewer", "created_at": NOON}
FILE = {"url": "/x", "sha256": "ab", "media_type": "image/png", "size_bytes": 9}


def test_decision_and_frame_have_typed_objects():
    decision = Decision.read(DECISION)
    frame = Frame.read({**FRAME, "files": {"image": FILE}})

    assert decision.class_name == "car"
    assert decision.hidden_by[0].name == "Vegetation"
    assert decision.hidden_by[0].rgb == (255, 255, 255)
    assert decision.review is not None
    assert decision.review.revision == 2
    assert decision.edges is None
    assert frame.files["image"].sha256 == "ab"
    # Fields that older servers lack have defaults.
    older = Decision.read({**DECISION, "hidden_by": None, "revision": None})
    assert (older.hidden_by, older.revision) == ((), 0)
    raw = {"kind": "decision", "at": "2026-01-01T00:00:00Z", "run": 3, "verdict": None}
    entry = HistoryEntry.read(raw)
    assert (entry.run, entry.verdict) == (3, None)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2026-01-01T00:00:00Z", 0),
        ("2026-01-01t00:00:00z", 0),
        ("2026-01-01T00:00:00.5Z", 0.5),
        ("2026-01-01T02:00:00.123456789+02:00", 0.123456),
        (None, None),
        ("2026-W01-4T00:00Z", None),
        ("long ago", None),
    ],
)
def test_captured_at_is_parsed_if_possible_and_its_text_is_kept(text, seconds):
    frame = Frame.read({**FRAME, "captured_at": text})

    midnight = datetime(2026, 1, 1, tzinfo=timezone.utc)
    time = None if seconds is None else midnight + timedelta(seconds=seconds)
    assert (frame.captured_at, frame.captured_text) == (time, text)


@pytest.mark.parametrize(
    "secret",
    [
        NewToken.read({**TOKEN, "token": "mine-alone"}),
        NewSession.read({"name": "ada", "role": "viewer", "session": "mine-alone"}),
        NewLoginCode.read({"id": 1, "expires_at": NOON, "code": "mine-alone"}),
    ],
)
def test_secrets_are_not_in_representations(secret):
    assert "mine-alone" not in repr(secret)
