"""AUKF-SLAM on the kinematic model: an adaptive unscented filter whose state grows by the places it sees.

The model of the document: a vehicle's position and heading, driven by velocities and a rate, and nodes of a topological
map beside it. Measurements in the order of time; what comes late is not taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from uwgraph.dive.rig import Settings
from uwgraph.errors import DataError
from uwgraph.filters import part
from uwgraph.filters.kinematic import PSI, VEHICLE, Direct, InputNoise, Inputs, Kinematic
from uwgraph.filters.monitor import Judged, Monitor, Policy
from uwgraph.filters.place_nodes import Association, Places, PlaceSettings, Sighting, Verdict, associate, fused
from uwgraph.filters.settings import Adaptation, SigmaPoints
from uwgraph.filters.state import Belief, Index
from uwgraph.filters.statistics import fading_weight, unbiased_noise
from uwgraph.filters.system import System
from uwgraph.filters.unscented import Residual, Spread
from uwgraph.filters.votes import Votes
from uwgraph.graph.settings import Quantile
from uwgraph.types import FloatArray, TimeArray

Measurement = Direct | Sighting


class SlamSettings(Settings):
    """What the user can choose."""

    inputs: InputNoise = InputNoise()
    places: PlaceSettings = PlaceSettings()
    sigma_points: SigmaPoints = SigmaPoints()
    gate: Quantile = 0.9999
    """Share of good measurements that pass the gate; places have their own."""
    learns: Literal["nothing", "sensors", "system", "both"] = "sensors"
    """Whose noise is estimated; of both together hardly more than the sum can be told."""
    system_mean: bool = False
    """Whether the mean of the system's noise is estimated with it."""
    adaptation: Adaptation = Adaptation()


@dataclass(frozen=True, eq=False)
class MapNode:
    """A place of the map."""

    label: int
    pose: FloatArray
    """North, east, down [m], and the heading [rad] where places have one: shape (3,) or (4,)."""
    cov: FloatArray
    """Shape (3, 3) or (4, 4)."""
    descriptor: FloatArray
    """Shape (D,)."""
    count: int
    """Sightings."""


@dataclass(frozen=True, eq=False)
class Sighted:
    """What became of a sighting."""

    t_ns: int
    verdict: Verdict
    label: int | None
    """The node that it was taken for or that it made; None where it was left out."""


@dataclass(frozen=True, eq=False)
class SlamResult:
    """Where the vehicle was, and the places."""

    t_ns: TimeArray
    """Of the inputs, shape (K,)."""
    y: FloatArray
    """North, east, down [m] and heading [rad], unwrapped, shape (K, 4)."""
    cov: FloatArray
    """Shape (K, 4, 4)."""
    nodes: tuple[MapNode, ...]
    """The map in the end."""
    sighted: tuple[Sighted, ...]
    """Every sighting."""
    judged: tuple[Judged, ...]
    """Every measurement that the filter was shown."""


class Slam:
    """The filter as it runs: :meth:`advance` with the inputs, :meth:`take` what is measured.

    Raises
    ------
    DataError
        When the first belief is not that of a kinematic model with the settings' noise, when time runs backwards, or
        when a sighting is of another kind than those before.
    """

    def __init__(self, first: Belief, settings: SlamSettings | None = None) -> None:
        self.settings = settings or SlamSettings()
        self._model = Kinematic(self.settings.inputs)
        if first.x.size != self._model.size:
            raise DataError(
                f"{first.x.size} numbers, where the inputs' noise asks for {self._model.size}",
                where="first belief",
                remedy="make it by Kinematic.start with the same noise",
            )
        learns = self.settings.learns
        learnt = self.settings.adaptation if learns in ("sensors", "both") else None
        self._policy = Policy(self.settings.gate, learnt)
        self._spread = Spread(**self.settings.sigma_points.model_dump())
        self._monitors: dict[tuple[str, int], Monitor] = {}
        self.system = System(self.settings.inputs.root)
        """What is believed of the inputs' noise."""
        self.places = Places(first)
        """The vehicle and the nodes, as they are believed to be."""
        self._votes = Votes()
        self._labels = 0
        self._before: Belief | None = None
        self._epoch_ns = first.t_ns
        self.sighted: list[Sighted] = []
        self.judged: list[Judged] = []

    @property
    def belief(self) -> Belief:
        """About the vehicle (position, heading, biases), then the nodes."""
        return self.places.belief

    def noise(self, kind: str, m: int) -> FloatArray:
        """Covariance believed of measurements of a kind and of m numbers, in units of the stated one, shape (m, m)."""
        monitor = self._monitors.get((kind, m))
        return np.eye(m) if monitor is None else monitor.noise.R

    def nodes(self) -> tuple[MapNode, ...]:
        """The map."""
        S, y = self.belief.S, self.belief.x.y
        return tuple(
            MapNode(node.label, y[at], S[at] @ S[at].T, node.descriptor, node.count)
            for node, at in ((node, self.places.at(k)) for k, node in enumerate(self.places.nodes))
        )

    def advance(self, t_ns: int, u: FloatArray, age_s: float = 0.0) -> None:
        """On to a moment with constant inputs, shape (4,), whose velocity is so old."""
        belief, dt = self.belief, (t_ns - self.belief.t_ns) * 1e-9
        if dt < 0.0:
            raise DataError("time runs backwards", where=f"inputs at {t_ns}", remedy="sort inputs and measurements")
        if dt == 0.0:
            return
        self._close_epoch()
        u = u + self.system.mean
        root = self.settings.inputs.aged(self.system.root, age_s)
        rows = self._model.noise_rows(float(belief.x.y[PSI]), dt, u, root)
        rows = np.pad(rows, ((0, 0), (0, belief.x.size - rows.shape[1])))
        moved = part.predict(belief, t_ns, self._model.size, lambda x: self._model.move(x, dt, u), rows, self._spread)
        self.places = replace(self.places, belief=moved)

    def take(self, measured: Measurement) -> None:
        """What is measured at the moment that the filter is at."""
        if measured.t_ns != self.belief.t_ns:
            raise DataError(
                f"the filter is at {self.belief.t_ns}", where=f"{measured.kind} at {measured.t_ns}", remedy="advance it"
            )
        if self._before is None:
            self._before = self.belief
        if isinstance(measured, Sighting):
            self._sight(measured)
        else:
            self._use(measured, measured.at, measured.residual)

    def run(self, inputs: Inputs, measured: Sequence[Measurement]) -> SlamResult:
        """All inputs, and what is measured between the first belief and the last of them, in the order of time."""
        pending = sorted((m for m in measured if m.t_ns > self.belief.t_ns), key=lambda m: m.t_ns)
        inputs = inputs.select(inputs.t_ns > self.belief.t_ns)
        y, cov, done = np.empty((len(inputs), VEHICLE)), np.empty((len(inputs), VEHICLE, VEHICLE)), 0
        each = zip(inputs.t_ns.tolist(), inputs.u, inputs.age_s.tolist(), strict=True)
        for k, (t_ns, u, age_s) in enumerate(each):
            while done < len(pending) and pending[done].t_ns <= t_ns:
                self.advance(pending[done].t_ns, u, age_s)
                self.take(pending[done])
                done += 1
            self.advance(t_ns, u, age_s)
            S = self.belief.S[:VEHICLE]
            y[k], cov[k] = self.belief.x.y[:VEHICLE], S @ S.T
        return SlamResult(inputs.t_ns, y, cov, self.nodes(), tuple(self.sighted), tuple(self.judged))

    def _use(self, measured: Measurement, at: Index, residual: Residual) -> bool:
        see = part.sight(residual, len(at), self._spread)
        key = (measured.kind, len(measured.cov))
        taken = self._policy.take(part.facing(self.belief, at), see, self._monitors.get(key))
        self.places = replace(self.places, belief=part.lowered(taken.belief))
        self._monitors[key] = taken.monitor
        self.judged.append(taken.judged(measured.t_ns, measured.kind))
        return taken.accepted

    def _sight(self, sighting: Sighting) -> None:
        self.places.check(sighting)
        found = self._associate(sighting)
        if found.verdict == "ambiguous" and self._fuse(*found.nodes[:2]):
            found = self._associate(sighting)
        label: int | None = None
        if found.verdict == "new":
            label = self._append(sighting)
        elif found.verdict != "ambiguous" and self._believable(sighting, found):
            label = self._recognise(sighting, found.nodes[0])
        self.sighted.append(Sighted(sighting.t_ns, found.verdict, label))
        if label is not None:
            self._fuse_neighbours(label)

    def _associate(self, sighting: Sighting) -> Association:
        R = self.noise(sighting.kind, len(sighting.relative))
        return associate(self.places, sighting, R, self.settings.places, self._spread)

    def _believable(self, sighting: Sighting, found: Association) -> bool:
        """Whether a sighting that looks like a node may correct the filter: if it fits, or if the filter is lost.

        Lost it is where most places lately did not fit, and other places put the vehicle where this one does. Near
        misses at least tell of the noise, which the sightings that fit would understate.
        """
        k, known = found.nodes[0], found.verdict == "known"
        if not known and len(found.nodes) > 1:
            return False
        off, label = self.places.off(sighting, k), self.places.nodes[k].label
        self._votes = self._votes.after(label, known, off)
        if known:
            return True
        if found.d2 <= self.settings.adaptation.cap * len(sighting.relative):
            if self._votes.trusts(label):
                self._learn_from_miss(sighting, k)
            return False
        lost = self._votes.doubted and self._votes.agree(off, 3.0 * self.settings.places.radius_m)
        if lost:
            self.places, self._votes = self.places.widened(off), Votes()
        return lost

    def _learn_from_miss(self, sighting: Sighting, k: int) -> None:
        """The noise statistics with a sighting that is not used, by its innovation."""
        key = (sighting.kind, len(sighting.relative))
        how, monitor = self._policy.adaptation, self._monitors.get(key)
        if how is None or monitor is None:
            return
        seen = self.places.seen(sighting, k, self._spread)
        d = fading_weight(monitor.noise.count + 1, how.memory, how.start)
        learnt = unbiased_noise(monitor.noise, seen.mean - monitor.noise.r, seen.spread, d)
        if learnt is not None:
            self._monitors[key] = replace(monitor, noise=learnt)

    def _append(self, sighting: Sighting) -> int:
        label, self._labels = self._labels, self._labels + 1
        if len(self.places.nodes) == self.settings.places.most:
            self.places = self.places.dropped(self.places.least_useful())
        self.places = self.places.with_node(sighting, label)
        return label

    def _recognise(self, sighting: Sighting, k: int) -> int | None:
        """The node's label where the sighting was used."""
        if not self._use(sighting, self.places.vehicle_and(k), self.places.residual(sighting, k)):
            return None
        node = self.places.nodes[k].seen_again(sighting)
        self.places = self.places.renewed(k, node)
        return node.label

    def _fuse_neighbours(self, label: int) -> None:
        """Fuse a node with all that turn out to be the same place."""
        node = self.places.nodes[self.places.find(label)]
        alike = self.places.alike(node.descriptor, self.settings.places.descriptor_gate)
        others = [self.places.nodes[k].label for k in alike if self.places.nodes[k] is not node]
        for other in others:
            if self._fuse(self.places.find(label), self.places.find(other)):
                label = min(label, other)

    def _fuse(self, j: int, k: int) -> bool:
        places = fused(self.places, j, k, self.settings.places, self._spread)
        self.places = places or self.places
        return places is not None

    def _close_epoch(self) -> None:
        """Learn the system's noise from the measurements of the moment that the filter leaves."""
        before, self._before = self._before, None
        if before is None or self.settings.learns not in ("system", "both"):
            return
        elapsed = (before.t_ns - self._epoch_ns) * 1e-9
        if elapsed > 0.0:
            how, mean = self.settings.adaptation, self.settings.system_mean
            self.system = self.system.learnt(before, self.belief, elapsed, how, mean)
            self._epoch_ns = before.t_ns
