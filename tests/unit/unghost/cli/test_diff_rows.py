"""What `unghost diff` prints; numbers that the server did not send stay empty."""

import json

from typer.testing import CliRunner

from tests.support.scripted_server import json_reply
from unghost import Diff
from unghost.cli.program import app
from unghost.cli.remote.runs import rows_of

RESPONSE = {
    "run": 2,
    "against": 1,
    "compared": 9,
    "total": 3,
    "kept_to_rejected": 2,
    "rejected_to_kept": 0,
    "by_class": {"car": 2, "bus": 1},
}


def test_diff_rows_have_flips_per_class_in_both_directions():
    sides = {"car": {"kept_to_rejected": 2, "rejected_to_kept": 0}}

    rows = rows_of(Diff.read({**RESPONSE, "sides_by_class": sides}))

    assert rows == [("car", 2, 2, 0), ("bus", 1, 0, 0), ("all", 3, 2, 0)]
    without = rows_of(Diff.read(RESPONSE))
    assert without == [("car", 2, None, None), ("bus", 1, None, None), ("all", 3, 2, 0)]


def test_diff_as_json_has_the_sums_and_nothing_of_their_page(scripted):
    page = {**RESPONSE, "items": [], "next_cursor": None, "page": 1}
    scripted.answer_always(json_reply(page))
    server = ("--server", scripted.url, "--token", "secret")

    result = CliRunner().invoke(app, ["diff", "1", "2", "--json", *server])

    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == RESPONSE
