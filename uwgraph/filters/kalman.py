"""The two ways in which a belief about an inertial state is predicted and sees a measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from uwgraph.filters import extended, unscented
from uwgraph.filters.ins import Ins
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Seen, Spread, Weights
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray


@dataclass(frozen=True)
class Unscented:
    """By sigma points."""

    ins: Ins
    spread: Spread
    _weights: dict[int, Weights] = field(default_factory=dict, repr=False, compare=False)

    def predict(self, belief: Belief, t_ns: int, steps: FloatArray, earth: FloatArray) -> Belief:
        weights = self.weights(belief)
        for step in steps:
            noise = padded(self.ins.noise_rows(float(step[0])), belief.x.size)
            belief = unscented.predict(belief, t_ns, partial(self.ins.move, step=step, earth=earth), noise, weights)
        return belief

    def see(self, belief: Belief, observed: Observed) -> Seen:
        return unscented.see(belief, lambda x: self.ins.residuals(observed, x), self.weights(belief))

    def weights(self, belief: Belief) -> Weights:
        n = belief.x.size
        if n not in self._weights:
            self._weights[n] = self.spread.of(n)
        return self._weights[n]


@dataclass(frozen=True)
class Extended:
    """To first order."""

    ins: Ins

    def predict(self, belief: Belief, t_ns: int, steps: FloatArray, earth: FloatArray) -> Belief:
        for step in steps:
            F = self.ins.transition(belief.x, step, earth)
            moved = _one(self.ins.move(_batch(belief.x), step, earth))
            noise = padded(self.ins.noise_rows(float(step[0])), belief.x.size)
            belief = extended.predict(belief, t_ns, moved, F, noise)
        return belief

    def see(self, belief: Belief, observed: Observed) -> Seen:
        residual = self.ins.residuals(observed, _batch(belief.x))[0]
        return extended.see(belief, residual, self.ins.jacobian(observed, belief.x))


def padded(rows: FloatArray, n: int) -> FloatArray:
    """Rows for n states, zero for those that were appended."""
    return rows if rows.shape[1] == n else np.pad(rows, ((0, 0), (0, n - rows.shape[1])))


def _batch(x: State) -> State:
    return State(x.R[None].copy(), x.y[None].copy(), x.rot)


def _one(x: State) -> State:
    return State(x.R[0], x.y[0], x.rot)
