"""`Screen` writes data to standard output, and all else to standard error."""

from __future__ import annotations

import json

import pytest

from unghost.cli.screen import Screen


def test_records_are_json_lines_on_request(capsys):
    Screen(as_json=True).record({"key": "ü", "line": "a\nb"}, "for people")

    out, err = capsys.readouterr()
    assert json.loads(out) == {"key": "ü", "line": "a\nb"}
    assert out.count("\n") == 1
    assert err == ""


def test_without_json_people_read_the_text(capsys):
    screen = Screen()
    screen.record({"key": "a"}, "for people")
    screen.record({"key": "b"})

    assert capsys.readouterr().out == "for people\n"


def test_with_json_there_is_no_text(capsys):
    screen = Screen(as_json=True)
    screen.text("for people")
    screen.table(("a",), [(1,)])

    assert capsys.readouterr().out == ""


def test_off_a_terminal_a_row_is_a_line_with_tabs(capsys):
    Screen().table(("name", "number"), [("a\tb\nc", 1), (None, 2)])

    assert capsys.readouterr().out == "a b c\t1\n\t2\n"


def test_notes_are_not_data(capsys):
    Screen(as_json=True).note("by the way")

    assert capsys.readouterr() == ("", "by the way\n")


def test_off_a_terminal_progress_is_a_line_at_the_end(capsys):
    with Screen().progress("push", "frames") as advance:
        for done in range(1, 1001):
            advance(done, 1000)

    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("push: 1000 of 1000 frames, ")
    assert err.count("\n") == 1


@pytest.mark.parametrize("total", [None, 3])
def test_on_a_terminal_progress_is_a_bar(capsys, monkeypatch, total):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")

    with Screen().progress("push", "frames") as advance:
        for done in range(1, 4):
            advance(done, total)

    out, err = capsys.readouterr()
    assert out == ""
    assert "push" in err
    assert f"3/{total or '?'}" in err
