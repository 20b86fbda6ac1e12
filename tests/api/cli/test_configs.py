"""Configuration files that cannot be used: the messages of the commands."""

from tests.support.frames import write_manifest

EXIT_REFUSED = 1


def test_config_with_an_unknown_key_is_refused_with_the_nearest_key(
    unghost, api, tmp_path
):
    file = tmp_path / "filter.yaml"
    file.write_text("treshold_small_box: 5\n")

    for command in commands_with_config(api.dataset(), file):
        result = unghost(*command)
        assert result.code == EXIT_REFUSED
        assert result.err == (
            f"unghost: {file}: unknown key 'treshold_small_box'; the nearest valid key "
            "is 'threshold_small_box'\n"
        )
    assert not (tmp_path / "out.jsonl").exists()


def test_classes_of_a_config_that_no_box_has_are_noted(unghost, api, tmp_path):
    dataset = api.dataset_of_one_frame()
    file = tmp_path / "filter.yaml"
    file.write_text(
        "classes: {cra: {threshold_small_box: 5}, zebra: {threshold_small_box: 5},"
        " car: {threshold_small_box: 5}, bus: {threshold_small_box: 5}}"
    )

    for command in commands_with_config(dataset, file):
        result = unghost(*command)
        assert result.code == 0, result.err
        notes = [line for line in result.err.splitlines() if "occurs in" in line]
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


def pushed(unghost, dataset, file):
    source = file.parent / "frames"
    if not source.exists():
        write_manifest(source, 1)
    return unghost("push", source, "--dataset", dataset, "--config", file)


def versions(api, dataset):
    """The versions of a dataset's configuration, newest first; its active one."""
    items = api.json(f"/datasets/{dataset}/configs")["items"]
    return items, api.json(f"/datasets/{dataset}/config")


def test_push_creates_a_dataset_with_a_configuration(unghost, api, tmp_path):
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 25\nclasses: {bus: {size_big_box: 90}}\n")

    first = pushed(unghost, "push-config-new", file)
    again = pushed(unghost, "push-config-new", file)

    stored, active = versions(api, "push-config-new")
    assert (first.code, again.code) == (0, 0), first.err
    assert len(stored) == 1
    assert active["config"]["threshold_small_box"] == 25
    assert active["config"]["classes"] == {"bus": {"size_big_box": 90}}


def test_push_gives_its_configuration_to_a_dataset_without_frames(
    unghost, api, tmp_path
):
    dataset, file = api.dataset(), tmp_path / "boundingBox.yaml"
    file.write_text("sitting: {threshold_small_box: 25, cam_rgb: {3D: true}}")

    result = pushed(unghost, dataset, file)

    _, active = versions(api, dataset)
    assert result.code == 0, result.err
    assert f"configuration of {dataset}, which had no frames: " in result.err
    assert "keys that are not used: sitting.cam_rgb.3D" in result.err
    assert active["config"]["profile"] == "carlasimu"
    assert active["config"]["threshold_small_box"] == 25


def test_push_does_not_change_the_configuration_of_a_dataset_with_frames(
    unghost, api, tmp_path
):
    dataset, file = api.dataset_of_one_frame(), tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 25")
    before = versions(api, dataset)

    result = pushed(unghost, dataset, file)

    assert result.code == EXIT_REFUSED
    assert result.err == (
        f"unghost: dataset '{dataset}' has frames, and another configuration than "
        f"{file} (threshold_small_box: 10 -> 25); `unghost config set {dataset} "
        f"{file}` applies the file to every frame, and `unghost config diff "
        f"{dataset} --config {file}` counts which verdicts that changes\n"
    )
    assert versions(api, dataset) == before
    assert api.json(f"/datasets/{dataset}")["counts"]["frames"] == 1
    assert unghost("config", "set", dataset, file).code == 0
    assert pushed(unghost, dataset, file).code == 0


def test_push_puts_a_class_map_into_the_configuration_of_a_new_dataset(
    unghost, api, tmp_path
):
    """The file's own classes have priority; a repeated push finds nothing to change."""
    manifest = write_manifest(tmp_path / "frames", 1) / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"Caar"', 1))
    file = tmp_path / "filter.yaml"
    file.write_text("classes: {Caar: truck}")
    plain = ("push", manifest, "--class-map", "Caar=car,Misc=pass", "--dataset")

    first = unghost(*plain, "push-class-map")
    again = unghost(*plain, "push-class-map")
    both = unghost(*plain, "push-class-map-file", "--config", file)
    refused = unghost(*plain, api.dataset_of_one_frame())

    assert (first.code, again.code, both.code) == (0, 0, 0), first.err + both.err
    _, active = versions(api, "push-class-map")
    assert {
        name: row["measures_as"] for name, row in active["config"]["classes"].items()
    } == {"Caar": "car", "Misc": "pass"}
    _, active = versions(api, "push-class-map-file")
    assert active["config"]["classes"]["Caar"]["measures_as"] == "truck"
    assert refused.code == EXIT_REFUSED
    assert "differs from the description of the recording (classes." in refused.err
