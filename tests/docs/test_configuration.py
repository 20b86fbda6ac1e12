"""docs/configuration.md lists every key and setting with the default of the code."""

import re

import yaml

from app.settings import Settings
from filter_core.config.filter import FilterConfig
from tests.support.documents import blocks, read
from tools.reference import PARTS, configuration_table, part_pattern, settings_table


def test_the_table_has_every_key_and_every_example_is_valid():
    rows = [row.split(" | ") for row in configuration_table()][2:]

    assert {row[0].strip("|` "): yaml.safe_load(row[1].strip("`")) for row in rows} == (
        FilterConfig().as_dict()
    )
    for text in blocks(read("docs/configuration.md"), "yaml"):
        FilterConfig.from_mapping(yaml.safe_load(text))


def test_every_setting_has_a_description():
    silent = [
        name for name, field in Settings.model_fields.items() if not field.description
    ]

    assert silent == []
    assert len(list(settings_table())) == len(Settings.model_fields) + 2


def test_limits_of_batches_in_their_document_are_all_that_refuse_open_batches():
    limits = read("docs/batches.md").partition("\n## Limits\n")[2]
    named = set(re.findall(r"`UNGHOST_(\w+)`", limits))

    opened = {name for name in Settings.model_fields if "open_batches" in name}
    assert {name.lower() for name in named} >= opened
    assert {name.lower() for name in named} <= set(Settings.model_fields)


def test_generated_parts_of_the_documents_are_up_to_date():
    for name, (path, lines) in PARTS.items():
        part = part_pattern(name).search(path.read_text("utf-8"))

        assert part is not None
        assert part[2].splitlines() == list(lines()), f"{path.name}: run `make docs`"
