"""Options accept the library's words, but help does not import the library."""

import re
import subprocess
import sys
from typing import get_args

import pytest
import typer
from typer.testing import CliRunner

from filter_core.config.declaration import AllowedWords
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import keys_of
from filter_core.evaluation.comparison import COMPARED
from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import EXPORT_FORMATS
from tests.support.imports import LARGE_MODULES
from unghost.cli.program import app
from unghost.cli.sources import SourceOptions, with_options
from unghost.client.discovery import BadServerUrl
from unghost.wire.words import Role


def run(*words):
    return CliRunner().invoke(app, words, env={"COLUMNS": "300"})


def allowed(key):
    words = keys_of(FilterConfig)[key].allowed
    assert isinstance(words, AllowedWords)
    return words.words


@pytest.mark.parametrize(
    ("command", "option", "words"),
    [
        (["filter", "."], "--palette", allowed("palette")),
        (["convert", "."], "--encoding", allowed("encoding")),
        (["push", "."], "--channel-order", allowed("channel_order")),
        (["filter", "."], "--lossy-segmentation", allowed("lossy_segmentation")),
        (["evaluate", "."], "--channel", COMPARED),
        (["token", "create", "ada"], "--role", get_args(Role)),
    ],
)
def test_option_accepts_exactly_the_values_of_its_table(command, option, words):
    shown = run(*command, "--help")
    refused = run(*command, option, "nonsense")

    assert "|".join(words) in shown.output
    assert refused.exit_code == 2
    assert option in refused.output
    assert re.findall(r"'(.*?)'", refused.output.partition("is not one of")[2]) == [
        *words
    ]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("filter", LAYOUTS),
        ("push", LAYOUTS),
        ("convert", LAYOUTS),
        ("convert", (*EXPORT_FORMATS, "same, which is that of SOURCE")),
        ("export", EXPORT_FORMATS),
    ],
)
def test_help_lists_all_layouts_and_formats(command, words):
    listed = f"{', '.join(words[:-1])} or {words[-1]}."

    # Compared without white space: help breaks lines anywhere, even within a name.
    help_text = run(command, "--help").output
    assert "".join(listed.split()) in "".join(help_text.split())


QUICK = (
    "--help",
    *(f"{name} --help" for name in ("stats", "filter", "push", "export")),
    *(f"{name} --help" for name in ("convert", "evaluate", "token create")),
    "export street --format yolo --output a.zip --retry-for 0",
)


def test_help_and_remote_commands_do_not_load_heavy_modules(tmp_path):
    program = (
        "import sys; from typer.testing import CliRunner; "
        "from unghost.cli.program import app\n"
        f"for words in {QUICK}:\n"
        "    CliRunner().invoke(app, words.split())\n"
        "    print(words, *sys.modules, sep='\\t')"
    )
    process = subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        # No server answers at this address.
        env={"HOME": str(tmp_path), "UNGHOST_SERVER": "http://127.0.0.1:1"},
    )

    # pydantic may be loaded: Typer itself uses it to read arguments.
    heavy = {*LARGE_MODULES} - {"pydantic"}
    told = [line.split("\t") for line in process.stdout.splitlines()]
    loaded = {words: heavy.intersection(modules) for words, *modules in told}
    assert loaded == {words: set() for words in QUICK}


def test_class_names_and_class_maps_are_separated_by_commas(tmp_path):
    options = SourceOptions(
        classes="car, traffic light", class_map=["Car=car, Misc=pass", "a=b=van"]
    )

    description = options.description_of(tmp_path)

    assert description.classes == ("car", "traffic light")
    assert description.class_map == {"Car": "car", "Misc": "pass", "a=b": "van"}
    assert SourceOptions().description_of(tmp_path).changed == {}
    for wrong, option in [
        (SourceOptions(classes="car,,bus"), "--classes"),
        (SourceOptions(class_map=["Car=caar"]), "--class-map"),
    ]:
        with pytest.raises(typer.BadParameter, match=f"^{option}[ :]"):
            wrong.description_of(tmp_path)
    options = SourceOptions(palette="carla-0.9.14", lossy_segmentation=None)

    assert options.reading == {"palette": "carla-0.9.14"}


@pytest.mark.parametrize(
    ("words", "exit_code"),
    [
        ("stats --help", 0),
        ("stats town --token secret --help", 0),
        ("config show --help", 0),
        ("config --help", 0),
        ("--help stats", 0),
        ("stats --nonsense --help", 2),
        # It is the value of an option, or an argument.
        ("stats town --server ftp://a --token --help", None),
        ("config show --token --help --server ftp://a town", None),
        ("stats --server ftp://a -- --help", None),
    ],
)
def test_help_flag_shows_usage_unless_it_is_a_value(words, exit_code):
    result = run(*words.split())

    assert ("Usage:" in result.output) == (exit_code is not None)
    if exit_code is None:
        assert isinstance(result.exception, BadServerUrl)
    else:
        assert result.exit_code == exit_code
        assert ("--nonsense" in result.output) == (exit_code == 2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("`layout` in recording.yaml names it",
         "`layout` in recording.yaml (--layout) names it"),
        ("`boxes: {unit: percent}` or `boxes.corners`", "--unit percent or --corners"),
        ("(`classes: {caar: car}`)", "(--class-map caar=car)"),
        ("`segmentation: {lossy: nearest}`", "--lossy-segmentation nearest"),
        ("`boxes: {classes: [car, bus]}`", "--classes car,bus"),
        ("`classes: {Car: {name: car}}` joins two",
         "`classes: {Car: {name: car}}` joins two"),
        ("`files` and `cameras: {fov: 90}`", "`files` and `cameras: {fov: 90}`"),
    ],
)  # fmt: skip
def test_keys_of_a_description_get_the_options_that_say_the_same(text, expected):
    assert with_options(text) == expected
