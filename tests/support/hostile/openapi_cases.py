"""Sets up schemathesis to make requests from the service's OpenAPI document."""

import os
from pathlib import Path
from tempfile import gettempdir
from typing import Any, Final

import schemathesis
from schemathesis import Case, CheckContext, Response
from schemathesis.schemas import BaseSchema

from app.main import create_app
from app.settings import Settings
from filter_core.config.filter import FilterConfig
from tests.support import archives
from tests.support.api import Api

EXAMPLES: Final = int(os.environ.get("OPENAPI_EXAMPLES", "2"))
IS_LONG: Final = EXAMPLES > 50
DATASET, KEPT_KEYS, DELETED_KEY = "street", ("run/0", "run/1"), "run/2"
MALFORMED: Final = ("invalid_request", "unknown_parameter")
"""Error codes of requests that do not have the documented form. All other codes refuse
the content of a request, which no schema can describe.
"""
_BY_VALIDATOR: Final = "value_error"
_IDS: Final = (
    *("box_id", "revision", "frame_id", "run_id", "export_id"),
    *("batch_id", "token_id"),
)
_OWN_TOKENS: Final = 2
_REFUSALS: Final = ["2xx", "3xx", "400", "401", "403", "404", "409", "412", "413"]


def _described() -> BaseSchema:
    """The service's schema, with names and ids that exist among the values to try."""
    never_made = Path(gettempdir()) / "unghost-never-made"
    document = create_app(Settings(data=never_made)).openapi()
    return schemathesis.openapi.from_dict(document, config=_config())


def _config() -> schemathesis.Config:
    parameters = {
        "path.dataset": DATASET,
        "query.dataset": DATASET,
        "query.confirm": DATASET,
        "path.key": DELETED_KEY,
        "path.digest": FilterConfig().digest,
        "query.review": "any",
    }
    names = {place: place.replace(".", "-") for place in parameters}
    words = {names[place]: {"values": [value]} for place, value in parameters.items()}
    chosen = {
        place: {"dictionary": name, "probability": 0.8} for place, name in names.items()
    }
    ids = {f"path.{name}": {"dictionary": "ids", "probability": 0.8} for name in _IDS}
    expected = {"expected-statuses": [*_REFUSALS, "415", "422", "429"]}
    return schemathesis.Config.from_dict(
        {
            "max-stream-events": 20,
            "dictionaries": {**words, "ids": {"values": [1, 2, 3]}},
            "parameters": {**chosen, **ids},
            "generation": {"max-examples": EXAMPLES, "no-shrink": not IS_LONG},
            "phases": {
                "examples": {"enabled": False},
                "coverage": {"enabled": IS_LONG},
            },
            "checks": {"positive_data_acceptance": expected},
        }
    )


@schemathesis.serializer("application/x-tar")
def _archive(_context: Any, value: Any) -> bytes:
    """The generated value as a file in a valid tar archive."""
    content = value if isinstance(value, bytes) else str(value).encode()
    return archives.tar_archive([("a.json", content), ("a.image.png", content)])


def check_is_not_malformed(
    _context: CheckContext, response: Response, case: Case
) -> None:
    """Check that a request of the documented form is not refused as malformed."""
    if response.status_code < 400:
        return
    problem = response.json()
    assert set(problem) >= {"status", "code", "detail", "request_id", "errors"}
    assert problem["status"] == response.status_code
    is_positive = case.meta is not None and case.meta.generation.mode.is_positive
    faults = {fault["code"] for fault in problem["errors"]}
    about_form = problem["code"] in MALFORMED and faults != {_BY_VALIDATOR}
    assert not (is_positive and about_form), problem


def without_own_tokens(case: Case) -> Case:
    """The case, changed so that it revokes no token that the test itself uses."""
    path: dict[str, Any] = case.path_parameters or {}
    token_id = path.get("token_id")
    if isinstance(token_id, int) and token_id <= _OWN_TOKENS:
        path["token_id"] = token_id + 10**6
    return case


def restore(api: Api) -> None:
    """Create the dataset and frames again that a request may have deleted."""
    api.post("/datasets", {"name": DATASET})
    for key in (*KEPT_KEYS, DELETED_KEY):
        assert api.put(DATASET, key, replace=True).status_code in (200, 201)


def populate(api: Api) -> None:
    """Make a dataset with answers, a batch of answers, a second run and an export."""
    restore(api)
    api.run(DATASET, {"threshold_small_box": 40})
    box_ids = api.box_ids(DATASET)
    bulk = {"dataset": DATASET, "box_ids": box_ids, "verdict": "keep"}
    assert api.post("/reviews/bulk", bulk).status_code == 201
    export = api.post(f"/datasets/{DATASET}/exports", {"format": "yolo"})
    assert api.wait_for_job(export)["state"] == "done"


SCHEMA: Final = _described()
