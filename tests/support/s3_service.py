"""Starts a service that stores its files in an S3 bucket behind a gate."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.api import Api
from tests.support.command_line import CommandLine
from tests.support.s3_server import Gate, S3Server, TestBucket, gate
from tests.support.servers import RunningServer, running_server

PATIENCE_S = "10"


@dataclass(frozen=True)
class S3Service:
    """A server, a client of it, its bucket, and the gate between server and bucket."""

    server: RunningServer
    api: Api
    bucket: TestBucket
    gate: Gate
    command: CommandLine


@contextmanager
def served_on_s3(folder: Path, s3: S3Server, **settings: str) -> Iterator[S3Service]:
    """Start a server with a new bucket; it waits ten seconds for the store."""
    data, bucket = folder / "data", s3.bucket()
    with gate(bucket.url) as way:
        through = bucket.behind(way.url, storage_timeout_s=PATIENCE_S)
        chosen = {**through.environment, **settings}
        with running_server(data, chosen) as server:
            api = Api.at(server.url, server.headers)
            command = CommandLine(folder, {"UNGHOST_DATA": str(data), **chosen})
            with api.http:
                yield S3Service(server, api, bucket, way, command)
