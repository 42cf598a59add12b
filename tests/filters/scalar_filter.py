"""A vehicle that wanders on a line and is told where it is: the smallest filter that has to learn its noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from linear import belief_of, vector

from uwgraph.filters import extended
from uwgraph.filters.monitor import Monitor, Policy, Taken
from uwgraph.filters.settings import Adaptation
from uwgraph.filters.state import Belief
from uwgraph.filters.unscented import Seen
from uwgraph.types import FloatArray


@dataclass(frozen=True)
class Line:
    """x' = x + N(0, q), z = x + N(0, r true), of m axes alike."""

    q: float
    stated: float
    """Variance that the filter is told."""
    m: int = 1

    def truth(self, rng: np.random.Generator, steps: int, jumps: dict[int, float] | None = None) -> FloatArray:
        """Shape (steps, m)."""
        moves = np.sqrt(self.q) * rng.normal(size=(steps, self.m))
        for k, size in (jumps or {}).items():
            moves[k] += size
        return np.asarray(np.cumsum(moves, axis=0))

    def filtered(self, z: FloatArray, policy: Policy) -> list[Taken]:
        belief, monitor = belief_of(np.zeros(self.m), np.eye(self.m)), None
        history = []
        for k, measured in enumerate(z):
            belief = extended.predict(belief, k, vector(belief.x.y), np.eye(self.m), np.sqrt(self.q) * np.eye(self.m))
            taken = policy.take(belief, partial(self._seen, z=measured), monitor)
            belief, monitor = taken.belief, taken.monitor
            history.append(taken)
        return history

    def _seen(self, belief: Belief, z: FloatArray) -> Seen:
        sigma = np.sqrt(self.stated)
        return extended.see(belief, (belief.x.y - z) / sigma, np.eye(self.m) / sigma)


def rmse(history: list[Taken], truth: FloatArray, skip: int = 0) -> float:
    x = np.array([t.belief.x.y for t in history])
    return float(np.sqrt(np.mean((x - truth)[skip:] ** 2)))


def adaptive(**how: object) -> Policy:
    return Policy(0.9999, Adaptation.model_validate(how))


def variance(monitor: Monitor, stated: float) -> FloatArray:
    """What is believed of the noise, in the units of the measurement."""
    return stated * monitor.noise.R
