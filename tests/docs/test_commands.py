"""Commands in the documents exist, can be parsed, and have a help text."""

import os
import re
import shlex
import subprocess

import pytest

from tests.support.documents import DOCUMENTS, blocks, read
from tests.support.sources import CHECKOUT
from tools.reference import commands

MAKE_TARGET = re.compile(r"^([a-z-]+):.*## ", re.MULTILINE)
COMMANDS = dict(commands())


def shell_lines():
    """Every command line in the documents' shell examples."""
    return [
        line.strip()
        for document in DOCUMENTS
        for language in ("sh", "console", "powershell")
        for block in blocks(document.read_text("utf-8"), language)
        for line in block.replace("\\\n", " ").splitlines()
        if line.strip() and not line.startswith("#")
    ]


def test_every_documented_make_command_is_a_target_with_help_and_ci_runs_test():
    targets = set(MAKE_TARGET.findall(read("Makefile")))
    prose = [document.read_text("utf-8") for document in DOCUMENTS]

    named = {name for text in prose for name in re.findall(r"`make ([a-z-]+)`", text)}
    typed = {line.split()[1] for line in shell_lines() if line.startswith("make ")}

    assert named | typed <= targets
    assert {"demo", "test"} <= typed
    phony = re.search(r"^\.PHONY: (.*)$", read("Makefile"), re.MULTILINE)

    assert phony is not None
    assert set(phony[1].split()) == targets
    lines = read(".ci/run").splitlines()
    code = [line for line in lines if line and not line.startswith("#")]

    assert code[-1] == "exec make test </dev/null"


@pytest.mark.parametrize("path", COMMANDS)
def test_every_command_and_option_has_help_and_its_environment_variable(path):
    command = COMMANDS[path]

    silent = [
        parameter.name
        for parameter in command.params
        if parameter.name != "help" and not getattr(parameter, "help", None)
    ]

    assert command.help
    assert silent == []
    parameters = [vars(option) for option in command.params]

    shown = {option["name"] for option in parameters if option["show_envvar"]}
    assert shown == {option["name"] for option in parameters if option["envvar"]}


@pytest.mark.parametrize(
    "line", [line for line in shell_lines() if line.startswith("unghost ")]
)
def test_every_documented_command_line_can_be_parsed(line):
    words = shlex.split(line, comments=True)
    path = max(
        (name for name in COMMANDS if f"{' '.join(words)} ".startswith(f"{name} ")),
        key=len,
    )
    command = COMMANDS[path]

    options = {option for each in command.params for option in each.opts}
    written = {word.split("=")[0] for word in words if re.match(r"--?[a-z]", word)}

    assert written - {"--help"} <= options


def test_make_without_a_target_lists_every_target():
    listing = subprocess.run(
        ["make", "--no-print-directory"],
        cwd=CHECKOUT,
        # Without the variables of the `make` that may be running this test.
        env={k: v for k, v in os.environ.items() if not k.startswith("MAKE")},
        check=True,
        capture_output=True,
        text=True,
    ).stdout

    named = re.findall(r"^  make ([\w-]+) ", listing, re.MULTILINE)

    assert named == MAKE_TARGET.findall(read("Makefile"))
