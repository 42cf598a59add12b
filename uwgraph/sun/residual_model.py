"""What the single-scattering model misses: AoP residuals learnt at known positions, as a function of the sun.

Skylight, multiple scattering and the camera's own polarization shift the measured angles by degrees, the same way
whenever the sun stands alike to the view. A regression on nearest neighbours learns the shift (Powell, Garnett,
Marshall & Rizk, Science Robotics 3, 2018, use the plain mean of the ten nearest).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from uwgraph.errors import DataError
from uwgraph.types import FloatArray

NEIGHBOURS: Final = (10, 20, 40, 80, 160)
"""Counts among which the learning chooses."""
REACH: Final = np.radians(10.0)
"""The correction fades out at this distance from the nearest sun it was learnt with."""


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """Measured AoPs less the chain's, at known suns."""

    suns: FloatArray
    """The sun as seen from the view, unit vectors (ahead, right, up), shape (M, 3)."""
    residuals: FloatArray
    """Radians, modulo pi, shape (M,)."""
    neighbours: int

    @classmethod
    def learn(cls, relative_azimuth: FloatArray, sun_zenith: FloatArray, residuals: FloatArray) -> ResidualModel:
        """The model with the count of neighbours that predicts left-out samples best.

        Parameters
        ----------
        relative_azimuth : shape (M,)
            Azimuth of the sun less that of the view, rad.
        sun_zenith : shape (M,)
            Zenith angle of the apparent sun, rad.
        residuals : shape (M,)
            Measured AoP less that of :func:`uwgraph.sun.scattering.scattered_aop`, rad.

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
        suns = _sun_from_view(relative_azimuth, sun_zenith)
        counts = [k for k in NEIGHBOURS if 2 * k < len(residuals)]
        models = [cls(suns, residuals, k) for k in counts]
        return min(models, key=lambda model: model._left_out_error())

    def predict(self, relative_azimuth: FloatArray, sun_zenith: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation [rad] of the residual, shapes (...), arguments as in :meth:`learn`."""
        suns = _sun_from_view(relative_azimuth, sun_zenith)
        distance, near = self._tree.query(suns.reshape(-1, 3), self.neighbours)
        mean, spread = self._regress(distance, near)
        fade = np.exp(-((distance[:, 0] / REACH) ** 2))
        return (fade * mean).reshape(suns.shape[:-1]), spread.reshape(suns.shape[:-1])

    def save(self, path: Path) -> None:
        """Write the samples as ``.npz``."""
        with path.open("wb") as file:
            np.savez_compressed(file, suns=self.suns, residuals=self.residuals, neighbours=self.neighbours)

    @classmethod
    def load(cls, path: Path) -> ResidualModel:
        """Read what :meth:`save` wrote; raises :class:`DataError` for any other file."""
        try:
            with np.load(path, allow_pickle=False) as file:
                suns, residuals, k = np.asarray(file["suns"]), np.asarray(file["residuals"]), int(file["neighbours"])
        except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
            raise DataError(
                f"is not a residual model ({str(error)[:80]})", where=str(path), remedy="learn it again"
            ) from error
        if suns.shape != (len(residuals), 3) or residuals.ndim != 1 or not 1 <= k <= len(residuals):
            raise DataError("holds arrays of the wrong shape", where=str(path), remedy="learn it again")
        if not (np.isfinite(suns).all() and np.isfinite(residuals).all()):
            raise DataError("holds values that are not finite", where=str(path), remedy="learn it again")
        return cls(suns.astype(np.float64), residuals.astype(np.float64), k)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.suns)

    def _left_out_error(self) -> float:
        distance, near = self._tree.query(self.suns, self.neighbours + 1)
        mean, _ = self._regress(distance[:, 1:], near[:, 1:])
        return float(np.mean(1.0 - np.cos(2.0 * (self.residuals - mean))))

    def _regress(self, distance: FloatArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Circular mean and standard deviation under a Gaussian kernel that ends at the last neighbour."""
        weights = np.exp(-2.0 * (distance / np.maximum(distance[:, -1:], 1e-9)) ** 2)
        z = np.sum(weights * np.exp(2j * self.residuals[near]), axis=1) / weights.sum(axis=1)
        spread = np.sqrt(-2.0 * np.log(np.clip(np.abs(z), 1e-6, 1.0))) / 2.0
        return np.angle(z) / 2.0, spread


def _sun_from_view(relative_azimuth: FloatArray, sun_zenith: FloatArray) -> FloatArray:
    relative_azimuth, sun_zenith = np.broadcast_arrays(relative_azimuth, sun_zenith)
    across = np.sin(sun_zenith)
    return np.stack([across * np.cos(relative_azimuth), across * np.sin(relative_azimuth), np.cos(sun_zenith)], axis=-1)
