"""A camera's pixels as rays with polarization axes: mounting, port and analyser."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.simulate.stokes import transmitted, turned
from uwgraph.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Eye:
    """Every pixel's ray, row by row.

    Stokes vectors enter about the axis s = z x ray, across the plane of the ray and the optical axis z, which bends
    neither in a lens nor in a port.
    """

    camera: Camera
    w_b: FloatArray
    """Rays in the body, outside the housing, shape (N, 3)."""
    s_b: FloatArray
    """Axes s in the body, shape (N, 3)."""
    r: FloatArray
    """Rays in the camera frame, inside the housing, shape (N, 3)."""
    n: float
    """Refractive index outside."""
    seeing: BoolArray
    """Pixels that see anything, shape (N,)."""

    @classmethod
    def of(cls, camera: Camera, n: float, offset: tuple[float, float] = (0.0, 0.0)) -> Eye:
        """The eye of a camera in a medium of index ``n``, its pixels shifted by ``offset``; cached."""
        return _eye(camera, n, offset)

    def behind_port(self, stokes: FloatArray) -> FloatArray:
        """Stokes vectors inside the housing, about the image's x axis carried out by the lens, smooth over the image.

        A lens keeps the meridional plane, so the azimuth of s in the image is that of the ray plus 90 degrees. A flat
        port is one surface from water to air (its glass is thin and left out); a dome is crossed at right angles.
        """
        if self.camera.port == "flat" and self.n != 1.0:
            stokes = transmitted(stokes, self.w_b @ self.camera.R_bs[:, 2], self.r[:, 2], 1.0 / self.n)
        return turned(stokes, np.conj(1j * _azimuth(self.r)))

    def analysed(self, stokes: FloatArray) -> FloatArray:
        """What the camera's analyser model makes of :meth:`behind_port`; angles from image x towards image y.

        The light of a sheet before the lens is given with the angle at which the sheet passes most.
        """
        if self.camera.analyser == "lens":
            return stokes
        radial, around = _meridional(self.r)
        if self.camera.analyser == "projected":
            x = np.array([1.0, 0.0, 0.0]) - self.r[:, :1] * self.r
            x /= np.linalg.norm(x, axis=1)[:, None]
            along = (x * radial).sum(axis=1) + 1j * (x * around).sum(axis=1)
            return turned(stokes, along * _azimuth(self.r))
        e = np.sqrt(stokes[:, 1] + 1j * stokes[:, 2]) * np.conj(_azimuth(self.r))
        seen = e.real * (radial[:, 0] + 1j * radial[:, 1]) + e.imag * (around[:, 0] + 1j * around[:, 1])
        linear = np.abs(e) ** 2 * (seen / np.maximum(np.abs(seen), 1e-300)) ** 2
        return np.column_stack([stokes[:, 0], linear.real, linear.imag])


def _azimuth(r: FloatArray) -> FloatArray:
    """Azimuth of rays in the image as a complex unit number, shape (N,); 1 on the axis."""
    planar = r[:, 0] + 1j * r[:, 1]
    size = np.abs(planar)
    return np.where(size < 1e-9, 1.0, planar / np.where(size < 1e-9, 1.0, size))


def _meridional(r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors across the rays: radial (away from the axis) and around it, shape (N, 3)."""
    azimuth = _azimuth(r)
    around = np.column_stack([-azimuth.imag, azimuth.real, np.zeros(len(r))])
    return np.cross(around, r), around


@lru_cache(maxsize=16)
def _eye(camera: Camera, n: float, offset: tuple[float, float]) -> Eye:
    uv = camera.pixels() + np.array(offset)
    w_b, _ = camera.outside(uv, n)
    r = camera.rays(uv)
    seeing = np.asarray(np.isfinite(w_b).all(axis=1))
    w_b[~seeing], r[~seeing] = camera.R_bs[:, 2], (0.0, 0.0, 1.0)
    return Eye(camera, w_b, _meridional(r)[1] @ camera.R_bs.T, r, n, seeing)
