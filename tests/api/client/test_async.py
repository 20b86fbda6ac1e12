"""The client whose calls are awaited: the same calls, errors and retries."""

import asyncio
import inspect

import pytest

from tests.support import frames
from tests.support.ports import reserved_port
from unghost import AsyncClient, Client, Conflict, NoResponse, NotFound, OutgoingFrame


@pytest.fixture
def awaited(server):
    """Runs a coroutine of an `AsyncClient`."""

    def run(use):
        async def main():
            async with AsyncClient(server.url, server.token) as client:
                return await use(client)

        return asyncio.run(main())

    return run


def test_it_has_the_methods_of_the_client():
    def methods(kind):
        public = (name for name in dir(kind) if not name.startswith("_"))
        return {name: inspect.getdoc(getattr(kind, name)) for name in public}

    assert methods(AsyncClient).keys() == methods(Client).keys()
    assert all(methods(AsyncClient).values())
    for name in ("push", "wait", "wait_for_export", "download", "events"):
        own, other = (
            inspect.signature(getattr(client, name)) for client in (AsyncClient, Client)
        )
        assert list(own.parameters) == list(other.parameters)


def test_frames_are_sent_read_and_listed(awaited, dataset):
    def files(number):
        return {"image": frames.image(number), "segmentation": frames.segmentation()}

    async def use(client):
        stored = await asyncio.gather(
            *(
                client.put_frame(
                    dataset, f"run/{number}", frames.annotation(), **files(number)
                )
                for number in range(4)
            )
        )
        listed = [box.id async for box in client.boxes(dataset, limit=3)]
        keys = [frame.key async for frame in client.frames(dataset)]
        columns = await client.boxes(dataset).columns(["box"])
        table = await client.boxes(dataset).to_arrow(["box"])
        return stored, listed, keys, columns, table

    stored, listed, keys, columns, table = awaited(use)
    assert [frame.created for frame in stored] == [True] * 4
    assert listed == columns["box"] == table["box"].to_pylist() == ["real", "ghost"] * 4
    assert keys == [f"run/{number}" for number in range(4)]


def test_jobs_files_and_pushes_are_followed(awaited, dataset, tmp_path):
    sent = [
        OutgoingFrame(
            f"push/{number}", frames.annotation(), {"image": frames.image(number)}
        )
        for number in range(3)
    ]
    counted: list[int] = []

    async def use(client):
        outcomes = [
            outcome
            async for outcome in client.push(dataset, sent, progress=counted.append)
        ]
        run = await client.wait(await client.set_config(dataset, {"profile": "paper"}))
        states = [event.state async for event in client.events(run)]
        export = await client.wait_for_export(
            await client.start_export(dataset, "yolo")
        )
        file = await client.download(export, tmp_path / "labels.zip")
        return outcomes, run, states, file

    outcomes, run, states, file = awaited(use)
    assert sorted(outcome.key for outcome in outcomes) == [frame.key for frame in sent]
    assert counted == [1, 2, 3]
    assert (run.state, states[-1]) == ("done", "done")
    assert file.read_bytes()[:2] == b"PK"


def test_errors_are_those_of_the_client(awaited, dataset):
    async def use(client):
        existing = await client.create_dataset(dataset, exist_ok=True, classes=["van"])
        with pytest.raises(Conflict):
            await client.create_dataset(dataset)
        with pytest.raises(NotFound):
            await client.dataset("nowhere")
        with pytest.raises(NotFound):
            [box async for box in client.boxes("nowhere")]
        return existing, await client.ready()

    existing, ready = awaited(use)
    assert (existing.classes, ready) == (("car",), True)


def test_it_waits_for_a_server_that_is_away():
    async def use(url):
        async with AsyncClient(url, "token", retry_for=0.3) as client:
            assert not await client.ready()
            await client.version()

    with reserved_port() as port:
        url = f"http://127.0.0.1:{port}"
        with pytest.raises(NoResponse, match=r"gave up after") as refused:
            asyncio.run(use(url))
    assert refused.value.address == url
