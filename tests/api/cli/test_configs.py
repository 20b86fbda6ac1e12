"""Configuration files that cannot be used: the messages of the commands."""

from __future__ import annotations

from tests.support.frames import write_manifest

EXIT_REFUSED = 1


def test_config_with_an_unknown_key_is_refused_with_the_nearest_key(
    unghost, api, tmp_path
):
    file = tmp_path / "filter.yaml"
    file.write_text("treshold_small_box: 5\n")

    for command in commands_with_config(api.dataset(), file):
        answer = unghost(*command)
        assert answer.code == EXIT_REFUSED
        assert answer.err == (
            f"unghost: {file}: unknown key 'treshold_small_box'; the nearest valid key "
            "is 'threshold_small_box'\n"
        )
    assert not (tmp_path / "out.jsonl").exists()


def test_config_that_is_not_utf8_is_refused(unghost, api, tmp_path):
    file = tmp_path / "filter.yaml"
    file.write_bytes(b"classes:\xff")

    for command in commands_with_config(api.dataset(), file):
        answer = unghost(*command)
        assert answer.code == EXIT_REFUSED
        assert answer.err == (
            f"unghost: {file}: expected YAML in UTF-8, found other bytes at offset 8\n"
        )


def test_classes_of_a_config_that_no_box_has_are_noted(unghost, api, tmp_path):
    dataset = api.dataset_of_one_frame()
    file = tmp_path / "filter.yaml"
    file.write_text(
        "classes: {cra: {threshold_small_box: 5}, zebra: {threshold_small_box: 5},"
        " car: {threshold_small_box: 5}, bus: {threshold_small_box: 5}}"
    )

    for command in commands_with_config(dataset, file):
        answer = unghost(*command)
        assert answer.code == 0, answer.err
        notes = [line for line in answer.err.splitlines() if "occurs in" in line]
        assert notes == [
            "class 'cra' of the configuration occurs in none of 2 boxes; did you mean "
            "'car'?",
            "class 'zebra' of the configuration occurs in none of 2 boxes",
        ]


def test_classes_of_a_config_are_not_noted_for_a_dataset_without_boxes(
    unghost, api, tmp_path
):
    file = tmp_path / "filter.yaml"
    file.write_text("classes: {cra: {threshold_small_box: 5}}")

    assert "cra" not in unghost("config", "set", api.dataset(), file).err


def commands_with_config(dataset, file):
    """Command lines that read the file; `filter` does so without the server."""
    frames = write_manifest(file.parent / "frames", 1)
    yield "filter", frames, "--config", file, "-o", file.parent / "out.jsonl"
    yield "config", "set", dataset, file
    yield "config", "diff", dataset, "--config", file
    yield "run", dataset, "--config", file
