"""A real dive's reference as a motion, so that sensors can be simulated along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly
from scipy.spatial.transform import Rotation, RotationSpline

from uwgraph.dive import Dive
from uwgraph.dive.body_reference import body_reference
from uwgraph.errors import DataError
from uwgraph.frames import R_n_local, matrix_from_rph, ned_from_geodetic
from uwgraph.types import FloatArray, Origin


@dataclass(frozen=True, eq=False)
class ReferenceMotion:
    """A :class:`uwgraph.simulate.trajectory.Motion` through the samples of a reference.

    Position is the cubic through position and velocity at every sample (a cubic spline where the reference has no
    velocity), velocity its derivative; attitude is a spline of rotations with continuous angular rate.
    """

    origin: Origin
    start_ns: int
    duration_s: float
    p_n: PPoly
    R_nb: RotationSpline

    @classmethod
    def of(cls, dive: Dive) -> ReferenceMotion:
        """The motion of the body origin as the dive's reference tells it, over the samples with position and attitude.

        Raises
        ------
        DataError
            When there is no reference, or fewer than two such samples, or stamps that do not increase.
        """
        of_body = body_reference(dive)
        if of_body is None:
            raise DataError(
                "the dive has no reference (two samples at least) to simulate along",
                where="reference",
                remedy="add reference.parquet",
            )
        known = np.isfinite(np.column_stack([of_body.lat, of_body.lon, of_body.height]))
        reference = of_body.select(known.all(axis=1) & np.isfinite(of_body.rph).all(axis=1))
        if len(reference) < 2:
            raise DataError(
                "the reference knows position and attitude together at fewer than two times",
                where="reference",
                remedy="give a reference with lat, lon, height, roll, pitch and heading",
            )
        t = reference.t_s
        backward = np.flatnonzero(np.diff(t) <= 0.0)
        if len(backward):
            raise DataError(
                f"the stamps do not increase after sample {backward[0]}",
                where="reference.t_ns",
                remedy="remove the repeated or backward samples",
            )
        p_n = ned_from_geodetic(dive.origin, reference.lat, reference.lon, reference.height)
        R_nl = R_n_local(dive.origin, reference.lat, reference.lon)
        v_n = np.einsum("nij,nj->ni", R_nl, reference.v_n)
        position = CubicHermiteSpline(t, p_n, v_n) if np.isfinite(v_n).all() else CubicSpline(t, p_n)
        attitude = RotationSpline(t, Rotation.from_matrix(R_nl @ matrix_from_rph(reference.rph)))
        return cls(dive.origin, int(reference.t_ns[0]), float(t[-1]), position, attitude)

    def position(self, t: FloatArray) -> FloatArray:
        """p_n, shape (N, 3), m."""
        return np.asarray(self.p_n(t))

    def velocity(self, t: FloatArray) -> FloatArray:
        """v_n over the ground, shape (N, 3), m/s."""
        return np.asarray(self.p_n(t, 1))

    def attitude(self, t: FloatArray) -> FloatArray:
        """R_nb, shape (N, 3, 3)."""
        return np.asarray(self.R_nb(t).as_matrix())

    def angular_rate(self, t: FloatArray) -> FloatArray:
        """Rate of b against n in body axes, shape (N, 3), rad/s."""
        return np.asarray(self.R_nb(t, 1))
