"""From the radiance of a floor to a camera's picture: lens, automatic exposure, noise, white balance, gamma, file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.sensor import Sensor
from uwgraph.errors import DataError
from uwgraph.simulate.exposure import auto_scale
from uwgraph.simulate.floor_model import FloorModel
from uwgraph.simulate.floor_noise import Single

_BITS: Final = 12
_TOP: Final = 2**_BITS - 1
_GAMMA: Final = 2.2
_JPEG_QUALITY: Final = 92


def recorded(radiance: Single, model: FloorModel, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The 8-bit picture (H, W, 3), blue, green, red."""
    sensor = Sensor(white=0.98 * _TOP, gain=model.full_well / _TOP, read_noise=model.read_noise)
    sharp = radiance if model.blur == 0.0 else cv2.GaussianBlur(radiance, (0, 0), model.blur)
    sampled = np.asarray(sharp[::4, ::4], dtype=np.float64)
    scale = auto_scale(sampled.max(axis=2), sensor.white, most=np.pi * model.longest_exposure * sensor.white)
    electrons = np.maximum(sharp, np.float32(0.0)) * np.float32(scale * sensor.gain)
    # thousands of electrons a pixel: their shot noise is Gaussian, and Poisson draws would take most of the time
    electrons += np.sqrt(electrons + np.float32(sensor.read_noise**2)) * rng.standard_normal(
        electrons.shape, dtype=np.float32
    )
    mean = sampled.mean(axis=(0, 1)) + 1e-12
    balance = (mean.max() / mean) ** model.white_balance
    counts = np.clip(electrons * (balance / sensor.gain).astype(np.float32) + np.float32(0.5), 0.0, _TOP)
    return np.asarray(_TONES[counts.astype(np.uint16)])


_TONES: Final = np.rint(255.0 * (np.arange(_TOP + 1) / _TOP) ** (1.0 / _GAMMA)).astype(np.uint8)


def write_picture(file: Path, picture: NDArray[np.uint8]) -> None:
    """PNG or JPEG, by its name.

    Raises
    ------
    DataError
        When it cannot be written.
    """
    png = file.suffix == ".png"
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1] if png else [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    if not cv2.imwrite(str(file), picture, how):
        raise DataError("cannot be written", where=str(file), remedy="check the disk and the permissions")
