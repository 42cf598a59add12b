"""The inertial navigation system as a process on a manifold: what IMU samples do to a state and to its errors.

Tangent: rotation of the body (3), position in n (3), velocity in n (3), gyro bias (3), accelerometer bias (3); then,
where asked for, the gyro's Markov drift (3), the Doppler log's calibration (4) and remembered poses (rotation and
position, 6 each). In n, with right (body) errors; the equations of errors are those of Groves, Principles of GNSS,
Inertial, and Multisensor Integrated Navigation Systems, 14.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

import factors
from uwgraph.dive.rig import ImuRig
from uwgraph.filters import kernels
from uwgraph.filters.augment import augmented
from uwgraph.filters.state import Belief, State
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray

THETA, P, V, BG, BA = (slice(3 * i, 3 * i + 3) for i in range(5))
CORE = 15
NODE = 6
DRIFT = slice(CORE, CORE + 3)
INTEGRATION = 1e-5
"""m/sqrt(s), as in :class:`factors.ImuNoise`."""


Nodes = tuple[int, ...]
"""Moments of the poses that stand at the end of a state, in their order."""


@dataclass(frozen=True)
class GyroDrift:
    """The gyro's bias as a constant plus a first-order Gauss-Markov process, the accelerometer's as one alone.

    In the place of a bias that walks. The stationary sigma follows from the rig's walk: walk sqrt(tau / 2).
    """

    gyro_tau_s: float = 3600.0
    accel_tau_s: float = 3600.0


@dataclass(frozen=True)
class Ins:
    """Layout and process model of an inertial state."""

    noise: ImuRig
    drift: GyroDrift | None = None
    calibrated: bool = False
    """Whether the Doppler log's scale and mounting are in the state."""

    @property
    def drift_at(self) -> int:
        """Where the Markov drift begins; -1 where there is none."""
        return CORE if self.drift else -1

    @property
    def dvl_at(self) -> int:
        """Where the calibration begins; -1 where there is none."""
        return self.moving if self.calibrated else -1

    @property
    def moving(self) -> int:
        """How many numbers of the tangent the process moves: the first ones."""
        return CORE + 3 * (self.drift is not None)

    @property
    def size(self) -> int:
        """Length of the tangent without remembered poses."""
        return self.moving + factors.CALIBRATION_DIM * self.calibrated

    def state(self, R_nb: FloatArray, p_n: FloatArray, v_n: FloatArray) -> State:
        """A state without biases."""
        y = np.zeros(self.size)
        y[P], y[V] = p_n, v_n
        return State(R_nb[None].copy(), y, np.array([0]))

    def move(self, x: State, step: FloatArray, earth: FloatArray) -> State:
        """M states after one step, in place; ``step`` and ``earth`` as in :func:`kernels.propagate`."""
        kernels.propagate(x.R, x.y, step, earth, self.drift_at, self._decay(float(step[0])))
        return x

    def transition(self, x: State, step: FloatArray, earth: FloatArray) -> FloatArray:
        """Derivative of :meth:`move` at one state, shape (n, n)."""
        decay = self._decay(float(step[0]))
        F: FloatArray = kernels.transition(x.R[0], x.y, step, earth, self.drift_at, decay)
        return F

    def noise_rows(self, dt: float) -> FloatArray:
        """Rows whose squares are the noise of one step: white noise, integration and walks, shape (15, moving)."""
        return self._once("rows", dt, self._noise_rows)

    def _noise_rows(self, dt: float) -> FloatArray:
        rig, eye = self.noise, np.eye(3)
        white = rig.accel_noise_density * np.sqrt(dt)
        rows = np.zeros((CORE, self.moving))
        rows[0:3, THETA] = rig.gyro_noise_density * np.sqrt(dt) * eye
        rows[3:6, V], rows[3:6, P] = white * eye, 0.5 * dt * white * eye
        rows[6:9, P] = np.hypot(white * dt / np.sqrt(12.0), INTEGRATION * np.sqrt(dt)) * eye
        gyro, accel = np.array([rig.gyro_bias_walk, rig.accel_bias_walk]) * np.sqrt(self._walk_time(dt))
        rows[9:12, DRIFT if self.drift else BG] = gyro * eye
        rows[12:15, BA] = accel * eye
        return rows

    def _decay(self, dt: float) -> FloatArray:
        """What is left of the gyro's and the accelerometer's Markov drift after a step."""
        return self._once("decay", dt, lambda dt: np.exp(-dt / self._tau))

    @cached_property
    def _tau(self) -> FloatArray:
        return np.array([self.drift.gyro_tau_s, self.drift.accel_tau_s]) if self.drift else np.full(2, np.inf)

    def _walk_time(self, dt: float) -> FloatArray:
        """How long a walk takes to gain the variance that the drift gains in one step."""
        walks = np.isinf(self._tau)
        tau = np.where(walks, 1.0, self._tau)
        return np.where(walks, dt, -0.5 * tau * np.expm1(-2.0 * dt / tau))

    @cached_property
    def _made(self) -> dict[tuple[str, float], FloatArray]:
        return {}

    def _once(self, what: str, dt: float, make: Callable[[float], FloatArray]) -> FloatArray:
        """Made once for every length of step: an IMU has few."""
        key = (what, dt)
        if key not in self._made:
            self._made[key] = make(dt)
        return self._made[key]

    def node_at(self, nodes: Nodes, t_ns: int) -> int:
        """Where the pose remembered from a moment begins in the tangent."""
        return self.size + NODE * nodes.index(t_ns)

    def reach(self, observed: Observed, nodes: Nodes) -> int:
        """How many numbers of the tangent, from the first on, a measurement depends on at most."""
        return self.node_at(nodes, observed.node_ns) + NODE if "node" in observed.roles else self.size

    def remember(self, belief: Belief) -> Belief:
        """The belief with a copy of the body's pose at its end."""
        J = np.zeros((NODE, belief.x.size))
        J[:, :NODE] = np.eye(NODE)
        return augmented(belief, belief.x.y[:NODE], J, R=belief.x.R[0])

    def residuals(self, observed: Observed, x: State, nodes: Nodes = ()) -> FloatArray:
        """Whitened residuals of M states, shape (M, m); ``nodes`` are the moments of the poses at their end."""
        variables = [self._arrays(role, observed, x, nodes) for role in observed.roles]
        return np.asarray(observed.model.residuals(*variables) @ observed.whitener.T)

    def _arrays(self, role: str, observed: Observed, x: State, nodes: Nodes) -> Any:
        if role == "pose":
            return factors.Poses(x.R[:, 0], x.y[:, P])
        if role == "node":
            at = self.node_at(nodes, observed.node_ns) + 3
            return factors.Poses(x.R[:, 1 + nodes.index(observed.node_ns)], x.y[:, at : at + 3])
        if role == "velocity":
            return x.y[:, V]
        if role == "bias":
            gyro = x.y[:, BG] + (x.y[:, DRIFT] if self.drift else 0.0)
            return np.hstack([x.y[:, BA], gyro])
        if role == "dvl":
            calibrated = self.dvl_at >= 0
            return x.y[:, self.dvl_at : self.dvl_at + 4] if calibrated else np.zeros((len(x.y), 4))
        raise ValueError(f"an inertial state has no {role!r}")

    def jacobian(self, observed: Observed, x: State, nodes: Nodes = ()) -> FloatArray:
        """Derivative of the whitened residual at one state by as much as it reaches, shape (m, a)."""
        batch = State(x.R[None], x.y[None], x.rot)
        values = [_gtsam(role, self._arrays(role, observed, batch, nodes)) for role in observed.roles]
        H = np.zeros((len(observed.whitener), self.reach(observed, nodes)))
        for role, J in zip(observed.roles, observed.model.jacobians(*values), strict=True):
            W = observed.whitener @ J
            if role == "pose":
                H[:, THETA] += W[:, :3]
                H[:, P] += W[:, 3:] @ x.R[0].T
            elif role == "node":
                at = self.node_at(nodes, observed.node_ns)
                H[:, at : at + 3] += W[:, :3]
                H[:, at + 3 : at + 6] += W[:, 3:] @ x.R[1 + nodes.index(observed.node_ns)].T
            elif role == "velocity":
                H[:, V] += W
            elif role == "bias":
                H[:, BA] += W[:, :3]
                H[:, BG] += W[:, 3:]
                if self.drift:
                    H[:, DRIFT] += W[:, 3:]
            elif self.dvl_at >= 0:
                H[:, self.dvl_at : self.dvl_at + 4] += W
        return H


def _gtsam(role: str, arrays: Any) -> Any:
    if role in ("pose", "node"):
        return gtsam.Pose3(gtsam.Rot3(arrays.R_nb[0]), arrays.p_n[0])
    if role == "bias":
        return gtsam.imuBias.ConstantBias(arrays[0, :3], arrays[0, 3:])
    return arrays[0]


def start_root(sigmas: Sequence[FloatArray]) -> FloatArray:
    """Root of a block-diagonal covariance of lower roots, in the order of the tangent."""
    n = sum(len(s) for s in sigmas)
    S, at = np.zeros((n, n)), 0
    for s in sigmas:
        S[at : at + len(s), at : at + len(s)] = s
        at += len(s)
    return S
