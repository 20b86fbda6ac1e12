"""`Screen` writes data to standard output, and all else to standard error."""

import json

import pytest

from unghost.cli.screen import Screen, refusal

# Sets the title of a terminal, clears it, turns to the line's start; also as one
# character, as U+009B; deletes; and what UTF-8 does not have.
HOSTILE = "\x1b]0;OWNED\x07\x1b[2J\r\x9b2J\x7f\udcff"
ESCAPED = r"\u001b]0;OWNED\u0007\u001b[2J\u000d\u009b2J\u007f\udcff"


@pytest.mark.parametrize(
    ("as_json", "out"),
    [
        (False, "for people\ntext\na b c\t1\n\t2\n"),
        (True, '{"key": "a"}\n{"key": "b"}\n'),
    ],
)
def test_json_option_chooses_between_records_and_what_is_for_people(
    capsys, as_json, out
):
    screen = Screen(as_json=as_json)
    screen.record({"key": "a"}, "for people")
    screen.record({"key": "b"})
    screen.text("text")
    screen.table(("name", "number"), [("a\tb\nc", 1), (None, 2)])
    screen.note("by the way")

    assert capsys.readouterr() == (out, "by the way\n")


def test_progress_off_terminal_is_one_final_line(capsys):
    with Screen().progress("push", "frames") as advance:
        for done in range(1, 1001):
            advance(done, 1000)

    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("push: 1000 of 1000 frames, ")
    assert err.count("\n") == 1


@pytest.mark.parametrize("total", [None, 3])
def test_progress_on_terminal_is_a_bar(capsys, monkeypatch, total):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")

    with Screen().progress("push", "frames") as advance:
        for done in range(1, 4):
            advance(done, total)

    out, err = capsys.readouterr()
    assert out == ""
    assert "push" in err
    assert f"3/{total or '?'}" in err


def test_control_characters_are_escaped(capsys):
    screen = Screen()
    screen.text(f"a\t{HOSTILE}\nb")
    screen.record({}, HOSTILE)
    screen.note(f"a\t{HOSTILE}\nb")

    out, err = capsys.readouterr()
    assert out == f"a\t{ESCAPED}\nb\n{ESCAPED}\n"
    assert err == f"a\t{ESCAPED}\nb\n"

    record = {"key": HOSTILE, "ü": "a\nb"}
    Screen(as_json=True).record(record, "for people")

    out, err = capsys.readouterr()
    assert out.removesuffix("\n").isprintable()
    assert (json.loads(out), err) == (record, "")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_control_characters_in_tables_are_escaped(capsys, monkeypatch, is_terminal):
    monkeypatch.setattr("sys.stdout.isatty", lambda: is_terminal)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "200")

    Screen().table(("name",), [(HOSTILE.replace("\r", ""),)])

    assert ESCAPED.replace(r"\u000d", "") in capsys.readouterr().out


def test_line_breaks_of_a_key_are_escaped_in_a_refusal():
    line = refusal("a\nunghost: all is well\u2028", "b\nc")

    assert line == r"refused: a\u000aunghost: all is well\u2028: b\u000ac"
