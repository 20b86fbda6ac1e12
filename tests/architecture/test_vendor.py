"""Libraries of others that the page includes are byte by byte as published.

Each has a record of its origin and its licence.
"""

import hashlib
import json

from tests.support.sources import CHECKOUT

VENDOR = CHECKOUT / "static" / "vendor"
LOCKED = json.loads((VENDOR / "lock.json").read_text("utf-8"))["files"]
ACCEPTED_LICENCES = frozenset(
    {"MIT", "ISC", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause"}
)


def test_every_vendored_file_has_its_recorded_content_licence_and_origin():
    digests = {
        file["path"]: hashlib.sha256((VENDOR / file["path"]).read_bytes()).hexdigest()
        for file in LOCKED
    }

    assert digests == {file["path"]: file["sha256"] for file in LOCKED}
    code = {
        path.relative_to(VENDOR).as_posix()
        for path in VENDOR.rglob("*")
        if path.suffix in {".js", ".mjs", ".css", ".wasm"}
    }
    assert code == digests.keys()
    for file in LOCKED:
        assert file["licence"] in ACCEPTED_LICENCES
        assert (VENDOR / file["licence_file"]).stat().st_size > 0
        assert file["version"] in file["source"]
