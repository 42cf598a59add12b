"""Angles of polarization of the water itself, at several directions of view: what the scattering method starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from uwgraph.sun.observation import azimuth_in_level
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Sweep:
    """Views in the levelled body, and the light's AoP in each."""

    azimuth: FloatArray
    """Of the views, in the water, clockwise from the bow, rad, shape (N,)."""
    elevation: FloatArray
    """Of the views above the horizontal, rad, shape (N,)."""
    aop: FloatArray
    """Radians from the horizontal (right) towards up, as the camera sees it, modulo pi, shape (N,)."""
    sigma: FloatArray
    """1-sigma of ``aop``, rad, shape (N,)."""
    dolp: FloatArray | None = None
    """Degree of linear polarization, shape (N,), where it was measured."""
    up_b: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Unit vector to the zenith in the body, shape (3,)."""
    n: float = 1.34
    """Refractive index of the water."""
    tilt_sigma: float = 0.0
    """1-sigma of roll and of pitch behind ``up_b``, rad."""
    t_ns: int = 0
    """Nanoseconds UTC; 0 when not known."""

    def __len__(self) -> int:
        return len(self.aop)

    def turned(self, angle: float) -> Sweep:
        """The same sweep from a bow that points ``angle`` [rad] further to port: a turn of the vehicle taken out."""
        return replace(self, azimuth=self.azimuth + angle)

    @classmethod
    def of_evectors(
        cls,
        w_b: FloatArray,
        e_b: FloatArray,
        sigma: FloatArray,
        up_b: FloatArray,
        *,
        dolp: FloatArray | None = None,
        n: float = 1.34,
        tilt_sigma: float = 0.0,
        t_ns: int = 0,
    ) -> Sweep:
        """From view rays in the water and e-vectors across them, unit vectors in the body, shape (N, 3)."""
        right = np.cross(w_b, up_b)
        right = right / np.linalg.norm(right, axis=1, keepdims=True)
        above = np.cross(right, w_b)
        return cls(
            azimuth=azimuth_in_level(w_b, up_b),
            elevation=np.arcsin(np.clip(w_b @ up_b, -1.0, 1.0)),
            aop=np.arctan2(np.sum(e_b * above, axis=1), np.sum(e_b * right, axis=1)),
            sigma=sigma,
            dolp=dolp,
            up_b=up_b,
            n=n,
            tilt_sigma=tilt_sigma,
            t_ns=t_ns,
        )


def joined(sweeps: Sequence[Sweep]) -> Sweep:
    """One sweep of several with one levelled body (see :meth:`Sweep.turned`); the rest is that of the first."""
    dolp = [s.dolp for s in sweeps if s.dolp is not None]
    return replace(
        sweeps[0],
        azimuth=np.concatenate([s.azimuth for s in sweeps]),
        elevation=np.concatenate([s.elevation for s in sweeps]),
        aop=np.concatenate([s.aop for s in sweeps]),
        sigma=np.concatenate([s.sigma for s in sweeps]),
        dolp=np.concatenate(dolp) if len(dolp) == len(sweeps) else None,
    )
