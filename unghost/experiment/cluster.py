"""Runs the trials of an experiment on the workers of a Dask cluster.

Each trial is a task. Workers reach the experiment's folder, which has the same path on
all machines, so a result is where a trial on this machine would have written it.
"""

from __future__ import annotations

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from unghost.experiment.trials import (
    SETTINGS,
    Experiment,
    TrialError,
    TrialInterrupted,
    trainer_command,
)

if TYPE_CHECKING:
    from distributed import Client

_MOST_LOST: Final = 3
"""Workers that a trial may lose; then it probably ended them."""

_LOOK_EVERY_S: Final = 2.0
"""Seconds after which workers that have joined get a trial."""
_ANSWER_S: Final = 3

_AFTER_RUNS: Final = -1
"""Priority of trials: chunks of a service's runs, which take seconds, go first."""


class _Task(NamedTuple):
    """A trial, and what every machine has to have of its experiment."""

    folder: Path
    digest: str
    trainer: str
    parallel: int
    arm: str
    seed: int

    def __str__(self) -> str:
        return f"arm {self.arm}, seed {self.seed}"


def tasks_of(
    experiment: Experiment,
    trials: Iterable[tuple[str, int]],
    trainer: str,
    parallel: int,
) -> list[_Task]:
    """The tasks of trials, by arm and seed.

    Each worker calls `trainer_command` with `trainer`; `parallel` are the workers of
    one machine, which share its cores.
    """
    common = experiment.folder.resolve(), _digest(experiment), trainer, parallel
    return [_Task(*common, arm, seed) for arm, seed in trials]


def run_on_workers(
    client: Client, tasks: Iterable[_Task], note: Callable[[str], None]
) -> Iterator[None]:
    """Run trials on the workers of a scheduler; yields once for each that is finished.

    `note` gets a sentence about each worker that was lost; its trial is begun again.

    Raises `TrialError`: a trial failed, a worker does not see the folder, or the
    scheduler was lost. Trials that have not ended are cancelled.
    """
    waiting, lost = deque(tasks), Counter[_Task]()
    executor = client.get_executor(pure=False)
    running: dict[Future[None], _Task] = {}
    try:
        while waiting or running:
            # Not more than workers: one that ends takes only one trial with it.
            while waiting and len(running) < max(1, _workers(client)):
                task = waiting.popleft()
                sent = executor.submit(_run, task, priority=_AFTER_RUNS)
                running[sent] = task
            for future in wait(running, _LOOK_EVERY_S, FIRST_COMPLETED).done:
                task = running.pop(future)
                if _has_ended(future, task):
                    yield
                    continue
                lost[task] += 1
                if lost[task] == _MOST_LOST:
                    raise TrialError(f"{task}: {_MOST_LOST} workers ended in it")
                note(f"{task}: its worker was lost; another one trains it")
                waiting.append(task)
    finally:
        for future in running:
            future.cancel()


def _workers(client: Client) -> int:
    try:
        return len(client.nthreads(callback_timeout=_ANSWER_S))
    except Exception:  # the connection was lost: the trials that run will say so
        return 0


def _has_ended(future: Future[None], task: _Task) -> bool:
    """Whether a trial is finished; else its worker was lost."""
    from distributed import KilledWorker

    try:
        future.result()
    except (KilledWorker, TrialInterrupted):
        return False
    except CancelledError as error:
        raise TrialError(
            "the connection to the scheduler was lost; the same command continues"
        ) from error
    except TrialError:
        raise
    except Exception as error:
        raise TrialError(f"{task}: {type(error).__name__}: {error}") from error
    return True


def _run(task: _Task) -> None:
    """Run a trial on this worker, until it is cancelled or the worker stops."""
    from distributed import Status, get_worker

    worker = get_worker()
    key = worker.get_current_task()
    experiment = Experiment(task.folder)
    reason = "does not see"
    try:
        is_seen = _digest(experiment) == task.digest
        if is_seen:
            folder = experiment.trial_folder(task.arm, task.seed)
            folder.mkdir(parents=True, exist_ok=True)
    except FileNotFoundError:
        is_seen = False
    except OSError as error:
        is_seen, reason = False, f"cannot use ({error.strerror})"
    if not is_seen:
        raise TrialError(
            f"the worker at {worker.address} {reason} {task.folder}: mount the folder "
            "there, at the same path and writable, or choose an --output that all "
            "machines share"
        )

    def may_continue() -> bool:
        state = worker.state.tasks.get(key)
        is_cancelled = state is None or state.state == "cancelled"
        return worker.status is Status.running and not is_cancelled

    if not experiment.is_finished(task.arm, task.seed):
        command = trainer_command(task.trainer)
        experiment.run(task.arm, task.seed, command, task.parallel, may_continue)


def _digest(experiment: Experiment) -> str:
    """What tells this experiment's folder from another one at the same path."""
    content = (experiment.data / SETTINGS).read_bytes()
    return hashlib.sha256(content).hexdigest()
