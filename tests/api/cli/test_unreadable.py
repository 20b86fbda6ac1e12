"""Frames whose files cannot be read: the messages of `push` and `filter`."""

from tests.support.frames import write_manifest

EXIT_PARTLY = 3


def test_unreadable_frame_files_are_refused_with_a_clear_message(unghost, tmp_path):
    folder = write_manifest(tmp_path / "frames", 2)
    (folder / "seg" / "000001.png").unlink()
    with (folder / "manifest.jsonl").open("a") as manifest:
        manifest.write("{nothing\n")

    result = unghost("push", folder, "--dataset", "unreadable")
    again = unghost("filter", folder, "-o", "decisions.jsonl")

    assert (result.code, again.code) == (EXIT_PARTLY, EXIT_PARTLY)
    missing = folder / "seg" / "000001.png"
    assert f"refused: run/000001: {missing}: No such file or directory\n" in result.err
    for said in (result.err, again.err):
        assert "refused: manifest.jsonl, line 3: expected one JSON object" in said
        assert "Errno" not in said
