"""What the single-scattering model misses: AoP residuals learnt at known positions, as a function of the sun.

Skylight, multiple scattering and the camera's own polarization shift the measured angles by degrees, the same way
whenever the sun stands alike to the view. A regression on nearest neighbours learns the shift (Powell, Garnett,
Marshall & Rizk, Science Robotics 3, 2018, use the plain mean of the ten nearest), and how well suns are found with it.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.spatial import cKDTree

from uwgraph.errors import DataError
from uwgraph.types import FloatArray

NEIGHBOURS: Final = (10, 20, 40, 80, 160)
"""Counts among which the learning chooses."""
REACH: Final = np.radians(10.0)
"""The correction fades out at this distance from the nearest sun it was learnt with."""
ZENITH_WIDTH: Final = np.radians(5.0)
"""Of the kernel over which errors of suns are gathered."""


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """Measured AoPs less the chain's, at known suns."""

    suns: FloatArray
    """The sun as seen from the view, unit vectors (ahead, right, up), shape (M, 3)."""
    residuals: FloatArray
    """Radians, modulo pi, shape (M,)."""
    neighbours: int
    fitted_zenith: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Zenith angles of suns fitted to sweeps that were left out of the learning, rad, shape (K,)."""
    sun_errors: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """Their errors across and along, rad, shape (K, 2)."""

    @classmethod
    def learn(
        cls, relative_azimuth: FloatArray, sun_zenith: FloatArray, residuals: FloatArray, group: NDArray[np.intp]
    ) -> ResidualModel:
        """The model with the count of neighbours that predicts left-out groups best.

        Parameters
        ----------
        relative_azimuth : shape (M,)
            Azimuth of the sun less that of the view, rad.
        sun_zenith : shape (M,)
            Zenith angle of the apparent sun, rad.
        residuals : shape (M,)
            Measured AoP less that of :func:`uwgraph.sun.scattering.scattered_aop`, rad.
        group : shape (M,)
            Number of what errs together, such as the day.

        Raises
        ------
        DataError
            When there are too few samples.
        """
        if len(residuals) <= 2 * NEIGHBOURS[0]:
            raise DataError(
                f"{len(residuals)} samples are too few to learn from",
                where="residual model",
                remedy=f"give sweeps with more than {2 * NEIGHBOURS[0]} views in all",
            )
        whole = cls(_sun_from_view(relative_azimuth, sun_zenith), residuals, 1)
        counts = [k for k in NEIGHBOURS if 2 * k < len(residuals)]
        return min((replace(whole, neighbours=k) for k in counts), key=lambda model: model._left_out_error(group))

    def predict(self, relative_azimuth: FloatArray, sun_zenith: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation [rad] of the residual, shapes (...), arguments as in :meth:`learn`."""
        mean, spread = self._splines
        azimuth, zenith = np.broadcast_arrays(relative_azimuth % (2.0 * np.pi), sun_zenith)
        return np.asarray(mean.ev(azimuth, zenith)), np.maximum(spread.ev(azimuth, zenith), 0.0)

    def sun_sigma(self, zenith: float) -> FloatArray | None:
        """1-sigma across and along [rad], shape (2,), of a sun fitted at ``zenith`` on another day; None if unknown."""
        weights = np.exp(-0.5 * ((self.fitted_zenith - zenith) / ZENITH_WIDTH) ** 2)
        if weights.sum() < 1.0:
            return None
        sigma: FloatArray = np.sqrt(weights @ self.sun_errors**2 / weights.sum())
        return sigma

    def save(self, path: Path) -> None:
        """Write the samples as ``.npz``."""
        with path.open("wb") as file:
            np.savez_compressed(file, **{name: getattr(self, name) for name in (*_ARRAYS, "neighbours")})

    @classmethod
    def load(cls, path: Path) -> ResidualModel:
        """Read what :meth:`save` wrote; raises :class:`DataError` for any other file."""
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: np.asarray(file[name], dtype=np.float64) for name in _ARRAYS}
                model = cls(neighbours=int(file["neighbours"]), **arrays)
        except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
            raise DataError(
                f"is not a residual model ({str(error)[:80]})", where=str(path), remedy="learn it again"
            ) from error
        samples, fitted = len(np.atleast_1d(model.residuals)), len(np.atleast_1d(model.fitted_zenith))
        shapes = ((samples, 3), (samples,), (fitted,), (fitted, 2))
        if (
            any(a.shape != s for a, s in zip(arrays.values(), shapes, strict=True))
            or not 0 < model.neighbours < samples
        ):
            raise DataError("holds arrays of the wrong shape", where=str(path), remedy="learn it again")
        if not all(np.isfinite(a).all() for a in arrays.values()):
            raise DataError("holds values that are not finite", where=str(path), remedy="learn it again")
        return model

    @cached_property
    def _splines(self) -> tuple[RectBivariateSpline, RectBivariateSpline]:
        """The regression on a grid of suns, with some turns more than one in azimuth."""
        azimuth, zenith = np.radians(np.arange(-20.0, 381.0, 5.0)), np.radians(np.arange(0.0, 91.0, 2.5))
        suns = _sun_from_view(azimuth[:, None], zenith)
        mean, spread = (x.reshape(suns.shape[:-1]) for x in self._regress(suns.reshape(-1, 3)))
        return RectBivariateSpline(azimuth, zenith, mean), RectBivariateSpline(azimuth, zenith, spread)

    def _regress(self, suns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Circular mean and standard deviation under a Gaussian kernel that ends at the last neighbour."""
        distance, near = cKDTree(self.suns).query(suns, self.neighbours)
        weights = np.exp(-2.0 * (distance / np.maximum(distance[:, -1:], 1e-9)) ** 2)
        z = np.sum(weights * np.exp(2j * self.residuals)[near], axis=1) / weights.sum(axis=1)
        fade = np.exp(-((distance[:, 0] / REACH) ** 2))
        spread = np.sqrt(-2.0 * np.log(np.clip(np.abs(z), 1e-6, 1.0))) / 2.0
        return fade * np.angle(z) / 2.0, spread

    def _left_out_error(self, group: NDArray[np.intp]) -> float:
        error = 0.0
        for one in np.unique(group):
            out = group == one
            rest = replace(self, suns=self.suns[~out], residuals=self.residuals[~out])
            if len(rest.residuals) < self.neighbours:
                return np.inf
            error += float(np.sum(1.0 - np.cos(2.0 * (self.residuals[out] - rest._regress(self.suns[out])[0]))))
        return error


_ARRAYS: Final = ("suns", "residuals", "fitted_zenith", "sun_errors")


def _sun_from_view(relative_azimuth: FloatArray, sun_zenith: FloatArray) -> FloatArray:
    relative_azimuth, sun_zenith = np.broadcast_arrays(relative_azimuth, sun_zenith)
    across = np.sin(sun_zenith)
    return np.stack([across * np.cos(relative_azimuth), across * np.sin(relative_azimuth), np.cos(sun_zenith)], axis=-1)
