"""What becomes of a measurement: used, refused, or a sign that the noise or the state is not what was believed.

One monitor follows each kind of measurement. A filter that does not adapt only has the gate, and opens it where most of
the recent measurements were refused: then the filter is wrong, not they. An adaptive one asks what it is: a jump of
the state (innovations that lie on one side: the covariance is faded), a change of the noise (most of the recent ones
are large: learnt from), or an outlier (a single one: refused).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammaincinv

from uwgraph.filters.roots import Conditioned
from uwgraph.filters.settings import Adaptation
from uwgraph.filters.state import Belief
from uwgraph.filters.statistics import (
    Noise,
    fading_factor,
    fading_weight,
    innovation_covariance,
    residual_noise,
    unbiased_noise,
)
from uwgraph.filters.unscented import Seen, moved_by
from uwgraph.types import FloatArray

RECENT = 16
"""Measurements whose majority decides whether the filter is wrong or the measurement."""
JUMP = 4
"""Innovations whose mean tells a jump."""
See = Callable[[Belief], Seen]
"""A measurement's whitened residual over a belief."""


@dataclass(frozen=True, eq=False)
class Monitor:
    """What a filter knows of one kind of measurement."""

    noise: Noise
    large: tuple[bool, ...] = ()
    """Whether each of the recent ones was beyond the gate."""
    innovations: tuple[FloatArray, ...] = ()
    """The last few, white where the filter is right."""
    V: FloatArray | None = None
    """Covariance of the innovations with fading memory, white units."""
    nonpositive: int = 0
    """How often the estimate of the noise would have lost its definiteness."""

    @property
    def mostly_large(self) -> bool:
        return 2 * sum(self.large) > max(len(self.large), RECENT // 2)


@dataclass(frozen=True, eq=False)
class Taken:
    """A belief after a measurement, and what was made of it."""

    belief: Belief
    monitor: Monitor
    whitened: FloatArray
    """Innovation in units of the stated sigma, shape (m,)."""
    nis: float
    """Over m."""
    accepted: bool
    noise: FloatArray
    """1-sigma believed, shape (m,)."""
    fading: float = 1.0


@dataclass(frozen=True)
class Policy:
    """How measurements are judged."""

    gate: float
    """Quantile of the chi-square distribution."""
    adaptation: Adaptation | None = None
    """None: fixed noise."""
    _limits: dict[tuple[float, int], float] = field(default_factory=dict, repr=False, compare=False)

    def limit(self, quantile: float, m: int) -> float:
        """Quantile of chi-square with m degrees of freedom."""
        key = (quantile, m)
        if key not in self._limits:
            self._limits[key] = float(2.0 * gammaincinv(m / 2.0, quantile))
        return self._limits[key]

    def take(self, belief: Belief, see: See, monitor: Monitor | None, opens: bool = True) -> Taken:
        """Judge a measurement and use it; ``opens``: where most are refused the filter is to blame, not they."""
        seen = see(belief)
        m = len(seen.mean)
        monitor = monitor or Monitor(Noise.stated(m))
        if self.adaptation is None or not opens:
            return self._fixed(belief, seen, monitor, opens)
        return self._adaptive(belief, see, seen, monitor, self.adaptation)

    def _fixed(self, belief: Belief, seen: Seen, monitor: Monitor, opens: bool) -> Taken:
        m = len(seen.mean)
        believed = seen.with_noise(np.eye(m))
        white = believed.whiten(seen.mean)
        d2 = float(white @ white)
        monitor = _remember(monitor, white, d2 > self.limit(self.gate, m))
        accepted = d2 <= self.limit(self.gate, m) or (opens and monitor.mostly_large)
        after = moved_by(belief, seen, believed) if accepted else belief
        return Taken(after, monitor, seen.mean, d2 / m, accepted, np.ones(m))

    def _adaptive(self, belief: Belief, see: See, seen: Seen, monitor: Monitor, how: Adaptation) -> Taken:
        m, noise = len(seen.mean), monitor.noise
        seen = replace(seen, mean=seen.mean - noise.r)
        S_R = np.asarray(np.linalg.cholesky(noise.R))
        believed = seen.with_noise(S_R)
        white = believed.whiten(seen.mean)
        d2 = float(white @ white)
        monitor = _remember(monitor, white, d2 > self.limit(self.gate, m))
        monitor = replace(monitor, V=innovation_covariance(monitor.V, white, how.fading_memory))

        def taken(after: Belief, monitor: Monitor, accepted: bool, fading: float = 1.0) -> Taken:
            return Taken(after, monitor, seen.mean, d2 / m, accepted, np.sqrt(noise.R.diagonal()), fading)

        if self._diverged(white, seen, believed, monitor, how):
            fading = self._fading(seen, believed, monitor, how)
            faded = belief.grown(fading)
            again = see(faded)
            return taken(moved_by(faded, again, again.with_noise(S_R)), monitor, True, fading)
        if d2 > self.limit(self.gate, m) and not monitor.mostly_large:
            return taken(belief, monitor, False)
        after = moved_by(belief, seen, believed)
        return taken(after, self._learn(monitor, seen, see(after), how), True)

    def _diverged(
        self, white: FloatArray, seen: Seen, believed: Conditioned, monitor: Monitor, how: Adaptation
    ) -> bool:
        """Whether the prediction, not the noise, is to blame."""
        m, d2 = len(white), float(white @ white)
        if how.convergence == "document":
            P_zz = believed.S_z @ believed.S_z.T
            return bool(seen.mean @ seen.mean > how.document_S * np.trace(P_zz))
        if d2 <= self.limit(how.divergence, m) or len(monitor.innovations) < JUMP:
            return False
        mean = np.mean(monitor.innovations, axis=0)
        return bool(np.abs(mean).max() * np.sqrt(JUMP) > how.jump)

    def _fading(self, seen: Seen, believed: Conditioned, monitor: Monitor, how: Adaptation) -> float:
        assert monitor.V is not None
        whiten = believed.whiten(seen.Z.T)
        return fading_factor(monitor.V, np.eye(len(monitor.V)), whiten @ whiten.T, how.most_fading)

    def _learn(self, monitor: Monitor, before: Seen, after: Seen, how: Adaptation) -> Monitor:
        """The noise statistics with one more measurement."""
        noise = monitor.noise
        d = fading_weight(noise.count + 1, how.memory, how.start)
        if how.noise == "residual":
            return replace(monitor, noise=residual_noise(noise, after.mean - noise.r, after.spread, d, how.cap))
        learnt = unbiased_noise(noise, before.mean, before.spread, d)
        if learnt is None:
            return replace(monitor, nonpositive=monitor.nonpositive + 1)
        return replace(monitor, noise=learnt)


def _remember(monitor: Monitor, white: FloatArray, large: bool) -> Monitor:
    return replace(
        monitor,
        large=(*monitor.large, large)[-RECENT:],
        innovations=(*monitor.innovations, white)[-JUMP:],
    )
