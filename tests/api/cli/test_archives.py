"""Archives as the source of commands: the same as the folder, and hostile ones."""

import io
import json
import shutil
import signal
import stat
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile, ZipInfo

import pytest

from tests.support.command_line import CommandLine
from tests.support.folders import write_files
from tests.support.frames import write_manifest
from tests.support.waiting import until

DONE, REFUSED, USAGE, INTERRUPTED = 0, 1, 2, 130
FORMS = {".zip": "zip", ".tar": "tar", ".tar.gz": "gztar", ".tar.xz": "xztar"}


@pytest.fixture
def temporary(tmp_path):
    folder = tmp_path / "temporary"
    folder.mkdir()
    return folder


@pytest.fixture
def here(tmp_path, temporary):
    """The command line, with a folder of its own for temporary files."""
    return CommandLine(tmp_path, {"TMPDIR": str(temporary)})


def archive_of(folder: Path, suffix: str, *, with_top: bool) -> Path:
    """A real archive beside the folder, of the folder itself or of its content."""
    made = shutil.make_archive(
        str(folder),
        FORMS[suffix],
        root_dir=folder.parent if with_top else folder,
        base_dir=folder.name if with_top else None,
    )
    return Path(made)


def tar_of(path: Path, *members: tuple[tarfile.TarInfo, bytes]) -> Path:
    with tarfile.open(path, "w") as archive:
        for member, content in members:
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return path


def member(name: str, kind: bytes = tarfile.REGTYPE, target: str = ""):
    made = tarfile.TarInfo(name)
    made.type, made.linkname = kind, target
    return made


@pytest.mark.parametrize(
    ("suffix", "with_top"), [*zip(FORMS, (True, False) * 2, strict=True)]
)
def test_archive_gives_the_verdicts_of_its_folder(
    here, tmp_path, temporary, suffix, with_top
):
    folder = write_manifest(tmp_path / "town", 3)
    (folder / "recording.yaml").write_text("classes: {car: pass}\n")
    archive = archive_of(folder, suffix, with_top=with_top)

    result = here("filter", archive)

    assert result.code == DONE, result.err
    assert f"unpack {archive.name}: " in result.err
    assert result.records == here("filter", folder).records
    assert result.records[0]["decisions"][0]["reason"] == "passed"
    assert list(temporary.iterdir()) == []


def test_other_commands_read_archives_and_name_them(here, tmp_path, temporary):
    folder = write_manifest(tmp_path / "town", 3)
    archive = archive_of(folder, ".tar.gz", with_top=True)
    lines = [
        json.dumps({"key": f"run/{n:06}", "id": name, "visible": name == "real"})
        for n in range(3)
        for name in ("real", "ghost")
    ]
    (tmp_path / "truth.jsonl").write_text("\n".join(lines))
    evaluation = ("--truth", "truth.jsonl", "--json")

    of_archive = here("inspect", archive, "--json", "--write", "as_archive.yaml")
    of_folder = here("inspect", folder, "--json", "--write", "as_folder.yaml")
    evaluated = here("evaluate", archive, *evaluation)
    for source in (folder, archive):
        converted = here("convert", source, "--to", "yolo", "-o", f"{source.name}-out")
        assert converted.code == DONE, converted.err

    (record,), (expected,) = of_archive.records, of_folder.records
    assert record == expected | {
        "name": "town.tar.gz",
        "description": expected["description"].replace("town", "town.tar.gz"),
    }
    assert (tmp_path / "as_archive.yaml").read_text() == record["description"]
    assert evaluated.code == DONE, evaluated.err
    assert evaluated.records == here("evaluate", folder, *evaluation).records
    written, expected = tmp_path / "town.tar.gz-out", tmp_path / "town-out"
    files = sorted(path.relative_to(expected) for path in expected.rglob("*.*"))
    assert len(files) > 3
    for file in files:
        content = (expected / file).read_bytes()
        if file.name == "manifest.json":
            content = content.replace(b'"town"', b'"town.tar.gz"')
        assert (written / file).read_bytes() == content
    assert list(temporary.iterdir()) == []


def test_push_uploads_an_archive_but_no_file_outside_of_it(unghost, tmp_path):
    folder = write_manifest(tmp_path / "town", 2)
    secret = tmp_path / "secret.png"
    shutil.copy(folder / "rgb/000001.png", secret)
    manifest = folder / "manifest.jsonl"
    text = manifest.read_text()
    manifest.write_text(text.replace("rgb/000001.png", str(secret)))
    archive = archive_of(folder, ".zip", with_top=True)

    result = unghost("push", archive, "--dataset", "archive", "--json")

    assert result.code == 3
    outcomes = {record.get("key"): record for record in result.records}
    assert outcomes["run/000000"]["outcome"] == "stored"
    assert "--outside-files" in outcomes["run/000001"]["error"]["detail"]
    allowed = unghost("push", archive, "--dataset", "archive", "--outside-files")
    assert allowed.code == DONE, allowed.err


def test_links_inside_of_an_archive_are_kept(here, tmp_path):
    folder = write_manifest(tmp_path / "town", 2)
    (folder / "rgb").rename(folder / "pictures")
    (folder / "rgb").symlink_to("../town/pictures")
    (folder / "seg/000001.png").unlink()
    (folder / "seg/000001.png").hardlink_to(folder / "seg/000000.png")
    (folder / "nowhere.png").symlink_to("missing.png")
    archive = archive_of(folder, ".tar", with_top=True)
    with ZipFile(tmp_path / "linked.zip", "w") as linked:
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder.parent).as_posix()
            if path.is_symlink():
                info = ZipInfo(name)
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
                linked.writestr(info, str(path.readlink()))
            elif path.is_file():
                linked.write(path, name)

    expected = here("filter", folder)
    for source in (archive, tmp_path / "linked.zip"):
        result = here("filter", source)
        assert (result.code, result.out) == (DONE, expected.out), result.err


HOSTILE = {
    "../x.png": member("../x.png"),
    "/x.png": member("/x.png"),
    "a link out": member("town/seg", tarfile.SYMTYPE, "../../../private"),
    "an absolute link": member("town/seg", tarfile.SYMTYPE, "/etc"),
    "a hard link out": member("town/seg.png", tarfile.LNKTYPE, "../../private/mine"),
    "a device": member("town/null", tarfile.CHRTYPE),
    "a pipe": member("town/pipe", tarfile.FIFOTYPE),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_member_that_leads_out_is_refused(here, tmp_path, temporary, name):
    hostile = HOSTILE[name]
    archive = tar_of(tmp_path / "town.tar", (hostile, b""))

    result = here("filter", archive)

    assert result.code == REFUSED
    assert result.err.startswith("unghost: town.tar: expected ")
    assert (hostile.linkname if hostile.islnk() else hostile.name) in result.err
    assert "; make " in result.err
    assert list(temporary.iterdir()) == []


def test_nothing_is_written_through_a_link(here, tmp_path, temporary):
    private = tmp_path / "private"
    private.mkdir()
    archive = tar_of(
        tmp_path / "town.tar",
        (member("seg", tarfile.SYMTYPE, str(private)), b""),
        (member("seg/x.png"), b"written"),
    )

    result = here("filter", archive)

    assert result.code == REFUSED
    assert result.err.startswith("unghost: town.tar: cannot be unpacked: seg: ")
    assert list(private.iterdir()) == list(temporary.iterdir()) == []


def test_members_of_a_zip_that_lead_out_are_refused(here, tmp_path, temporary):
    for name, mode in (
        ("../x", 0),
        ("/x", 0),
        ("x", stat.S_IFLNK),
        ("x", stat.S_IFIFO),
    ):
        info = ZipInfo(name)
        info.external_attr = (mode | 0o600) << 16
        with ZipFile(tmp_path / "town.zip", "w") as archive:
            archive.writestr(info, "../../private")

        result = here("filter", "town.zip")

        assert result.code == REFUSED
        assert result.err.startswith("unghost: town.zip: expected ")
        assert f'"{name}"' in result.err
        assert list(temporary.iterdir()) == []


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def at_a_member(content: bytes) -> bytes:
    """Cut where a member begins, where the end is easily taken for that of all."""
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        return content[: archive.getmembers()[-1].offset]


def with_fault_in_a_header(content: bytes) -> bytes:
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        offset = archive.getmembers()[-1].offset
    return content[:offset] + b"?" + content[offset + 1 :]


def with_fault_in_a_file(content: bytes) -> bytes:
    at = content.index(b"IDAT")
    return content[:at] + b"????" + content[at + 4 :]


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [
        (".zip", cut),
        (".zip", with_fault_in_a_file),
        (".tar", cut),
        (".tar", at_a_member),
        (".tar", with_fault_in_a_header),
        (".tar.gz", cut),
        (".tar.xz", cut),
        (".tar", lambda content: b""),
        (".tar.gz", lambda content: b"no archive at all"),
    ],
)
def test_damaged_archive_is_refused(
    here, tmp_path, temporary, suffix, damage: Callable[[bytes], bytes]
):
    folder = write_manifest(tmp_path / "town", 3)
    if suffix == ".zip":
        archive = tmp_path / "town.zip"
        with ZipFile(archive, "w") as stored:
            for path in folder.rglob("*.*"):
                stored.write(path, path.relative_to(folder))
    else:
        archive = archive_of(folder, suffix, with_top=True)
    archive.write_bytes(damage(archive.read_bytes()))

    result = here("filter", archive)

    assert (result.code, result.out) == (REFUSED, "")
    said = f"unghost: {archive.name}: expected an archive, found a fault: "
    assert said in result.err
    assert "; copy it again" in result.err
    assert "Traceback" not in result.err
    assert list(temporary.iterdir()) == []


def test_encrypted_zip_is_refused(here, tmp_path, temporary):
    with ZipFile(tmp_path / "town.zip", "w") as archive:
        archive.writestr("manifest.jsonl", "{}")
    content = bytearray((tmp_path / "town.zip").read_bytes())
    content[6] |= 1  # the flags of the file
    content[content.index(b"PK\x01\x02") + 8] |= 1  # and of its entry in the list
    (tmp_path / "town.zip").write_bytes(content)

    result = here("filter", "town.zip")

    assert result.code == REFUSED
    assert result.err == (
        "unghost: town.zip: is encrypted; unpack it with its password, and give the "
        "folder\n"
    )
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
def test_archive_that_would_not_fit_on_the_disk_is_refused(
    here, tmp_path, temporary, suffix
):
    """Its list of members says so; nothing that large is in it."""
    archive = tmp_path / f"town{suffix}"
    if suffix == ".zip":
        with ZipFile(archive, "w") as opened:
            opened.writestr("manifest.jsonl", "{}")
            opened.infolist()[0].file_size = 1 << 60
    else:
        large = member("manifest.jsonl")
        large.size = 1 << 60
        archive.write_bytes(large.tobuf() + b"{}")

    result = here("filter", archive)

    assert result.code == REFUSED
    assert f"{archive.name}: does not fit unpacked on the disk of {temporary}" in (
        result.err
    )
    assert "TMPDIR" in result.err
    assert list(temporary.iterdir()) == []


def test_interrupted_command_removes_what_it_unpacked(here, tmp_path, temporary):
    folder = write_manifest(tmp_path / "town", 1)
    manifest = folder / "manifest.jsonl"
    manifest.write_text(manifest.read_text() * 20_000)
    archive = archive_of(folder, ".zip", with_top=True)

    with here.running("filter", archive, "-o", "out/all.jsonl") as process:
        until(lambda: any(part.stat().st_size for part in tmp_path.glob("out/*.part")))
        assert list(temporary.iterdir()) != []
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)

    assert process.returncode == INTERRUPTED
    assert "interrupted; out/all.jsonl was not written" in err
    assert list(temporary.iterdir()) == list((tmp_path / "out").iterdir()) == []


def test_output_does_not_replace_the_archive(here, tmp_path):
    archive = archive_of(write_manifest(tmp_path / "town", 1), ".zip", with_top=True)
    content = archive.read_bytes()

    result = here("filter", archive, "-o", archive)

    assert result.code == USAGE
    assert "is the source itself" in result.err
    assert archive.read_bytes() == content


def test_junk_of_macos_beside_the_folder_is_passed_over(here, tmp_path):
    folder = write_manifest(tmp_path / "town", 1)
    write_files(tmp_path, {"__MACOSX/town/._manifest.jsonl": "x", ".DS_Store": "x"})
    names = ("town", "__MACOSX", ".DS_Store")
    subprocess.run(["tar", "-czf", "town.tgz", *names], cwd=tmp_path, check=True)

    result = here("filter", "town.tgz")

    assert (result.code, result.out) == (DONE, here("filter", folder).out)
