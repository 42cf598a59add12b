"""A filter over a dive: predict to every epoch, take what was measured there, report where one is asked to.

A measurement that reaches the filter late is used from then on, at its own time: the filter keeps a belief as old as
the longest delay, up to which everything has come in, and looks ahead from there with what it has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

import factors
from uwgraph.filters.augment import without
from uwgraph.filters.ins import NODE, Nodes
from uwgraph.filters.kalman import Kalman
from uwgraph.filters.monitor import Judged, Monitor, Policy
from uwgraph.filters.state import Belief
from uwgraph.graph.observed import Observed
from uwgraph.graph.place import place_at
from uwgraph.graph.prepare import Prepared
from uwgraph.graph.track import Track
from uwgraph.types import FloatArray, Innovations, TimeArray

IndexArray = NDArray[np.intp]
CLAIMS = ("closures",)
"""Kinds that the gate is never opened for: what most of them say may well be false."""


@dataclass(frozen=True, eq=False)
class Epochs:
    """When something happens, and the IMU in between."""

    t_ns: TimeArray
    """Increasing, shape (E,); the first is the start."""
    steps: FloatArray
    """All integration steps: dt, specific force, rate, shape (S, 7)."""
    first: IndexArray
    """Index of the first step after each epoch, shape (E,)."""
    earth: FloatArray
    """Gravity and rotation of n, shape (E, 6)."""

    @classmethod
    def of(cls, prepared: Prepared, track: Track, t_ns: TimeArray, samples_per_step: int) -> Epochs:
        imu = prepared.imu
        steps = factors.integration_steps(imu.t_ns[1:], imu.f_b, imu.w_b, t_ns, samples_per_step=samples_per_step)
        gravity = place_at(prepared, t_ns, track).gravity_n
        earth = np.hstack([gravity, np.broadcast_to(prepared.earth_rate_n, gravity.shape)])
        rows = np.column_stack([steps.dt, steps.f_b, steps.w_b])
        return cls(t_ns, rows, steps.first, earth)


@dataclass(frozen=True, eq=False)
class Filtering:
    """Where a filter is: its belief and what it knows of its sensors."""

    belief: Belief
    monitors: Mapping[Sensor, Monitor] = field(default_factory=dict)
    epoch: int = -1
    """The last whose measurements were taken; -1 before the start's own."""
    nodes: Nodes = ()


Record = Callable[[Judged], None]
Sensor = tuple[str, int]
"""Kind and dimension: fixes with a height and fixes without have statistics of their own."""


@dataclass(frozen=True, eq=False)
class Runner:
    """A filter, the epochs, and what was measured at each."""

    kalman: Kalman
    policy: Policy
    epochs: Epochs
    measured: Mapping[int, Sequence[Observed]]
    """By epoch."""
    delays_ns: Mapping[str, int]
    """How late each kind arrives; what is not named is at once there."""
    last_use: Mapping[int, int] = field(default_factory=dict)
    """Poses to be remembered: their moment, and the last moment at which one is seen again, ns."""

    def run(
        self, start: Filtering, outputs: IndexArray, progress: Callable[[float], None]
    ) -> tuple[list[Belief], Innovations | None]:
        """Beliefs at the epochs ``outputs`` (increasing), with what had reached the filter by then."""
        history: list[Judged] = []
        late = max(self.delays_ns.values(), default=0)
        certain, reported = start, []
        for n, output in enumerate(outputs.tolist()):
            now = int(self.epochs.t_ns[output])
            settled = int(np.searchsorted(self.epochs.t_ns, now - late, side="right")) - 1
            certain = self._advance(certain, settled, None, history.append)
            ahead = certain if settled == output else self._advance(certain, output, now, lambda judged: None)
            reported.append(ahead.belief)
            if n % 50 == 0:
                progress(n / len(outputs))
        return reported, innovations_of(history)

    def _advance(
        self, filtering: Filtering, until: int, known_ns: int | None, record: Callable[[Judged], None]
    ) -> Filtering:
        """On to an epoch, its measurements included; with those only that are there at ``known_ns``."""
        belief, monitors, nodes = filtering.belief, dict(filtering.monitors), filtering.nodes
        epochs = self.epochs
        for k in range(filtering.epoch + 1, until + 1):
            if k:
                steps = epochs.steps[epochs.first[k - 1] : epochs.first[k]]
                belief = self.kalman.predict(belief, int(epochs.t_ns[k]), steps, epochs.earth[k - 1])
            for observed in self.measured.get(k, ()):
                if known_ns is not None and observed.t_ns + self.delays_ns.get(observed.kind, 0) > known_ns:
                    continue
                see = partial(self.kalman.see, observed=observed, nodes=nodes)
                sensor = (observed.kind, len(observed.whitener))
                taken = self.policy.take(belief, see, monitors.get(sensor), observed.kind not in CLAIMS)
                belief, monitors[sensor] = taken.belief, taken.monitor
                record(taken.judged(observed.t_ns, observed.kind))
            belief, nodes = self._remember(belief, nodes, k)
        return Filtering(belief, monitors, max(until, filtering.epoch), nodes)

    def _remember(self, belief: Belief, nodes: Nodes, epoch: int) -> tuple[Belief, Nodes]:
        """Forget the poses that nobody will see again, and remember the present one where somebody will."""
        now = int(self.epochs.t_ns[epoch])
        for node in [n for n in nodes if self.last_use[n] <= now]:
            belief = without(belief, self.kalman.ins.node_at(nodes, node), NODE)
            nodes = tuple(n for n in nodes if n != node)
        if now in self.last_use:
            return self.kalman.ins.remember(belief), (*nodes, now)
        return belief, nodes


def innovations_of(history: Sequence[Judged]) -> Innovations | None:
    """The history as a stream; None where nothing was measured."""
    if not history:
        return None
    width = max(len(row.whitened) for row in history)

    def padded(row: FloatArray) -> FloatArray:
        return np.pad(row, (0, width - len(row)), constant_values=np.nan)

    return Innovations(
        np.array([row.t_ns for row in history], dtype=np.int64),
        kind=np.array([row.kind for row in history]),
        dof=np.array([len(row.whitened) for row in history], dtype=np.int64),
        whitened=np.array([padded(row.whitened) for row in history]),
        nis=np.array([row.nis for row in history]),
        accepted=np.array([row.accepted for row in history]),
        noise=np.array([padded(row.noise) for row in history]),
        fading=np.array([row.fading for row in history]),
    )
