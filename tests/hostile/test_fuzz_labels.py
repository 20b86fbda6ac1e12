"""Fuzzing of configurations, annotations and label files.

Each damaged or changed input gives a result or our own error, and takes little memory.
"""

import json
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from filter_core.annotation.parsing import parse_annotation, without_key
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError
from filter_core.formats.registry import read_source
from filter_core.local import filter_one
from tests.support.folders import write_files
from tests.support.hostile.label_samples import ANNOTATION, CARLASIMU, FOLDERS, YAML
from tests.support.hostile.mutations import (
    damaged,
    damaged_text,
    fuzz_settings,
    json_values,
    little_memory,
    mutated_json,
)

pytestmark = pytest.mark.long

CONFIG = yaml.safe_load(YAML)


@fuzz_settings
@given(content=st.one_of(damaged_text([YAML, CARLASIMU]), st.binary(max_size=80)))
@example(b"a: " + b"[" * 5000)
@example(b"threshold_small_box: " + b"9" * 5000)
@example(b"a: &a [1]\nb: [*a, *a]")
@example(b"? {a: b}\n: 1")
@example(b"a: 2026-13-45")
@example(b"a: 1:60:99")
@example(b"a: !!binary x")
@example(b"a: !!int _")
@example(b"a: !!bool maybe")
@example(b"a: !!timestamp maybe")
@example(b"a: !!float _")
@example(b"!!set [a]")
@example(b"a: !!omap [1]")
@example(b"a: !!pairs {b: 1}")
@example(b"a: !!python/name:os.system x")
@example(b"%YAML 9.9\n---\na: 1")
def test_any_yaml_text_is_a_configuration_or_raises_our_own_error(content):
    with little_memory(), suppress(FilterError):
        load_config(content)


@fuzz_settings
@given(
    document=st.one_of(
        mutated_json(CONFIG), mutated_json(yaml.safe_load(CARLASIMU)), json_values
    )
)
def test_any_mapping_is_a_configuration_or_raises_our_own_error(document):
    with little_memory(), suppress(FilterError):
        load_config(document if isinstance(document, dict) else repr(document))


@fuzz_settings
@given(
    content=st.one_of(
        damaged([json.dumps(ANNOTATION).encode()]),
        mutated_json(ANNOTATION).map(json.dumps).map(str.encode),
        st.binary(max_size=80),
    )
)
@example(b"[" * 100_000)
@example(b'{"boxes": [{"class": "car", "xyxy": [0, 0, 1, ' + b"9" * 5000 + b"]}]}")
def test_any_annotation_bytes_are_read_or_raise_our_own_error(content):
    with little_memory(), suppress(FilterError):
        name, rest = without_key(content, "a")
        parse_annotation(rest, frame=name)


@fuzz_settings
@given(document=mutated_json(ANNOTATION))
def test_any_object_is_an_annotation_or_raises_our_own_error(document):
    with little_memory(), suppress(FilterError):
        parse_annotation(document if isinstance(document, dict) else {})


@pytest.mark.parametrize("layout", FOLDERS)
@fuzz_settings
@given(data=st.data())
def test_any_label_folder_is_read_or_raises_our_own_error(layout, data):
    files = dict(FOLDERS[layout])
    texts = [name for name in sorted(files) if not name.endswith(".png")]
    for _ in range(data.draw(st.integers(1, 2))):
        name = data.draw(st.sampled_from(texts))
        files[name] = data.draw(damaged([files[name]]))
    # Memory is not measured here: that would make reading ten times as slow.
    with TemporaryDirectory() as place, suppress(FilterError):
        for source in read_source(write_files(Path(place), files), layout):
            outcome = filter_one(source, FilterConfig())
            assert (outcome.error is None) != (outcome.decisions is None)
