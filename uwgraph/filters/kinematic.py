"""The kinematic model: a vehicle that goes where its log and its gyro say, and how it is measured.

State: north, east, down [m] and heading [rad] in n, then, where they are estimated, biases of the inputs. Inputs are
the velocity u, v, w along the levelled axes of the vehicle (forward, starboard, down) and the rate r of its heading:

    N' = u cos psi - v sin psi,  E' = u sin psi + v cos psi,  D' = w,  psi' = r.

n is taken for flat and level: at 1 km from the origin it is 8 cm above the sea surface, at 10 km 8 m. The heading is
unwrapped, residuals wrap.

Where the log is lost the last velocity goes on, and errs by a random walk since: its integral's variance grows as
white noise's of the density walk * age would let it. That noise is what the model takes, so that it needs no state for
the velocity; a fix does not correct the velocity, and so the position's sigma grows too fast after it, never too slow.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from uwgraph.dive.rig import NonNegative, Positive, Settings
from uwgraph.errors import DataError
from uwgraph.filters.state import Belief, Index, State
from uwgraph.frames import rph_from_matrix, wrap_pi
from uwgraph.types import FloatArray, Stream

VEHICLE = 4
POSITION, DOWN, PSI = slice(0, 3), 2, 3
NO_ROTATIONS = np.empty(0, dtype=np.int64)


class InputNoise(Settings):
    """Noise of the inputs: white, and biases that are estimated where they are not stated as zero."""

    velocity_density: Positive = 0.01
    """m/s/sqrt(Hz) per axis; of a log that pings once in T seconds: sigma sqrt(T)."""
    rate_density: Positive = 1e-4
    """rad/s/sqrt(Hz)."""
    velocity_bias_sigma: NonNegative = 0.0
    """m/s, at the start."""
    rate_bias_sigma: NonNegative = 0.0
    """rad/s, at the start."""
    velocity_bias_walk: NonNegative = 0.0
    """m/s/sqrt(s) per axis."""
    sinking_bias_walk: NonNegative = 0.0
    """m/s/sqrt(s), beside it: speed that a wrong tilt turns into sinking."""
    rate_bias_walk: NonNegative = 0.0
    """rad/s/sqrt(s)."""
    velocity_walk: NonNegative = 0.1
    """m/s/sqrt(s) per axis: how fast the vehicle changes the velocity that nobody measures."""

    @property
    def biased(self) -> bool:
        """Whether biases are in the state."""
        return any((self.velocity_bias_sigma, self.rate_bias_sigma, *np.diag(self.bias_walk)))

    @property
    def bias_walk(self) -> FloatArray:
        """Density's root of the biases' walk, shape (4, 4)."""
        sinking = np.hypot(self.velocity_bias_walk, self.sinking_bias_walk)
        return np.diag([self.velocity_bias_walk, self.velocity_bias_walk, sinking, self.rate_bias_walk])

    @property
    def root(self) -> FloatArray:
        """Root of the white noise's spectral density, shape (4, 4)."""
        return _per_input(self.velocity_density, self.rate_density)

    def aged(self, root: FloatArray, age_s: float) -> FloatArray:
        """The root of a density where the velocity is as old as that."""
        if age_s == 0.0:
            return root
        walked = _per_input(self.velocity_walk * age_s, 0.0)
        return np.asarray(np.linalg.cholesky(root @ root.T + walked**2))


@dataclass(frozen=True, eq=False)
class Inputs(Stream):
    """What the vehicle does; the sample at t_i is the mean over (t_{i-1}, t_i]."""

    u: FloatArray
    """Forward, starboard and down velocity in levelled axes [m/s], rate of the heading [rad/s], shape (N, 4)."""
    age_s: FloatArray = field(default_factory=lambda: np.empty(0))
    """How old the velocity is at most; zero, also where left out, for what the log tells, shape (N,)."""

    def __post_init__(self) -> None:
        if not len(self.age_s):
            object.__setattr__(self, "age_s", np.zeros(len(self.t_ns)))
        if self.age_s.shape != self.t_ns.shape or not np.all((self.age_s >= 0.0) & np.isfinite(self.age_s)):
            raise DataError(
                "ages are not negative and of shape (N,)", where="inputs", remedy="zero where it is measured"
            )
        if self.u.shape != (len(self.t_ns), 4) or not np.all(np.isfinite(self.u)):
            raise DataError("inputs are finite and of shape (N, 4)", where="inputs", remedy="leave out broken samples")
        if np.any(np.diff(self.t_ns) <= 0):
            raise DataError("stamps do not increase", where="inputs", remedy="sort the samples and leave out doubles")


def levelled(v_b: FloatArray, R_nb: FloatArray) -> FloatArray:
    """Velocities in body axes, shape (N, 3), along forward, starboard and down of the levelled vehicle."""
    v_n: FloatArray = np.einsum("nij,nj->ni", R_nb, v_b)
    v_n[:, 0], v_n[:, 1] = turned(-rph_from_matrix(R_nb)[:, 2], v_n[:, 0], v_n[:, 1])
    return v_n


def turned(psi: ArrayLike, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """A horizontal vector turned by psi: from levelled axes to n."""
    c, s = np.cos(psi), np.sin(psi)
    return np.asarray(c * x - s * y), np.asarray(s * x + c * y)


@dataclass(frozen=True)
class Kinematic:
    """Layout and process model."""

    noise: InputNoise

    @property
    def size(self) -> int:
        """Length of the tangent: 4, or 8 with biases."""
        return 2 * VEHICLE if self.noise.biased else VEHICLE

    def start(self, t_ns: int, p_n: ArrayLike, psi: float, P: ArrayLike) -> Belief:
        """A belief about position [m] and heading [rad] with their covariance, shape (4, 4), and unknown biases."""
        y, S = np.zeros(self.size), np.zeros((self.size, self.size))
        y[POSITION], y[PSI] = p_n, psi
        S[:VEHICLE, :VEHICLE] = np.linalg.cholesky(np.asarray(P))
        if self.noise.biased:
            S[VEHICLE:, VEHICLE:] = _per_input(self.noise.velocity_bias_sigma, self.noise.rate_bias_sigma)
        return Belief(t_ns, State(np.empty((0, 3, 3)), y, NO_ROTATIONS), S)

    def move(self, x: State, dt: float, u: FloatArray) -> State:
        """M states after ``dt`` seconds of constant inputs: an arc, by its chord."""
        true = u - x.y[:, VEHICLE : 2 * VEHICLE] if self.noise.biased else np.broadcast_to(u, (len(x.y), VEHICLE))
        angle = true[:, 3] * dt
        chord = dt * np.sinc(angle / (2.0 * np.pi))
        north, east = turned(x.y[:, PSI] + 0.5 * angle, chord * true[:, 0], chord * true[:, 1])
        y = x.y.copy()
        y[:, :VEHICLE] += np.column_stack([north, east, dt * true[:, 2], angle])
        return State(x.R, y, x.rot)

    def by_inputs(self, psi: float, dt: float, u: FloatArray) -> FloatArray:
        """Derivative of :meth:`move`'s position and heading by the inputs, shape (4, 4)."""
        angle = u[3] * dt
        sinc = float(np.sinc(angle / (2.0 * np.pi)))
        slope = -angle / 12.0 if abs(angle) < 1e-3 else (np.cos(0.5 * angle) - sinc) / angle
        middle = psi + 0.5 * angle
        (c, s), (n, e) = turned(middle, 1.0, 0.0), turned(middle, u[0], u[1])
        B = dt * np.eye(VEHICLE)
        B[:2, :2] = dt * sinc * np.array([[c, -s], [s, c]])
        B[:2, 3] = dt * dt * (slope * np.array([n, e]) + 0.5 * sinc * np.array([-e, n]))
        return B

    def noise_rows(self, psi: float, dt: float, u: FloatArray, root: FloatArray) -> FloatArray:
        """Rows whose squares are the noise of one step: the inputs' by its derivative, and the biases' walk.

        The motion is linear in u, v, w and nearly so in r, so that sigma points of the noise would tell nothing more.

        Parameters
        ----------
        root
            Root of the white noise's density, shape (4, 4).
        """
        rows = np.zeros((self.size, self.size))
        rows[:VEHICLE, :VEHICLE] = (self.by_inputs(psi, dt, u) @ root).T / np.sqrt(dt)
        if self.noise.biased:
            rows[VEHICLE:, VEHICLE:] = np.sqrt(dt) * self.noise.bias_walk
        return rows


def _per_input(velocity: float, rate: float) -> FloatArray:
    return np.diag([velocity, velocity, velocity, rate])


def whitener(cov: FloatArray, m: int, where: str) -> FloatArray:
    """W with W cov W^T = 1, shape (m, m); raises :class:`DataError` for what is no covariance."""
    try:
        if np.shape(cov) != (m, m) or not np.allclose(cov, np.transpose(cov)):
            raise np.linalg.LinAlgError
        return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))
    except np.linalg.LinAlgError:
        raise DataError(f"no covariance of {m} numbers", where=where, remedy="give a positive definite one") from None


@dataclass(frozen=True, eq=False)
class Direct:
    """A measurement of numbers of the state themselves; see :func:`heading`, :func:`depth` and :func:`fix`."""

    t_ns: int
    kind: str
    """The sensor: measurements of one kind share their noise statistics."""
    at: Index
    """Which numbers, shape (m,)."""
    value: FloatArray
    """Shape (m,)."""
    cov: FloatArray
    """Shape (m, m)."""

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.value)):
            raise DataError("not finite", where=f"measurement {self.kind!r}", remedy="leave out broken samples")
        _ = self.whitener

    @cached_property
    def whitener(self) -> FloatArray:
        """Shape (m, m)."""
        return whitener(self.cov, len(self.at), f"measurement {self.kind!r}")

    def residual(self, x: State) -> FloatArray:
        """Whitened residuals of M states, shape (M, m)."""
        off = x.y[:, self.at] - self.value
        off[:, self.at == PSI] = unwrapped(off[:, self.at == PSI])
        return np.asarray(off @ self.whitener.T)


def unwrapped(angles: FloatArray) -> FloatArray:
    """Angles of sigma points, the first their centre, shape (M, k): within half a turn of it, and it of zero."""
    centre = wrap_pi(angles[0])
    return np.asarray(centre + wrap_pi(angles - angles[0]))


def heading(t_ns: int, psi: float, sigma: float, kind: str = "heading") -> Direct:
    """Heading against true north [rad], as of a compass or of the sun."""
    return Direct(t_ns, kind, np.array([PSI]), np.array([psi]), np.array([[sigma**2]]))


def depth(t_ns: int, below: float, sigma: float, kind: str = "depth") -> Direct:
    """Depth below the surface [m]."""
    return Direct(t_ns, kind, np.array([DOWN]), np.array([below]), np.array([[sigma**2]]))


def fix(t_ns: int, p_n: ArrayLike, cov: ArrayLike, kind: str = "fixes") -> Direct:
    """Position in n [m]: all of it, or north and east."""
    p = np.asarray(p_n, dtype=np.float64)
    return Direct(t_ns, kind, np.arange(len(p)), p, np.asarray(cov, dtype=np.float64))
