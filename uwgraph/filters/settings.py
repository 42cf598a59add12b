"""What the user can choose about a filter."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from uwgraph.dive.rig import NonNegative, Positive, Settings
from uwgraph.graph.settings import Quantile


class SigmaPoints(Settings):
    """How far sigma points lie from the mean: see :class:`uwgraph.filters.unscented.Spread`."""

    alpha: Positive = 1.0
    beta: NonNegative = 2.0
    kappa: NonNegative = 0.0


class Adaptation(Settings):
    """How an adaptive filter learns the noise of its sensors, and when it distrusts its own prediction."""

    noise: Literal["residual", "unbiased"] = "residual"
    """Estimator of R. ``residual`` stays positive definite; ``unbiased``, with innovations, does not always."""
    memory: Annotated[float, Field(ge=0.5, lt=1.0)] = 0.995
    """b of the fading memory: what weight a measurement has in comparison with the next one."""
    start: Annotated[int, Field(ge=0)] = 30
    """k0: how many measurements the stated noise counts for; 0 forgets it with the first."""
    cap: Positive = 25.0
    """A residual counts for no more than this many times the noise believed."""
    convergence: Literal["chi2", "document"] = "chi2"
    """Criterion of divergence: a chi-square quantile with a test for what diverges, or v^T v <= S tr E[v v^T]."""
    document_S: Annotated[float, Field(ge=1.0)] = 1.0
    """S of the document's criterion."""
    divergence: Quantile = 0.999
    """Share of good measurements that the chi-square criterion takes for good."""
    jump: Positive = 6.0
    """Median of the last eight innovations, in their own deviations, from which on the state has jumped."""
    fading_memory: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.95
    """rho: weight of the former innovations in their covariance."""
    most_fading: Annotated[float, Field(ge=1.0)] = 10.0
    """Largest fading factor; 1 switches fading off."""


class FilterSettings(Settings):
    """Settings of every filter; the first state's are those of :class:`uwgraph.graph.SmoothSettings`."""

    samples_per_step: Annotated[int, Field(ge=1, le=100)] = 1
    """IMU samples joined into one step of the prediction, coning and sculling accounted for."""
    sigma_points: SigmaPoints = SigmaPoints()
    adaptation: Adaptation = Adaptation()
    gate: Quantile = 0.9999
    """Share of good measurements that pass the gate."""
    gyro_drift: Literal["walk", "constant and Markov"] = "walk"
    """Model of the gyro's bias; with the second the accelerometer's is Markov as well."""
    gyro_tau_s: Positive = 3600.0
    accel_tau_s: Positive = 3600.0
    """Correlation times of the Markov drifts."""
    delays_s: dict[str, NonNegative] = Field(default_factory=dict)
    """How late measurements of a kind reach the filter, e.g. ``{sun: 2.0}``."""
    max_nodes: Annotated[int, Field(ge=0, le=200)] = 20
    """Poses remembered at a time for places seen again; 0 leaves closures alone."""
