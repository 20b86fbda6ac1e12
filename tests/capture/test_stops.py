"""A capture that is interrupted, loses its terminal or loses its simulator.

It ends soon, and puts the simulator back as it was wherever that is possible.
"""

import signal

import pytest

from unghost.capture.simulator import SimulatorAway

SHORT_SCENARIO = {"frames": 3, "camera": {"width": 48, "height": 32}}
FIRST_TICK = 12
"""The first tick that is recorded."""


@pytest.fixture(autouse=True)
def default_sighup_action():
    """Restore the default action of SIGHUP, which `nohup` lets the tests ignore."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


class ClosedTerminal:
    """Stands for `stage.notes` when the terminal is closed: every note fails."""

    def append(self, _text):
        raise OSError(5, "Input/output error")


def call_at_tick(stage, tick, act):
    """Call `act` when the simulator makes this tick."""
    stage.simulator.faults.on_tick = lambda _, now: act() if now == tick else None


def test_repeated_ctrl_c_while_spawning_leaves_no_actor_behind(stage, monkeypatch):
    add = stage.simulator.add

    def add_slowly(*arguments):
        made = add(*arguments)
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        return made

    monkeypatch.setattr(stage.simulator, "add", add_slowly)

    with pytest.raises(KeyboardInterrupt):
        stage.capture(**SHORT_SCENARIO)

    assert stage.left_behind() == {}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("was_stopped", [False, True])
def test_signal_while_the_simulator_is_restored_ends_the_command_afterwards(
    stage, monkeypatch, number, was_stopped
):
    remove = stage.simulator.remove

    def remove_slowly(actor_id):
        signal.raise_signal(number)
        return remove(actor_id)

    monkeypatch.setattr(stage.simulator, "remove", remove_slowly)
    if was_stopped:
        call_at_tick(stage, FIRST_TICK, lambda: signal.raise_signal(signal.SIGINT))

    with pytest.raises(KeyboardInterrupt):
        stage.capture(**SHORT_SCENARIO)

    assert stage.left_behind() == {}
    if not was_stopped:
        assert len(stage.frames()) == SHORT_SCENARIO["frames"]


def test_a_stop_does_not_wait_for_a_silent_sensor(stage):
    stage.simulator.faults.lost = {("rgb", tick) for tick in range(200)}
    call_at_tick(stage, FIRST_TICK, lambda: signal.raise_signal(signal.SIGINT))

    # The sensor may stay silent for an hour: if the stop waited for it, the test would
    # time out.
    with pytest.raises(KeyboardInterrupt):
        stage.capture(**SHORT_SCENARIO, sensor_wait_s=3600)

    assert stage.left_behind() == {}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("tick", [1, 5, FIRST_TICK, FIRST_TICK + 3])
def test_stop_signal_restores_the_simulator_and_capture_resumes(stage, tick, number):
    before = signal.getsignal(number)
    call_at_tick(stage, tick, lambda: signal.raise_signal(number))

    with pytest.raises(KeyboardInterrupt):
        stage.capture(**SHORT_SCENARIO)

    assert stage.left_behind() == {}
    assert signal.getsignal(number) is before
    stage.simulator.faults.on_tick = lambda *_: None
    assert stage.capture(**SHORT_SCENARIO).frames == 3


def test_capture_that_ignores_sighup_survives_its_terminal(stage):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    call_at_tick(stage, FIRST_TICK, lambda: signal.raise_signal(signal.SIGHUP))

    try:
        done = stage.capture(**SHORT_SCENARIO)
    finally:
        signal.signal(signal.SIGHUP, before)

    assert done.frames == 3


def test_crashed_simulator_gets_few_further_requests(stage):
    def crash(server, now):
        server.faults.gone = now >= FIRST_TICK

    stage.simulator.faults.on_tick = crash

    with pytest.raises(
        SimulatorAway, match="lost the connection to the simulator: time-out"
    ):
        stage.capture(**SHORT_SCENARIO, weather={"preset": "WetNoon"})

    assert (
        stage.notes[-1]
        == "the simulator does not respond: its settings were not restored"
    )
    # Unanswered are the tick, the first step of putting the simulator back, and two
    # requests that ask whether it is still there.
    assert stage.simulator.unanswered == 4


def test_failing_notes_of_a_closed_terminal_do_not_stop_the_cleanup(stage, monkeypatch):
    def fail(_actor_id):
        raise RuntimeError("no answer")

    monkeypatch.setattr(stage.simulator, "remove", fail)
    monkeypatch.setattr(stage, "notes", ClosedTerminal())

    stage.capture(**SHORT_SCENARIO)

    assert set(stage.left_behind()) == {"actors"}
