"""A cluster on loopback gives the same results as one process.

Its ports accept only clients with a certificate of the cluster's authority.
"""

import socket
import ssl
import time

import pytest

from app.engine.certificates import make_certificates
from tests.support import frames as scene
from tests.support.cluster import (
    PATIENCE_S,
    kill_working_process,
    listening,
    working_process,
)
from tests.support.command_line import CommandLine
from tests.support.run_results import (
    check_run_results,
    get_run,
    start_run,
    wait_for_run_end,
)
from tests.support.sensors import ANNOTATION, sensors
from tests.support.slow_datasets import FROM_PIXELS, OTHER_PIXELS, create_slow_dataset
from tests.support.waiting import until

FRAMES = 45
"""More than two chunks: one waits while both workers measure."""
AT_ONCE_S = 10
"""Longer than even a busy machine needs to answer a request that does no work."""
EXIT_UNREACHABLE = 69


@pytest.fixture(scope="module")
def long_street(running_cluster):
    """Frames that take some 20 ms each to measure."""
    return create_slow_dataset(running_cluster.api, FRAMES)


def export_dataset(api, dataset):
    """Export a dataset in two formats.

    Gives the hashes of both archives, and the address of the first one.
    """
    exports = [
        api.wait_for_job(api.post(f"/datasets/{dataset}/exports", {"format": form}))
        for form in ("decisions-jsonl", "yolo")
    ]
    assert [export["state"] for export in exports] == ["done", "done"], exports
    return [export["sha256"] for export in exports], exports[0]["download"]


def test_cluster_exports_are_byte_identical_to_those_of_a_single_process(
    running_cluster,
):
    dataset = running_cluster.api.dataset()
    for number in range(25):
        files = {
            "image": scene.image(number),
            "segmentation": scene.segmentation(number % 9),
        }
        running_cluster.api.upload_frame(
            dataset, f"{number:02}", scene.annotation(), **files
        )
    run = running_cluster.api.run(dataset, {**FROM_PIXELS, "threshold_small_box": 30})
    by_workers, download = export_dataset(running_cluster.api, dataset)
    before = running_cluster.api.json(f"/datasets/{dataset}/stats")

    with running_cluster.cluster.server(UNGHOST_ENGINE="local") as (_, alone):
        by_itself, _ = export_dataset(alone, dataset)
        # Measured once more by this server: a difference would change the statistics.
        again = alone.run(dataset, {**OTHER_PIXELS[3], "threshold_small_box": 30})
        back = alone.run(dataset, {**FROM_PIXELS, "threshold_small_box": 30})
        after = alone.json(f"/datasets/{dataset}/stats")

    assert by_workers == by_itself
    assert {job["state"] for job in (run, again, back)} == {"done"}
    assert (run["done"], back["counts"]) == (25, run["counts"])
    assert after == {**before, "run": back["id"]}
    assert running_cluster.api.http.get(download).status_code == 200


@pytest.mark.long
def test_channel_evaluation_by_workers_equals_the_local_evaluation(running_cluster):
    def evaluate_channels(api):
        dataset = api.dataset()
        for number in range(25):
            api.upload_frame(dataset, f"{number:02}", ANNOTATION, **sensors())
        run = api.wait_for_job(api.post(f"/datasets/{dataset}/evaluations"))
        assert (run["kind"], run["state"], run["done"]) == ("measure", "done", 25), run
        evaluation = api.json(f"/datasets/{dataset}/evaluations")
        # The worst boxes are named by ids, which differ between the two datasets.
        return [
            {**scores, "worst": len(scores["worst"])}
            for scores in of_channels(evaluation)
        ]

    def of_channels(evaluation):
        assert evaluation["not_measured"] == []
        return evaluation["channels"].values()

    before = frames_measured_by_the_server(running_cluster.api)
    by_workers = evaluate_channels(running_cluster.api)
    uploaded = frames_measured_by_the_server(running_cluster.api) - before
    with running_cluster.cluster.server(UNGHOST_ENGINE="local") as (_, alone):
        by_itself = evaluate_channels(alone)

    assert by_workers == by_itself
    assert uploaded == 25
    assert {run["judged"] for run in by_workers} == {0, 50}


def test_server_of_a_cluster_does_not_measure_frames_of_a_run(
    running_cluster, long_street
):
    before = frames_measured_by_the_server(running_cluster.api)

    run = running_cluster.api.run(long_street, OTHER_PIXELS[2])

    check_run_results(running_cluster.api, long_street, run, FRAMES)
    assert frames_measured_by_the_server(running_cluster.api) == before


def frames_measured_by_the_server(api):
    """How many frames the server's own process has measured, from its metrics."""
    lines = api.http.get("/metrics").text.splitlines()
    (line,) = [
        line for line in lines if line.startswith("unghost_measure_seconds_count")
    ]
    return float(line.split()[-1])


def test_run_completes_after_a_worker_process_is_killed(running_cluster, long_street):
    run_id = start_run(running_cluster.api, long_street)

    killed = kill_working_process(running_cluster.workers[0])

    check_run_results(
        running_cluster.api,
        long_street,
        wait_for_run_end(running_cluster.api, run_id),
        FRAMES,
    )
    # The worker has started another process in its place.
    running_cluster.workers[0].wait_for_log("starting another")
    until(lambda: has_joined(running_cluster.workers[0]), "no other process")
    assert working_process(running_cluster.workers[0]) != killed
    assert running_cluster.workers[0].log_text.count("starting another") == 1


def test_cancelled_run_stops_measuring_within_a_second(running_cluster, long_street):
    for config in OTHER_PIXELS[3:]:
        run_id = start_run(running_cluster.api, long_street, config, activate=False)
        begun = time.monotonic()
        response = running_cluster.api.post(f"/runs/{run_id}/cancel")
        took_s = time.monotonic() - begun
        if response.status_code == 202:  # otherwise it was over before
            break
    done = get_run(running_cluster.api, run_id)["done"]
    time.sleep(1)

    assert response.status_code == 202, response.text
    assert response.json()["state"] == "cancelled"
    assert took_s < AT_ONCE_S
    assert get_run(running_cluster.api, run_id)["done"] == done < FRAMES
    # The next run measures the rest, and all frames are decided.
    check_run_results(
        running_cluster.api,
        long_street,
        running_cluster.api.run(long_street, config),
        FRAMES,
    )


def ports_of_workers(running_cluster):
    """The addresses on which each worker listens.

    Waits for all of them, since one may just be starting its process again. Until it
    has joined, that listens at one more port.
    """
    until(lambda: all(map(has_joined, running_cluster.workers)))
    return [
        listening(worker.process.pid, working_process(worker))
        for worker in running_cluster.workers
    ]


def has_joined(worker):
    """Whether the present process of a worker has joined the scheduler."""
    log = worker.log_text
    return log.count("joined the scheduler") > log.count("starting another")


def test_only_the_documented_ports_listen_and_only_on_loopback(running_cluster):
    workers = ports_of_workers(running_cluster)
    scheduler = listening(running_cluster.scheduler.process.pid)
    server = listening(running_cluster.server.process.pid)

    assert scheduler == {("127.0.0.1", running_cluster.cluster.port)}
    assert [len(ports) for ports in workers] == [1, 1]
    assert {host for ports in workers for host, _ in ports} == {"127.0.0.1"}
    port = int(running_cluster.server.url.rpartition(":")[2])
    assert server == {("127.0.0.1", port), ("[::1]", port)}


@pytest.mark.parametrize(
    ("shown", "code", "said"),
    [
        ("foreign", EXIT_UNREACHABLE, "cannot connect to the scheduler"),
        pytest.param(
            *("unencrypted", EXIT_UNREACHABLE, "cannot connect to the scheduler"),
            marks=pytest.mark.long,
        ),
        ("none", 1, "UNGHOST_TLS_CA"),
    ],
)
def test_worker_without_a_valid_certificate_cannot_join(
    running_cluster, tmp_path, shown, code, said
):
    made = running_cluster.cluster
    settings = dict.fromkeys(made.tls("worker"), "")
    if shown == "foreign":
        make_certificates(tmp_path / "foreign", ("127.0.0.1",), 2)
        settings = made.tls("worker", tmp_path / "foreign")
    elif shown == "unencrypted":
        settings["UNGHOST_ENGINE"] = f"tcp://127.0.0.1:{made.port}"

    worker = made.worker("--patience", "3", joined=False, **settings)

    assert worker.wait_for_exit() == code, worker.log_text
    assert said in worker.log_text
    assert "joined" not in worker.log_text


def test_every_cluster_port_requires_a_valid_client_certificate(
    running_cluster, tmp_path
):
    foreign = tmp_path / "foreign"
    make_certificates(foreign, ("127.0.0.1",), 2)
    ports = {running_cluster.cluster.port}
    ports |= {
        port for worker in ports_of_workers(running_cluster) for _, port in worker
    }

    responses = [
        [
            accepts_client(port, shown)
            for shown in (None, foreign, running_cluster.cluster.certificates)
        ]
        for port in sorted(ports)
    ]

    assert responses == [[False, False, True]] * (1 + len(running_cluster.workers))


def accepts_client(port, certificates):
    """Whether a node answers a client with the certificate in this folder.

    None stands for a client that shows no certificate.
    """
    shown = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    shown.check_hostname, shown.verify_mode = False, ssl.CERT_NONE
    if certificates is not None:
        shown.load_cert_chain(certificates / "client.pem", certificates / "client.key")
    try:
        with (
            socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain,
            shown.wrap_socket(plain) as wire,
        ):
            return wire.recv(1) != b""
    except (ssl.SSLError, ConnectionError):
        return False


@pytest.mark.parametrize(
    ("engine", "said"),
    [
        ("tcp://192.0.2.1:8786", "not encrypted"),
        pytest.param("tls://192.0.2.1:8786", "UNGHOST_TLS_CA", marks=pytest.mark.long),
        pytest.param("dask", "is not an engine", marks=pytest.mark.long),
    ],
)
def test_server_refuses_an_insecure_or_unknown_engine(tmp_path, engine, said):
    settings = {"UNGHOST_ENGINE": engine, "UNGHOST_DATA": str(tmp_path / "data")}

    done = CommandLine(tmp_path, settings)("serve", "--port", "0")

    assert done.code in (1, 2)
    assert said in done.err
