"""Which storage settings are accepted; no error message repeats a secret."""

import pytest
from pydantic import ValidationError

from app.addresses import bucket_of
from app.settings import Settings


@pytest.mark.parametrize(
    ("text", "bucket"),
    [
        ("folder", None),
        ("s3://pictures", ("pictures", "")),
        ("s3://pictures/", ("pictures", "")),
        ("s3://pic.tures-2/lab_7/unghost", ("pic.tures-2", "lab_7/unghost")),
    ],
)
def test_storage_setting_is_folder_or_an_s3_bucket(text, bucket):
    assert bucket_of(Settings(storage=text).storage) == bucket


@pytest.mark.parametrize(
    "text",
    [
        "s3",
        "s3://",
        "s3://Pictures",
        "s3://pictures/../other",
        "s3://pictures//twice",
        "s3://user:secret@pictures",
        "s3://pictures/a?b",
        "gs://pictures",
        "Folder",
    ],
)
def test_invalid_storage_setting_is_refused(text):
    with pytest.raises(ValidationError, match="expected folder, s3://BUCKET"):
        Settings(storage=text)


@pytest.mark.parametrize(
    ("address", "allow_http"),
    [
        ("https://s3.lab.example", False),
        ("https://10.0.0.7:9000", False),
        ("http://127.0.0.1:9000", False),
        ("http://[::1]:9000", False),
        ("http://localhost:9000/", False),
        ("http://10.0.0.7:9000", True),
    ],
)
def test_endpoint_with_tls_or_on_this_machine_or_as_allowed_is_accepted(
    address, allow_http
):
    settings = Settings(storage_endpoint=address, storage_allow_http=allow_http)

    assert settings.storage_endpoint == address.rstrip("/")
    if allow_http:
        with pytest.raises(ValidationError, match="UNGHOST_STORAGE_ALLOW_HTTP"):
            Settings(storage_endpoint=address)


@pytest.mark.parametrize(
    "address",
    [
        "https://ada:hunter2@s3.lab.example",
        "https://s3.lab.example/hunter2",
        "https://s3.lab.example?key=hunter2",
        "ftp://hunter2",
        "hunter2",
        "https://s3.lab.example:hunter2",
        "https://[hunter2",
    ],
)
def test_invalid_endpoint_is_refused_without_repeating_it(address, monkeypatch):
    monkeypatch.setenv("UNGHOST_STORAGE_ENDPOINT", address)

    with pytest.raises(ValidationError) as refused:
        Settings()

    (error,) = refused.value.errors(include_input=False)
    assert "AWS_ACCESS_KEY_ID" in error["msg"]
    assert "hunter2" not in error["msg"]
