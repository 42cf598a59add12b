"""What becomes of a measurement: used, refused, or a sign that the noise or the state is not what was believed.

One monitor follows each kind of measurement. A measurement beyond the gate is refused as an outlier, as long as it is
alone. Where most of the recent ones are beyond it, it is the filter that is wrong. Do their innovations lie on one
side, the state is not where the filter believes: its covariance grows until they fit, and the next good measurement
finds it. Are they on both sides, the noise has grown: a filter of fixed noise takes each as one of so much noise that
it lies on the gate, and an adaptive one learns from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

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
JUMP = 8
"""Innovations whose median tells an adaptive filter, which knows the noise, of a jump."""
MAD = 1.4826
"""Standard deviations in a median absolute deviation of a normal distribution."""
See = Callable[[Belief], Seen]
"""A measurement's whitened residual over a belief."""
LOST = 8.0
"""Deviations of the median of the recent innovations from which on a filter of fixed noise takes itself for lost.

Noise that is larger than stated must not look like it: of a few innovations most lie close together by chance, and one
time in a thousand far from zero.
"""
FADING = 0.95
"""Weight of the former innovations in their covariance, where nothing else is asked for."""


@dataclass(frozen=True, eq=False)
class Monitor:
    """What a filter knows of one kind of measurement."""

    noise: Noise
    excess: tuple[float, ...] = ()
    """Squared Mahalanobis distances of the recent ones over the gate's."""
    innovations: tuple[FloatArray, ...] = ()
    """The last few, white where the filter is right."""
    V: FloatArray | None = None
    """Covariance of the innovations with fading memory, white units."""
    nonpositive: int = 0
    """How often the estimate of the noise would have lost its definiteness."""

    @property
    def mostly_large(self) -> bool:
        """Whether most of the recent ones were beyond the gate."""
        return 2 * sum(x > 1.0 for x in self.excess) > max(len(self.excess), RECENT // 2)

    def one_sided(self, sigmas: float, last: int) -> bool:
        """Whether the median of so many last innovations is further from zero than ``sigmas`` of their own deviations.

        Medians, so that outliers among them change little; their own deviations, since noise that has grown is on both
        sides, however large it is.
        """
        if len(self.innovations) < last:
            return False
        recent = np.array(self.innovations[-last:])
        median = np.median(recent, axis=0)
        scatter = np.maximum(MAD * np.median(np.abs(recent - median), axis=0), 1.0)
        return bool((np.abs(median) / scatter).max() > sigmas)

    def after(self, white: FloatArray, excess: float, rho: float) -> Monitor:
        """With one more measurement."""
        return replace(
            self,
            excess=(*self.excess, excess)[-RECENT:],
            innovations=(*self.innovations, white)[-RECENT:],
            V=innovation_covariance(self.V, white, rho),
        )


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

    def judged(self, t_ns: int, kind: str) -> Judged:
        """What is kept of it."""
        return Judged(t_ns, kind, self.whitened, self.nis, self.accepted, self.noise, self.fading)


@dataclass(frozen=True, eq=False)
class Judged:
    """What a filter made of a measurement: a row of :class:`uwgraph.types.Innovations`."""

    t_ns: int
    kind: str
    whitened: FloatArray
    nis: float
    accepted: bool
    noise: FloatArray
    fading: float


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
        monitor = monitor or Monitor(Noise.stated(len(seen.mean)))
        how = self.adaptation if opens else None
        seen = replace(seen, mean=seen.mean - monitor.noise.r)
        S_R = np.asarray(np.linalg.cholesky(monitor.noise.R))
        believed = seen.with_noise(S_R)
        white = believed.whiten(seen.mean)
        d2, limit = float(white @ white), self.limit(self.gate, len(white))
        monitor = monitor.after(white, d2 / limit, FADING if how is None else how.fading_memory)
        judged = partial(
            Taken,
            whitened=seen.mean,
            nis=d2 / len(white),
            noise=np.sqrt(monitor.noise.R.diagonal()),
        )
        if opens and how is None and monitor.mostly_large and monitor.one_sided(LOST, RECENT):
            median = believed.S_z @ np.median(np.array(monitor.innovations), axis=0)
            return self._found_again(*explaining(belief, seen, median), see, monitor, judged)
        fading = self._fading(seen, believed, monitor, how) if how is not None else 1.0
        if fading > 1.0:
            return self._found_again(belief.grown(fading), fading, see, monitor, judged)
        if d2 > limit and not (opens and monitor.mostly_large):
            return judged(belief, monitor, accepted=False)
        bounded = believed if d2 <= limit else seen.with_noise(np.sqrt(d2 / limit) * S_R)
        after = moved_by(belief, seen, bounded)
        if how is not None:
            monitor = self._learn(monitor, seen, see(after), how)
        return judged(after, monitor, accepted=True)

    def _found_again(
        self, grown: Belief, fading: float, see: See, monitor: Monitor, judged: Callable[..., Taken]
    ) -> Taken:
        """A state that was not where it was believed to be, with the measurement where it passes the gate now."""
        seen = see(grown)
        seen = replace(seen, mean=seen.mean - monitor.noise.r)
        believed = seen.with_noise(np.asarray(np.linalg.cholesky(monitor.noise.R)))
        white = believed.whiten(seen.mean)
        accepted = float(white @ white) <= self.limit(self.gate, len(white))
        after = moved_by(grown, seen, believed) if accepted else grown
        return judged(after, monitor, accepted=accepted, fading=fading)

    def _fading(self, seen: Seen, believed: Conditioned, monitor: Monitor, how: Adaptation) -> float:
        """What the covariance is to be multiplied by, because the prediction and not the noise is to blame."""
        m = len(seen.mean)
        if how.convergence == "document":
            P_zz = believed.S_z @ believed.S_z.T
            diverged = seen.mean @ seen.mean > how.document_S * np.trace(P_zz)
        else:
            large = monitor.excess[-1] * self.limit(self.gate, m) > self.limit(how.divergence, m)
            diverged = large and monitor.one_sided(how.jump, JUMP)
        if not diverged:
            return 1.0
        assert monitor.V is not None
        whiten = believed.whiten(seen.Z.T)
        return fading_factor(monitor.V, np.eye(len(monitor.V)), whiten @ whiten.T, how.most_fading)

    def _learn(self, monitor: Monitor, before: Seen, after: Seen, how: Adaptation) -> Monitor:
        """The noise statistics with one more measurement."""
        noise = monitor.noise
        d = fading_weight(noise.count + 1, how.memory, how.start)
        if how.noise == "residual":
            # the spread afterwards by the linear formula: what wide sigma points see of second order is no noise
            spread = noise.R @ np.linalg.solve(before.spread + noise.R, before.spread)
            return replace(monitor, noise=residual_noise(noise, after.mean - noise.r, spread, d, how.cap))
        learnt = unbiased_noise(noise, before.mean, before.spread, d)
        if learnt is None:
            return replace(monitor, nonpositive=monitor.nonpositive + 1)
        return replace(monitor, noise=learnt)


def explaining(belief: Belief, seen: Seen, innovation: FloatArray) -> tuple[Belief, float]:
    """The belief grown by the smallest change of state that explains an innovation, and by which factor along it.

    The state errs by S u with unit normal u; the smallest u is g = U^T Z (Z^T Z)^+ v, and I becomes I + g g^T. What the
    measurement tells nothing of grows no more than it is correlated with what it does.
    """
    g = seen.U.T @ (seen.Z @ (np.linalg.pinv(seen.spread, hermitian=True) @ innovation))
    a = len(g)
    S = belief.S.copy()
    S[:, :a] = S[:, :a] @ np.linalg.cholesky(np.eye(a) + np.outer(g, g))
    return replace(belief, S=S), float(1.0 + g @ g)
