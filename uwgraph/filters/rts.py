"""The Rauch-Tung-Striebel pass: a filter's beliefs, each corrected by what came after it.

With C = P F^T (P^-)^-1 the smoothed state is x + C (x_s - x^-), and its covariance (I - C F) P (I - C F)^T +
C (Q + P_s) C^T: a sum, so that it stays a covariance (Rauch, Tung & Striebel 1965, in Joseph's form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_solve

from uwgraph.filters.kalman import Extended
from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Passage:
    """From one epoch to the next."""

    before: Belief
    """After the measurements of the epoch it leaves."""
    after: Belief
    """Before those of the epoch it reaches."""
    F: FloatArray
    """Derivative of the one by the other, shape (n, n)."""
    S_Q: FloatArray
    """Lower root of the noise gained on the way, shape (n, n)."""


@dataclass(frozen=True)
class Remembering(Extended):
    """An extended filter that writes down where it went."""

    passages: list[Passage] = field(default_factory=list, repr=False, compare=False)

    def predict(self, belief: Belief, t_ns: int, steps: FloatArray, earth: FloatArray) -> Belief:
        core, n = belief.x.core(self.ins.moving), self.ins.moving
        F, S_Q = np.eye(belief.x.size), np.zeros((belief.x.size, belief.x.size))
        for step in steps:
            core, F_step, rows = self.linearized(core, step, earth)
            F[:n, :n] = F_step @ F[:n, :n]
            S_Q[:n, :n] = lower_root(np.concatenate([(F_step @ S_Q[:n, :n]).T, rows]))
        S = lower_root(np.concatenate([(F @ belief.S).T, S_Q.T]))
        after = Belief(t_ns, belief.x.with_core(core), S)
        self.passages.append(Passage(belief, after, F, S_Q))
        return after


def smoothed(passages: Sequence[Passage], last: Belief) -> list[Belief]:
    """The belief at the beginning of every passage given all measurements, and ``last`` at the end."""
    beliefs = [last]
    for passage in reversed(passages):
        beliefs.append(_back(passage, beliefs[-1]))
    return beliefs[::-1]


def _back(passage: Passage, following: Belief) -> Belief:
    before, after = passage.before, passage.after
    C = cho_solve((after.S, True), passage.F @ before.P).T
    x = before.x.plus(C @ after.x.to(following.x))
    rows = np.vstack([(before.S - C @ (passage.F @ before.S)).T, (C @ passage.S_Q).T, (C @ following.S).T])
    return replace(before, x=x, S=lower_root(rows))
