"""The truth: one smooth motion on the rotating ellipsoid, from which every sensor is derived.

Position and attitude *are* B-splines of degree 7 in time. Velocity, acceleration and angular rate are their exact
derivatives, so nothing here integrates anything, and no integrator can be favoured by sharing its errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from uwgraph.frames import earth_rate_n, gravity_n, matrix_from_rph
from uwgraph.types import FloatArray, Origin

DEGREE: Final = 7


class Motion(Protocol):
    """What a sensor needs to know of a vehicle's motion; times are seconds after ``start_ns``, shape (N,)."""

    @property
    def origin(self) -> Origin: ...

    @property
    def start_ns(self) -> int: ...

    @property
    def duration_s(self) -> float: ...

    def position(self, t: FloatArray) -> FloatArray:
        """p_n, shape (N, 3), m."""

    def velocity(self, t: FloatArray) -> FloatArray:
        """v_n over the ground, shape (N, 3), m/s."""

    def attitude(self, t: FloatArray) -> FloatArray:
        """R_nb, shape (N, 3, 3)."""

    def angular_rate(self, t: FloatArray) -> FloatArray:
        """Rate of b against n in body axes, shape (N, 3), rad/s."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion given by splines; see :meth:`through`."""

    origin: Origin
    start_ns: int
    duration_s: float
    p_n: BSpline
    """Position in n, m."""
    rph_n: BSpline
    """Roll, pitch and unwrapped heading of b against the axes of n, rad."""
    g_n: BSpline
    """Gravity at the vehicle's place, m/s^2."""

    @classmethod
    def through(
        cls, origin: Origin, start_ns: int, duration_s: float, t: FloatArray, p_n: FloatArray, rph_n: FloatArray
    ) -> Trajectory:
        """The splines through samples at ``t`` [s], shape (K,), with ``p_n`` and ``rph_n``, shape (K, 3).

        The samples must reach over both ends of [0, duration_s] and be dense enough for what moves (0.25 s apart for
        periods of 3 s and more).
        """
        return cls(
            origin,
            start_ns,
            duration_s,
            p_n=make_interp_spline(t, p_n, k=DEGREE),
            rph_n=make_interp_spline(t, rph_n, k=DEGREE),
            g_n=make_interp_spline(t, gravity_n(origin, p_n), k=3),
        )

    @cached_property
    def _v_n(self) -> BSpline:
        return self.p_n.derivative(1)

    @cached_property
    def _a_n(self) -> BSpline:
        return self.p_n.derivative(2)

    @cached_property
    def _rph_rate(self) -> BSpline:
        return self.rph_n.derivative(1)

    def position(self, t: ArrayLike) -> FloatArray:
        """p_n, shape (N, 3), m."""
        return np.asarray(self.p_n(t))

    def velocity(self, t: ArrayLike) -> FloatArray:
        """v_n over the ground, shape (N, 3), m/s."""
        return np.asarray(self._v_n(t))

    def acceleration(self, t: ArrayLike) -> FloatArray:
        """Second derivative of p_n in n, shape (N, 3), m/s^2."""
        return np.asarray(self._a_n(t))

    def attitude(self, t: ArrayLike) -> FloatArray:
        """R_nb, shape (N, 3, 3)."""
        return matrix_from_rph(self.rph_n(t))

    def angular_rate(self, t: ArrayLike) -> FloatArray:
        """Rate of b against n in body axes, shape (N, 3), rad/s, from the rates of the Euler angles."""
        roll, pitch, _ = np.moveaxis(self.rph_n(t), -1, 0)
        roll_rate, pitch_rate, heading_rate = np.moveaxis(self._rph_rate(t), -1, 0)
        sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
        return np.stack(
            [
                roll_rate - heading_rate * sp,
                pitch_rate * cr + heading_rate * sr * cp,
                -pitch_rate * sr + heading_rate * cr * cp,
            ],
            axis=-1,
        )

    def inertial(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """What ideal inertial sensors feel at t: specific force and angular rate in b, shape (N, 3) each.

        f_b = R_nb^T (a_n + 2 w_ie x v_n - g_n),  w_ib_b = w_nb_b + R_nb^T w_ie_n; gravity holds the centrifugal force.
        """
        w_ie_n = earth_rate_n(self.origin)
        R_nb = self.attitude(t)
        f_n = self.acceleration(t) + 2.0 * np.cross(w_ie_n, self.velocity(t)) - self.g_n(t)
        f_b = np.einsum("...ji,...j->...i", R_nb, f_n)
        w_b = self.angular_rate(t) + np.einsum("...ji,j->...i", R_nb, w_ie_n)
        return f_b, w_b
