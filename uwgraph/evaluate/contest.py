"""Several estimators on one dive: the same first state, measurements, noise and epochs for all of them.

Each runs in a process of its own: what it needs in time and memory is then its own too, and one that dies takes nobody
with it.
"""

from __future__ import annotations

import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from threading import current_thread, main_thread
from typing import Any

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.body_reference import body_reference
from uwgraph.errors import ConfigError, SolveError, UwgraphError
from uwgraph.evaluate.align import Alignment
from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.judge import judge, judging_stamps
from uwgraph.evaluate.nis import nis_metrics
from uwgraph.filters import ESTIMATORS, Estimate, EstimatorSettings, Named, task_of
from uwgraph.types import Innovations, Solution, TimeArray

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Ran:
    """An estimate and what it took."""

    estimate: Estimate
    runtime_s: float
    memory_mb: float
    """Most memory that the process had, the dive and all libraries included."""


def run_contest(
    dive: Dive,
    names: Sequence[str],
    settings: EstimatorSettings | None = None,
    *,
    title: str = "",
    alignment: Alignment = "none",
    jobs: int = 1,
    own: Mapping[str, Named] | None = None,
    progress: Progress = lambda what, share: None,
) -> Contest:
    """Run estimators on a dive and judge each by the dive's reference.

    Parameters
    ----------
    names
        Of :data:`uwgraph.filters.ESTIMATORS`, or of ``own``.
    jobs
        How many run at a time; more than one makes their runtimes longer.
    own
        Estimators of anybody's own by name; their functions stand at the top level of a module or script, where other
        processes find them.

    Raises
    ------
    ConfigError
        When a name is unknown, or another process could not find an estimator.
    DataError, InitialisationError
        When the dive cannot be begun.
    SolveError
        When no estimator has a result.
    """
    settings = settings or EstimatorSettings()
    names = list(dict.fromkeys(names))
    known = {**ESTIMATORS, **(own or {})}
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        problem = f"there is no estimator {', '.join(unknown)!r}" if unknown else "no estimator is named"
        raise ConfigError(problem, where="estimators", remedy=f"use {', '.join(known)}")
    for name in names:
        _refuse_unfindable(name, known[name])
    progress("reading the streams", 0.0)
    stamps = common_stamps(dive, settings)
    ran = _run_all({name: (known[name], dive, settings, stamps) for name in names}, jobs, progress)
    progress("judging", 1.0)
    entries = tuple(
        _judged(dive, name, known[name].title, result, alignment)
        for name, result in ran.items()
        if isinstance(result, Ran)
    )
    failed = {name: result for name, result in ran.items() if isinstance(result, str)}
    if not entries:
        raise SolveError("; ".join(f"{name}: {why}" for name, why in failed.items()), where="estimators")
    return Contest(dive, title, entries, failed)


def common_stamps(dive: Dive, settings: EstimatorSettings) -> TimeArray:
    """When every estimator is asked: at the keyframes, or at the reference's samples nearest to them."""
    keyframes, reference = task_of(dive, settings.smooth).t_ns, body_reference(dive)
    return keyframes if reference is None else judging_stamps(keyframes, reference.t_ns)


def _refuse_unfindable(name: str, estimator: Named) -> None:
    try:
        pickle.dumps(estimator)
    except (pickle.PicklingError, AttributeError, TypeError):
        raise ConfigError(
            f"another process does not find the estimator {name!r}",
            where="estimators",
            remedy="put its function at the top level of a module or script",
        ) from None


def _judged(dive: Dive, name: str, title: str, ran: Ran, alignment: Alignment) -> Entry:
    estimate = ran.estimate
    solution = replace(estimate.solution, info={**estimate.solution.info, "runtime_s": ran.runtime_s})
    judged = judge(dive, solution, alignment)
    figures = {**judged.metrics, "memory_mb": ran.memory_mb, **nis_metrics(estimate.innovations)}
    return Entry(name, title, replace(judged, metrics=figures), estimate.innovations)


def _run_all(tasks: Mapping[str, tuple[Any, ...]], jobs: int, progress: Progress) -> dict[str, Ran | str]:
    """What each estimator gave, in the order asked for: a result, or why there is none."""
    context = get_context("spawn")
    waiting = list(tasks)
    done: dict[str, Ran | str] = {}
    running: dict[Connection, tuple[str, SpawnProcess]] = {}
    shares = dict.fromkeys(tasks, 0.0)
    try:
        while waiting or running:
            while waiting and len(running) < max(jobs, 1):
                name = waiting.pop(0)
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, *tasks[name]), daemon=True)
                with _interrupts_later():
                    process.start()
                    running[ours] = (name, process)
                theirs.close()
            for ready in wait(list(running)):
                assert isinstance(ready, Connection)
                name, process = running[ready]
                message = _received(ready)
                if isinstance(message, tuple):
                    shares[name] = message[1]
                    progress(f"{name}: {message[0]}", sum(shares.values()) / len(shares))
                    continue
                process.join()
                done[name] = message if message is not None else _died(process.exitcode)
                shares[name] = 1.0
                del running[ready]
    finally:
        for _, process in running.values():
            process.kill()
            process.join()
    return {name: done[name] for name in tasks}


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal: those started in here leave it to this one, which ends them.

    It waits until they are known, or they would outlive it. They inherit the mask of this thread; the handler is for
    the other threads of this process, which take the signal instead.
    """
    resource_tracker.ensure_running()  # starting it would lift the mask
    pending: list[int] = []
    alone = current_thread() is main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: pending.append(number)) if alone else None
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if alone:
            signal.signal(signal.SIGINT, handler)
    if pending:
        raise KeyboardInterrupt


def _received(connection: Connection) -> Any:
    """Progress as a tuple, a result, a reason as text, or None where the process is gone."""
    try:
        return connection.recv()
    except EOFError:
        return None


def _died(exit_code: int | None) -> str:
    """What became of a process that said nothing."""
    if exit_code is not None and exit_code < 0:
        return f"its process was ended by signal {-exit_code} (9: out of memory, or killed)"
    return f"its process ended with status {exit_code} without a result"


def _work(results: Connection, estimator: Named, dive: Dive, settings: EstimatorSettings, t_ns: TimeArray) -> None:
    """In a process of its own: one estimator, its result or the reason why there is none."""

    def tell(what: str, share: float) -> None:
        results.send((what, share))

    with suppress(BrokenPipeError):  # nobody is there any more
        try:
            results.send(_ran(estimator, dive, settings, t_ns, tell))
        except UwgraphError as error:
            results.send(str(error))
        except Exception as error:
            results.send(f"{type(error).__name__}: {error}")


def _ran(estimator: Named, dive: Dive, settings: EstimatorSettings, t_ns: TimeArray, tell: Progress) -> Ran:
    from uwgraph.filters.kernels import compile_all

    task = task_of(dive, settings.smooth, t_ns)
    tell("compiling", 0.0)
    compile_all()
    started = time.perf_counter()
    estimate = estimator.run(task, settings, tell)
    seconds = time.perf_counter() - started
    if not _finite(estimate.solution, estimate.innovations):
        raise SolveError("it diverged: its states are not finite")
    return Ran(estimate, seconds, _peak_mb())


def _finite(solution: Solution, innovations: Innovations | None) -> bool:
    arrays = [solution.R_nb, solution.p_n, solution.v_n]
    if innovations is not None:
        arrays.append(innovations.nis)
    return all(bool(np.isfinite(array).all()) for array in arrays)


def _peak_mb() -> float:
    import resource  # not on every system

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
