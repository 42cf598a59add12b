"""The one entry for images: any optical method, one camera, one set of circumstances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from uwgraph.camera.file import CameraFile
from uwgraph.camera.images import Counts
from uwgraph.camera.model import check_size
from uwgraph.camera.sensor import Sensor
from uwgraph.errors import ConfigError, DataError
from uwgraph.sun import gradient, polarization
from uwgraph.sun.ephemeris import sun_azimuth_elevation
from uwgraph.sun.gradient import GradientEstimate
from uwgraph.sun.mosaic import from_mosaic, layout
from uwgraph.sun.polarization import PolarizationEstimate
from uwgraph.sun.scattering_fit import ScatteringFit, fit_sun
from uwgraph.sun.stokes import StokesImage, binned, from_channels
from uwgraph.sun.sweep import joined
from uwgraph.sun.sweep_image import sweep_of_image
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

Method = Literal["gradient", "polarization", "scattering"]
Estimate = GradientEstimate | PolarizationEstimate | ScatteringFit
BINS: Final = 150
"""Polarization images are binned to about this many pixels along the longer side."""


def view_of(
    file: CameraFile,
    up_b: FloatArray,
    *,
    n: float,
    tilt_sigma: float = 0.0,
    t_ns: int = 0,
    place: tuple[float, float] | None = None,
) -> View:
    """The circumstances of an image; ``place`` is latitude and longitude [rad], ``n`` the index of the medium."""
    zenith = None
    if t_ns and place is not None:
        zenith = float(np.pi / 2.0 - sun_azimuth_elevation(t_ns, *place)[1][0])
    return View(file.camera, up_b, n, tilt_sigma, zenith, t_ns)


def estimate_sun(
    images: Sequence[Counts], file: CameraFile, view: View, method: Method | None = None, yaw: FloatArray | None = None
) -> Estimate:
    """The sun in images of one camera.

    Parameters
    ----------
    images : sequence of (H, W) or (H, W, 3)
        ``gradient``: one image, or a burst whose mean is taken. ``polarization``: one mosaic or a burst of them, or one
        image for each angle of ``file.polarizer_deg``. ``scattering``: as polarization, for each heading of ``yaw``.
    file : CameraFile
        Calibration, sensor, and how the polarizers are arranged.
    view : View
        Circumstances; its camera is the file's.
    method : optional
        Polarization where the file names a mosaic or polarizer angles, otherwise the gradient.
    yaw : shape (G,), optional
        ``scattering``: how far the bow stood clockwise from where it stands in the result, rad.

    Raises
    ------
    ConfigError, DataError
        When images, method and camera file do not belong together.
    """
    if not images:
        raise ConfigError("there are no images", where="images", remedy="name at least one file")
    for number, image in enumerate(images, start=1):
        check_size(file.camera, image, f"image {number}")
    polarized = file.mosaic is not None or file.polarizer_deg is not None
    method = method or ("polarization" if polarized else "gradient")
    if yaw is not None and method != "scattering":
        raise ConfigError(f"{method} takes one heading", where="yaw", remedy="yaw goes with the scattering method")
    if method == "gradient":
        return _gradient(images, file, view)
    if method == "polarization":
        return polarization.estimate(_stokes(images, file), view)
    return _scattering(images, file, view, yaw)


def _gradient(images: Sequence[Counts], file: CameraFile, view: View) -> GradientEstimate:
    """A mean of T images, or of a mosaic's cell, is one image of a sensor with more electrons per count."""
    if file.mosaic is not None:
        mean = np.mean([_gray(image) for image in images], axis=0)
        return gradient.estimate(binned(mean, 2), view.binned(2), _summed(images, file, 4 * len(images)))
    mean = images[0] if len(images) == 1 else np.mean([_gray(image) for image in images], axis=0)
    return gradient.estimate(mean, view, _summed(images, file, len(images)))


def _gray(image: Counts) -> Counts:
    return image[:, :, 1] if image.ndim == 3 else image


def _summed(images: Sequence[Counts], file: CameraFile, count: int) -> Sensor:
    sensor = file.sensor or Sensor.of(images[0])
    return replace(sensor, gain=sensor.gain * count, read_noise=sensor.read_noise * np.sqrt(count))


def _stokes(images: Sequence[Counts], file: CameraFile) -> StokesImage:
    if file.mosaic is not None:
        raw = images[0] if len(images) == 1 else np.mean(images, axis=0)
        sensor = _summed(images, file, len(images))
        cells = max(1, round(max(raw.shape) / 2 / BINS))
        return from_mosaic(raw, layout(file.mosaic), sensor, cells=cells)
    angles = file.polarizer_deg
    if angles is None:
        raise ConfigError(
            "polarization needs a mosaic, or images through polarizers at known angles",
            where="camera file: mosaic, polarizer_deg",
            remedy="name the layout ('mosaic: sony') or the angles in the order of the images",
        )
    if len(images) != len(angles):
        raise DataError(
            f"{len(images)} images for {len(angles)} polarizer angles",
            where="images",
            remedy="give one image for each angle, in that order",
        )
    factor = max(1, round(max(images[0].shape) / BINS))
    return from_channels([_gray(image) for image in images], np.radians(angles), file.sensor, factor=factor)


def _scattering(images: Sequence[Counts], file: CameraFile, view: View, yaw: FloatArray | None) -> ScatteringFit:
    yaw = np.zeros(1) if yaw is None else yaw
    each = 1 if file.mosaic is not None else len(file.polarizer_deg or ())
    if each == 0 or len(images) != each * len(yaw):
        raise ConfigError(
            f"{len(images)} images for {len(yaw)} headings of {max(each, 1)} images each",
            where="images, yaw",
            remedy="give the images of the first heading, then those of the second, and so on",
        )
    groups = [images[k : k + each] for k in range(0, len(images), each)]
    sweeps = [sweep_of_image(_stokes(g, file), view).turned(float(y)) for g, y in zip(groups, yaw, strict=True)]
    return fit_sun(joined(sweeps), sun_zenith=view.sun_zenith)
