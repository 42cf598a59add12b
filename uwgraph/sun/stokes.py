"""Stokes images from three or more channels behind polarizers.

A channel behind a polarizer at angle beta, counted from the image's +x (columns) towards +y (rows, down), reads

    f = K / 2 (I + Q cos 2 beta + U sin 2 beta),   K its gain,

which is solved by least squares (Tyo et al., Appl. Opt. 45, 5453, 2006). The angle of polarization atan2(U, Q) / 2 and
the degree hypot(Q, U) / I have the same reference axis. A fourth channel is redundant; what the fit leaves of it tells
a wrong order of the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.camera.sensor import Sensor
from uwgraph.errors import DataError
from uwgraph.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class StokesImage:
    """Linear polarization of an image, its angles counted from the image's x (columns) towards y (rows, down)."""

    I: FloatArray  # noqa: E741  (the field's symbol)
    """Intensity, counts above black, shape (H, W)."""
    Q: FloatArray
    U: FloatArray
    sigma: FloatArray
    """1-sigma of Q and of U, counts, shape (H, W)."""
    saturated: BoolArray
    """Where a channel was overexposed, shape (H, W)."""
    dark: BoolArray
    """Where there was hardly any light, shape (H, W)."""
    redundancy: float
    """Where there is polarization, the median of what the least squares left of the channels over that of hypot(Q, U):
    near 0 for channels in the right order; 0 with three channels."""
    factor: int = 1
    """Pixels of the camera along each side of one pixel of this image."""

    @property
    def aop(self) -> FloatArray:
        """Angle of polarization, rad, in (-pi/2, pi/2]."""
        angle: FloatArray = np.arctan2(self.U, self.Q) / 2.0
        return angle

    @property
    def dop(self) -> FloatArray:
        """Degree of linear polarization; 0 where there is no light."""
        degree: FloatArray = np.hypot(self.Q, self.U) / np.where(self.I > 0.0, self.I, np.inf)
        return degree

    @property
    def sigma_aop(self) -> FloatArray:
        """1-sigma of the angle, rad; at most that of an angle at random."""
        with np.errstate(divide="ignore"):
            sigma: FloatArray = np.minimum(0.5 * self.sigma / np.hypot(self.Q, self.U), np.pi / np.sqrt(12.0))
        return sigma


def from_channels(
    channels: Sequence[NDArray[Any]] | NDArray[Any],
    polarizer: ArrayLike,
    sensor: Sensor | None = None,
    gains: ArrayLike | None = None,
    factor: int = 1,
) -> StokesImage:
    """Stokes image of pictures taken through polarizers.

    Parameters
    ----------
    channels : K arrays of shape (H, W)
        Counts.
    polarizer : shape (K,)
        Angle of each channel's polarizer from image x towards y, rad.
    sensor : Sensor, optional
        Noise and range; a plain guess from the images where not given.
    gains : shape (K,), optional
        Gain of each channel; 1 where not given (see :func:`estimate_gains`).
    factor : int
        Bins ``factor`` x ``factor`` pixels into one.

    Raises
    ------
    DataError
        Channels of different sizes, fewer than three, or polarizers that do not tell three unknowns.
    """
    shapes = {np.shape(c) for c in channels}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise DataError(
            f"the channels have the shapes {sorted(shapes)}, not one of (rows, columns)",
            where="polarization images",
            remedy="give images of one camera at one resolution, without colours",
        )
    f = np.stack([np.asarray(c) for c in channels])
    sensor = sensor or Sensor.of(f)
    saturated: BoolArray = np.any(sensor.saturated(f), axis=0)
    return stokes_of_means(binned(f, factor), _any(saturated, factor), polarizer, sensor, gains, factor, factor**2)


def stokes_of_means(
    means: FloatArray,
    saturated: BoolArray,
    polarizer: ArrayLike,
    sensor: Sensor,
    gains: ArrayLike | None,
    factor: int,
    count: int,
) -> StokesImage:
    """Stokes image of channels (K, H, W), each value the mean of ``count`` pixels."""
    D = analyser_matrix(polarizer)
    solve = np.linalg.pinv(D)
    variance = np.maximum(sensor.variance(means.mean(axis=0)), 1e-12) / count
    f = (means - sensor.black).reshape(len(D), -1)
    if gains is not None:
        f /= np.asarray(gains, dtype=np.float64)[:, None]
    S = solve @ f
    intensity, Q, U = S.reshape(3, *means.shape[1:])
    dark = intensity < 6.0 * np.sqrt(sensor.variance(np.array(sensor.black)))  # I is twice the mean of the channels
    left = np.linalg.norm(f - D @ S, axis=0)
    sigma = np.sqrt(variance * (solve @ solve.T)[[1, 2], [1, 2]].mean())
    degree = np.hypot(Q, U)
    polarized = (degree > 5.0 * sigma) & ~dark & ~saturated
    redundancy = 0.0
    if len(D) > 3 and polarized.any():
        redundancy = float(np.median(left[polarized.ravel()]) / np.median(degree[polarized]))
    return StokesImage(intensity, Q, U, sigma, saturated, dark, redundancy, factor)


def analyser_matrix(polarizer: ArrayLike) -> FloatArray:
    """Rows [1, cos 2 beta, sin 2 beta] / 2 of polarizer angles (K,) [rad], shape (K, 3).

    Raises
    ------
    DataError
        Where they do not tell the three Stokes parameters apart.
    """
    beta = np.asarray(polarizer, dtype=np.float64)
    D = 0.5 * np.stack([np.ones_like(beta), np.cos(2.0 * beta), np.sin(2.0 * beta)], axis=1)
    if len(beta) < 3 or np.linalg.cond(D) > 100.0:
        raise DataError(
            f"polarizers at {np.round(np.degrees(beta), 1).tolist()} deg do not tell intensity, angle and degree apart",
            where="polarizer angles",
            remedy="three or more channels at different angles (modulo 180 deg) are needed, such as 0, 45, 90, 135",
        )
    return D


def estimate_gains(channels: ArrayLike, polarizer: ArrayLike, sensor: Sensor) -> FloatArray:
    """Relative gains (K,), of mean 1, of four or more channels (K, ...) from what they saw themselves.

    Channels freed of their gains span three dimensions: C diag(1 / K) f = 0, C the left null space of the analyser
    matrix. 1 / K is the smallest eigenvector of the channels' scatter; the noise's own share is subtracted. It takes
    light of different angles of polarization.

    Raises
    ------
    DataError
        Fewer than four channels, or too little variety in the light.
    """
    f = np.asarray(channels, dtype=np.float64).reshape(len(np.asarray(polarizer)), -1)
    C = np.linalg.svd(analyser_matrix(polarizer))[0][:, 3:].T
    usable = ~sensor.saturated(f).any(axis=0)
    f = f[:, usable]
    scatter = (C.T @ C) * ((f - sensor.black) @ (f - sensor.black).T - np.diag(sensor.variance(f).sum(axis=1)))
    values, vectors = np.linalg.eigh(scatter)
    inverse = vectors[:, 0] * np.sign(vectors[:, 0].sum())
    if len(f) < 4 or values[1] < 1e-5 * values[-1] or inverse.min() <= 0.0:
        raise DataError(
            "the channels do not tell their gains",
            where="polarization images",
            remedy="four or more channels, and light whose angle of polarization varies (a turn under the clear sky)",
        )
    gains: FloatArray = 1.0 / inverse
    return np.asarray(gains / gains.mean())


def binned(f: NDArray[Any], factor: int) -> FloatArray:
    """Means of ``factor`` x ``factor`` pixels of images (..., H, W); what is left over at the far edges is cut off."""
    height, width = (extent // factor for extent in f.shape[-2:])
    cut = f[..., : height * factor, : width * factor]
    if factor == 1:
        return cut.astype(np.float64)
    cells = cut.reshape(*f.shape[:-2], height, factor, width, factor)
    means: FloatArray = cells.mean(axis=(-3, -1), dtype=np.float64)
    return means


def _any(mask: BoolArray, factor: int) -> BoolArray:
    height, width = (extent // factor for extent in mask.shape)
    cut = mask[: height * factor, : width * factor]
    return np.asarray(cut.reshape(height, factor, width, factor).any(axis=(1, 3)))
