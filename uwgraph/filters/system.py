"""The noise of the kinematic model's inputs, learnt from what measurements move the filter by (Sage & Husa 1969)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from uwgraph.filters.kinematic import PSI, VEHICLE, turned
from uwgraph.filters.settings import Adaptation
from uwgraph.filters.state import Belief
from uwgraph.filters.statistics import fading_weight, system_mean, system_noise
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class System:
    """What a filter believes of its inputs' noise."""

    root: FloatArray
    """Root of the white noise's density, shape (4, 4)."""
    mean: FloatArray = field(default_factory=lambda: np.zeros(VEHICLE))
    """What the inputs lack, shape (4,); zero unless it is estimated."""
    count: int = 0
    """Epochs it was learnt from."""
    nonpositive: int = 0
    """How often the estimate would have lost its definiteness, and was left as it was."""

    def learnt(self, before: Belief, after: Belief, elapsed_s: float, how: Adaptation, with_mean: bool) -> System:
        """With an epoch more: the beliefs before and after its measurements, and the time since the last epoch.

        As noise of the inputs: turned into the vehicle's axes, and by time.
        """
        turn = np.eye(VEHICLE)
        turn[:2, :2] = np.array(turned(-before.x.y[PSI], np.eye(2)[0], np.eye(2)[1]))
        gained = turn @ before.x.to(after.x)[:VEHICLE]
        P, P_minus = (turn @ b.S[:VEHICLE] @ b.S[:VEHICLE].T @ turn.T / elapsed_s for b in (after, before))
        Q = self.root @ self.root.T
        d = fading_weight(self.count + 1, how.memory, how.start)
        mean = system_mean(self.mean, self.mean + gained / elapsed_s, d) if with_mean else self.mean
        Q = system_noise(Q, gained / np.sqrt(elapsed_s), P, P_minus - Q, d)
        try:
            return System(np.asarray(np.linalg.cholesky(Q)), mean, self.count + 1, self.nonpositive)
        except np.linalg.LinAlgError:
            return replace(self, mean=mean, count=self.count + 1, nonpositive=self.nonpositive + 1)
