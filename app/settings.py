"""The settings of a deployment: ``UNGHOST_*`` variables, fixed once the service starts.

Thresholds are no settings: they are in filter configurations.
"""

from __future__ import annotations

import os
import re
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, ByteSize, Field, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from app.addresses import (
    FOLDER,
    LOCAL_ENGINE,
    checked_endpoint,
    checked_engine,
    checked_storage,
    checked_url,
)

LOOPBACK_HOSTS: Final = ("localhost", "127.0.0.1", "[::1]")
ANY_HOST: Final = "*"
_HOST_NAME: Final = re.compile(r"[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]")
_ALL_INTERFACES: Final = ("", "0.0.0.0", "::")

LogLevel = Literal["debug", "info", "warning", "error"]
LogFormat = Literal["auto", "json", "text"]


class Settings(BaseSettings):
    """Where the service stores its data, how it is reached, and its limits."""

    model_config = SettingsConfigDict(
        env_prefix="UNGHOST_",
        frozen=True,
        extra="forbid",
        env_ignore_empty=True,
        hide_input_in_errors=True,
        use_attribute_docstrings=True,
    )

    data: Path = Path("unghost-data")
    """Folder of the database, the stored files and the first token."""
    config: Path | None = None
    """A filter.yaml: the first configuration of every new dataset."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 listens on every interface."""
    port: int = Field(8000, ge=0, le=65535)
    """Port to listen on; 0: any free one."""
    database_url: Annotated[str, AfterValidator(checked_url)] | None = Field(
        None, repr=False
    )
    """postgresql://USER:PASSWORD@HOST:5432/DATABASE; unset: SQLite in the data
    folder."""
    storage: Annotated[str, AfterValidator(checked_storage)] = FOLDER
    """Where files are stored: folder (in the data folder), or s3://BUCKET/PREFIX."""
    storage_allow_http: bool = False
    """Whether the endpoint may be on another machine without TLS: files then cross the
    network unencrypted."""
    storage_endpoint: str | None = None
    """https://HOST:PORT of an S3-compatible server; unset: Amazon's."""
    storage_region: str | None = Field(None, pattern=r"^[a-z0-9-]{1,40}$")
    """Region of the bucket; unset: AWS_REGION, else us-east-1."""
    storage_timeout_s: float = Field(30, gt=0, le=600)
    """Seconds that one request to S3 may take, and for which a failed one is
    retried."""
    allowed_hosts: Annotated[tuple[str, ...], NoDecode] = ()
    """Host names that requests may use, separated by commas, in addition to localhost
    and the address it listens on; * allows any."""
    trusted_proxies: Annotated[tuple[str, ...], NoDecode] = ()
    """Addresses or networks, separated by commas, of proxies whose X-Forwarded-For and
    X-Forwarded-Proto are trusted."""
    hook_hosts: Annotated[tuple[str, ...], NoDecode] = ()
    """Hosts to which hooks may be sent, separated by commas, each with or without a
    port: names or literal addresses; unset: none."""
    log_level: LogLevel = "info"
    """debug, info, warning or error."""
    log_format: LogFormat = "auto"
    """json: a line of JSON per record; text; auto: text on a terminal, JSON
    elsewhere."""
    workers: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1, le=256)
    """Number of processes that read images, and of threads that wait for them; by
    default the number of cores."""
    engine_insecure: bool = False
    """Whether UNGHOST_ENGINE may be a tcp:// address of another machine: anyone who can
    connect to it can run code on every worker."""
    engine: str = LOCAL_ENGINE
    """Where runs and exports are executed: local (in this process), or tls://HOST:8786,
    a scheduler whose workers execute them."""
    tls_ca: Path | None = None
    """Certificate of the authority that signed the certificates of all nodes."""
    tls_cert: Path | None = None
    """Certificate of this node."""
    tls_key: Path | None = None
    """Private key of UNGHOST_TLS_CERT."""
    session_hours: int = Field(720, ge=1, le=8784)
    """Hours after which a browser must log in again."""
    min_free_bytes: ByteSize = Field(ByteSize(256 * 1024**2), ge=0)
    """Free disk space below which the service reports that it is not ready, and refuses
    frames, exports, bulk answers, new datasets and configurations; below a quarter of
    it, answers on single boxes, too."""
    shutdown_wait_s: float = Field(20, ge=0, le=3600)
    """Seconds that open requests have to finish when the service stops."""
    export_days: int | None = Field(None, ge=1, le=36_500)
    """Days after which the file of an export is deleted; unset: never."""
    max_export_bytes: ByteSize | None = Field(None, ge=1024)
    """Maximum size of the files of all exports together: those of the oldest are
    deleted, but never the newest; unset: a quarter of the disk, in a bucket no
    limit."""
    idempotency_hours: int = Field(72, ge=1, le=8784)
    """Hours for which the response to an Idempotency-Key is kept."""

    max_connections: int | None = Field(None, ge=1)
    """Maximum number of open connections; unset: as many as the limit of open files
    allows, at most 2048."""
    max_head_bytes: ByteSize = Field(ByteSize(64 * 1024), ge=1024)
    """Largest head of a request: its address and its headers."""
    head_wait_s: float = Field(20, gt=0)
    """Seconds within which the head of a request has to arrive."""
    body_wait_s: float = Field(300, gt=0)
    """Seconds without a byte of the body after which a request is refused; JSON has to
    arrive as a whole within them."""
    answer_wait_s: float = Field(60, gt=0)
    """Seconds without reading any of its response after which a client is
    disconnected."""
    max_body_bytes: ByteSize = Field(ByteSize(256 * 1024**2), ge=1024)
    """Largest body of a request, other than a batch of frames."""
    max_json_bytes: ByteSize = Field(ByteSize(16 * 1024**2), ge=1024)
    """Largest JSON body of a request, and largest annotation."""
    max_batch_bytes: ByteSize = Field(ByteSize(64 * 1024**3), ge=1024)
    """Largest batch of frames; it is streamed, never held in memory."""
    max_open_body_bytes: ByteSize = Field(ByteSize(1024**3), ge=1024)
    """Maximum memory for the bodies of all requests that are received or processed."""
    max_part_bytes: ByteSize = Field(ByteSize(64 * 1024**2), ge=1024)
    """Largest file of a frame."""
    max_parts: int = Field(16, ge=3, le=1000)
    """Maximum number of parts of an upload."""
    max_batch_members: int = Field(1_000_000, ge=1)
    """Maximum number of members in the archive of a batch."""
    max_open_batches: int = Field(8, ge=1)
    """Maximum number of batches of frames and dropped folders that are received at the
    same time."""
    max_folder_bytes: ByteSize = Field(ByteSize(256 * 1024**2), ge=1024)
    """Largest archive that the page sends of a dropped folder: file names, text files,
    and some images."""
    max_folder_files: int = Field(100_000, ge=1)
    """Maximum number of files and folders in a dropped folder."""
    max_folder_seconds: float = Field(120, gt=0, le=3600)
    """Seconds that reading a dropped folder may take."""
    max_image_side_px: int = Field(16384, ge=1)
    """Longest side of an image."""
    max_image_pixels: int = Field(64_000_000, ge=1)
    """Maximum number of pixels of an image."""
    max_pixel_seconds: float = Field(30, gt=0, le=3600)
    """Seconds that reading the images of one frame, or drawing one, may take."""
    max_pixel_memory_bytes: ByteSize = Field(ByteSize(2 * 1024**3), ge=64 * 1024**2)
    """Memory that reading the images of one frame, drawing one, or reading a dropped
    folder may take."""
    max_boxes_per_frame: int = Field(10_000, ge=1, le=1 << 16)  # numbers of two bytes
    """Maximum number of boxes in an annotation, at most 65536."""
    max_config_bytes: ByteSize = Field(ByteSize(1024**2), ge=1024)
    """Largest filter configuration, as JSON or YAML."""
    max_bulk_boxes: int = Field(100_000, ge=1)
    """Maximum number of boxes that one bulk answer may change."""
    max_answers_per_box: int = Field(1_000, ge=1)
    """Maximum number of answers of one person on one box, those that undo another one
    included."""
    max_open_runs: int = Field(100, ge=1)
    """Maximum number of runs and exports that are queued or running."""
    max_event_streams: int = Field(64, ge=1)
    """Maximum number of open progress streams."""
    event_heartbeat_s: float = Field(15, gt=0)
    """Seconds of silence after which a progress stream sends a heartbeat."""

    @field_validator("allowed_hosts", "trusted_proxies", "hook_hosts", mode="before")
    @classmethod
    def _split_hosts(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(name.strip() for name in value.split(",") if name.strip())
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _check_proxies(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Refuse entries that can match no address of a proxy."""
        if ANY_HOST in value and len(value) > 1:
            raise ValueError(
                f"expected addresses and networks, or {ANY_HOST} alone, "
                f"found {ANY_HOST} together with others"
            )
        for each in set(value) - {ANY_HOST}:
            try:
                network = ip_network(each, strict=False)
            except ValueError:
                raise ValueError(
                    "expected an address or a network such as 10.0.0.0/8, "
                    f"found {each[:60]!r}"
                ) from None
            address = each.partition("/")[0]
            if ip_address(address) != network.network_address:
                raise ValueError(
                    f"expected {str(network)!r}, if the whole network is meant, or "
                    f"{address!r}, if one address is, found {each[:60]!r}"
                )
        return value

    @field_validator("allowed_hosts")
    @classmethod
    def _check_hosts(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Refuse names that no Host header can contain."""
        for each in value:
            if each != ANY_HOST and not _HOST_NAME.fullmatch(each):
                raise ValueError(
                    "expected names without scheme and port, such as "
                    f"boxes.example.org or [fd00::1], or {ANY_HOST}, "
                    f"found {each[:60]!r}"
                )
        return value

    @field_validator("hook_hosts")
    @classmethod
    def _check_hook_hosts(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Refuse what is no host; names are compared in lower case."""
        for each in value:
            name = re.sub(r":[0-9]{1,5}$", "", each)
            if not _HOST_NAME.fullmatch(name):
                raise ValueError(
                    "expected hosts without a scheme, such as ci.example.org, "
                    f"10.0.0.7:8080 or [fd00::1], found {each[:60]!r}"
                )
        return tuple(each.lower() for each in value)

    @field_validator("storage_endpoint")
    @classmethod
    def _check_endpoint(cls, value: str | None, info: ValidationInfo) -> str | None:
        plain = bool(info.data.get("storage_allow_http"))
        return None if value is None else checked_endpoint(value, plain=plain)

    @field_validator("engine")
    @classmethod
    def _check_engine(cls, value: str, info: ValidationInfo) -> str:
        return checked_engine(value, insecure=bool(info.data.get("engine_insecure")))

    @field_validator("log_level", "log_format", mode="before")
    @classmethod
    def _lower(cls, value: object) -> object:
        return value.lower() if isinstance(value, str) else value

    @property
    def sqlalchemy_url(self) -> str:
        """Where the database is: `database_url`, else SQLite in the data folder."""
        return self.database_url or f"sqlite:///{self.data.resolve()}/unghost.db"

    @property
    def token_file(self) -> Path:
        """File of the first token in plain text, readable by its owner alone."""
        return self.data / "token"

    @property
    def served_hosts(self) -> frozenset[str]:
        """The names allowed in a Host header, without a port; ``*`` for any."""
        own = () if self.host in _ALL_INTERFACES else (bracketed(self.host),)
        names = (*LOOPBACK_HOSTS, *own, *self.allowed_hosts)
        return frozenset(name.lower() for name in names)


def bracketed(host: str) -> str:
    """A host as it is written in a URL: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host
