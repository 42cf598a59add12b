"""The two ways in which a belief about an inertial state is predicted and sees a measurement.

Only the inertial core moves. What stands behind it in the state, the Doppler log's calibration and remembered poses, is
correlated with it and constant: a prediction goes over the core alone, and the correlations are carried along once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from uwgraph.filters import extended, unscented
from uwgraph.filters.ins import Ins, Nodes
from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Motion, Seen, Spread, Weights
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray


@dataclass(frozen=True)
class Kalman(ABC):
    """A filter of inertial states."""

    ins: Ins

    def predict(self, belief: Belief, t_ns: int, steps: FloatArray, earth: FloatArray) -> Belief:
        """The belief after steps of dt, specific force and rate, shape (S, 7)."""
        n = self.ins.moving
        if belief.x.size == n:
            for step in steps:
                belief = self.step(belief, t_ns, step, earth)
            return belief
        core, G = _core(belief, n), np.eye(n)
        for step in steps:
            core, carried = self.step_and_carry(core, t_ns, step, earth)
            G = G @ carried
        return _joined(core, G, belief)

    @abstractmethod
    def step(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> Belief:
        """The moving part after one step."""

    @abstractmethod
    def step_and_carry(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> tuple[Belief, FloatArray]:
        """The same, and E[u u'^T] of the unit vectors behind its errors."""

    @abstractmethod
    def see(self, belief: Belief, observed: Observed, nodes: Nodes = ()) -> Seen:
        """A measurement's whitened residual over a belief; ``nodes`` are the moments of the poses at its end."""


@dataclass(frozen=True)
class Unscented(Kalman):
    """By sigma points."""

    spread: Spread = field(default_factory=Spread)
    _weights: dict[int, Weights] = field(default_factory=dict, repr=False, compare=False)

    def step(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> Belief:
        return unscented.predict(core, t_ns, *self._model(core, step, earth))

    def step_and_carry(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> tuple[Belief, FloatArray]:
        return unscented.predict_and_carry(core, t_ns, *self._model(core, step, earth))

    def _model(self, core: Belief, step: FloatArray, earth: FloatArray) -> tuple[Motion, FloatArray, Weights]:
        motion = partial(self.ins.move, step=step, earth=earth)
        return motion, self.ins.noise_rows(float(step[0])), self.weights(core.x.size)

    def see(self, belief: Belief, observed: Observed, nodes: Nodes = ()) -> Seen:
        weights = self.weights(self.ins.reach(observed, nodes))
        return unscented.see(belief, lambda x: self.ins.residuals(observed, x, nodes), weights)

    def weights(self, n: int) -> Weights:
        if n not in self._weights:
            self._weights[n] = self.spread.of(n)
        return self._weights[n]


@dataclass(frozen=True)
class Extended(Kalman):
    """To first order."""

    def step(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> Belief:
        return extended.predict(core, t_ns, *self.linearized(core.x, step, earth))

    def step_and_carry(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> tuple[Belief, FloatArray]:
        return extended.predict_and_carry(core, t_ns, *self.linearized(core.x, step, earth))

    def linearized(self, x: State, step: FloatArray, earth: FloatArray) -> tuple[State, FloatArray, FloatArray]:
        """The state after a step, the derivative of the step and the rows of its noise."""
        moved = self.ins.move(_batch(x), step, earth)
        noise = self.ins.noise_rows(float(step[0]))
        return State(moved.R[0], moved.y[0], x.rot), self.ins.transition(x, step, earth), noise

    def see(self, belief: Belief, observed: Observed, nodes: Nodes = ()) -> Seen:
        residual = self.ins.residuals(observed, _batch(belief.x), nodes)[0]
        return extended.see(belief, residual, self.ins.jacobian(observed, belief.x, nodes))


def _batch(x: State) -> State:
    return State(x.R[None].copy(), x.y[None].copy(), x.rot)


def _core(belief: Belief, n: int) -> Belief:
    """The first n numbers of the tangent alone: the body's rotation, and no other."""
    return Belief(belief.t_ns, belief.x.core(n), np.ascontiguousarray(belief.S[:n, :n]))


def _joined(core: Belief, G: FloatArray, before: Belief) -> Belief:
    """The core put back before what did not move.

    Their errors are A u + B w with unit normal u, w; u is G u' + (I - G G^T)^1/2 v. What it does not share with the
    core any more goes to their own root.
    """
    n = core.x.size
    A, B = before.S[n:, :n], before.S[n:, n:]
    left, Q = np.linalg.eigh(np.eye(n) - G @ G.T)
    freed = A @ (Q * np.sqrt(np.maximum(left, 0.0)))
    S = np.zeros_like(before.S)
    S[:n, :n] = core.S
    S[n:, :n] = A @ G
    S[n:, n:] = lower_root(np.concatenate([B.T, freed.T]))
    return replace(before, t_ns=core.t_ns, x=before.x.with_core(core.x), S=S)
