"""A service that cannot use its bucket says at the start which bucket and why."""

import sys

import pytest

from app.maintenance.datafolder import CannotMaintain
from tests.support import frames as scene
from tests.support.command_line import CommandLine
from tests.support.data_folders import doctor_findings
from tests.support.s3_server import TestBucket, server_answering_with
from tests.support.services import running_services

SECRET, TOKEN = "never-to-be-seen", "a-session-that-nobody-sees"


def refusal(folder, bucket, **chosen):
    settings = {**bucket.settings, "storage_timeout_s": 10, **chosen}
    with pytest.raises(CannotMaintain) as refused, running_services(folder, **settings):
        pass
    return str(refused.value)


def test_missing_bucket_or_unreachable_server_is_reported_at_start(tmp_path, s3):
    missing = refusal(tmp_path / "data", TestBucket(s3.url, "no-such-bucket"))
    away = refusal(tmp_path / "data", TestBucket("http://127.0.0.1:1", "pictures"))

    place = f"the bucket 'no-such-bucket' at {s3.url}"
    assert missing.startswith(f"{place} cannot be used: ")
    assert "there is no such bucket" in missing
    assert "'pictures' at http://127.0.0.1:1" in away
    assert "it does not respond" in away


@pytest.mark.parametrize("status", [pytest.param(500, marks=pytest.mark.long), 503])
def test_storage_server_error_is_reported_at_start(tmp_path, s3, status):
    with server_answering_with(lambda _: (status, "")) as url:
        said = refusal(tmp_path / "data", TestBucket(url, "pictures"))

    assert "it does not respond" in said


def test_refused_credentials_are_reported_without_showing_secrets(tmp_path):
    """Not even by quoting the store, whose refusal repeats the request's headers."""

    def echo_headers(headers):
        told = "".join(f"{name}:{value}\n" for name, value in headers.items())
        return 403, (
            "<Error><Code>SignatureDoesNotMatch</Code><CanonicalRequest>"
            f"{told}</CanonicalRequest></Error>"
        )

    with server_answering_with(echo_headers) as url:
        bucket = TestBucket(url, "pictures")
        unghost = CommandLine(
            tmp_path,
            {
                **bucket.environment,
                "UNGHOST_DATA": str(tmp_path / "data"),
                "AWS_SECRET_ACCESS_KEY": SECRET,
                "AWS_SESSION_TOKEN": TOKEN,
            },
        )
        served = unghost("serve", "--port", "0")
        doctor = unghost("doctor")

    assert served.code == 1
    assert "the credentials are refused (SignatureDoesNotMatch)" in served.err
    assert f"'pictures' at {url}" in served.err
    said = served.err + served.out + doctor.out + doctor.err
    assert (SECRET in said, TOKEN in said, "x-amz" in said) == (False, False, False)


def test_missing_s3_library_is_reported_with_its_install_command(
    tmp_path, s3, monkeypatch
):
    bucket = s3.bucket()
    monkeypatch.delitem(sys.modules, "app.storage.s3", raising=False)
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    monkeypatch.setitem(sys.modules, "obstore.exceptions", None)

    said = refusal(tmp_path / "data", bucket)

    assert "pip install 'unghost[s3]'" in said


def test_start_with_a_bucket_without_the_stored_files_is_refused(tmp_path, s3):
    with running_services(tmp_path / "data") as services:
        services.dataset().put("k", scene.annotation(), image=scene.image())
    bucket = s3.bucket()

    said = refusal(tmp_path / "data", bucket)
    for file in (tmp_path / "data" / "blobs").glob("??/*"):
        bucket.overwrite(file.name, file.read_bytes())

    assert f"none is in s3://{bucket.name}/{bucket.prefix}: copy them there" in said
    with running_services(tmp_path / "data", **bucket.settings):
        assert doctor_findings(tmp_path / "data", **bucket.settings) == {}


@pytest.mark.sqlite_files("databases of a server are copies of one with all tables")
def test_new_database_with_a_bucket_of_another_database_is_refused(tmp_path, s3):
    """It would treat all files that it does not know as garbage, and remove them."""
    bucket = s3.bucket()
    with running_services(tmp_path / "one", **bucket.settings) as services:
        services.context.storage.put({"0" * 64: b"any"})

    said = refusal(tmp_path / "two", bucket)

    assert "the database is new" in said
    with running_services(tmp_path / "one", **bucket.settings) as services:
        assert len(list(services.context.storage.files())) == 1
