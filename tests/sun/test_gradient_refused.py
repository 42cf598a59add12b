"""Images that tell no sun are refused with a flag that says why, never answered with a confident wrong sun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gradient_sky import SENSOR, fisheye, sky_image, sun_at

from uwgraph.errors import DataError
from uwgraph.sun.gradient import estimate
from uwgraph.sun.observation import SunFlag
from uwgraph.sun.view import View

LEVEL = np.array([0.0, 0.0, -1.0])
AIR = View(fisheye())
WATER = View(fisheye(104.0), n=1.34)
SIZE = (360, 360)


def noise(level: float) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.rint(np.maximum(rng.poisson(level * 2.4, SIZE) / 2.4 + rng.standard_normal(SIZE) * 1.25, 0.0))


@pytest.mark.parametrize(
    ("image", "flag"),
    [
        (np.zeros(SIZE), SunFlag.DARK),
        (np.full(SIZE, np.nan), SunFlag.SATURATED),
        (noise(0.0), SunFlag.DARK),
        (np.full(SIZE, 4095.0), SunFlag.SATURATED),
        (np.full(SIZE, 1000.0), SunFlag.UNIFORM),
        (noise(1000.0), SunFlag.UNIFORM),
    ],
    ids=["black", "no numbers", "noise of the dark", "saturated", "flat", "flat with noise"],
)
@pytest.mark.parametrize("view", [AIR, WATER], ids=["air", "water"])
def test_without_structure(image: np.ndarray, flag: SunFlag, view: View) -> None:
    found = estimate(image, view, SENSOR).observation
    assert flag in found.flags


def test_textured_noise() -> None:
    rng = np.random.default_rng(6)
    for _ in range(5):
        blobs = np.kron(rng.lognormal(0.0, 0.5, (18, 18)), np.ones((20, 20))) * 500.0
        assert not estimate(blobs, AIR, SENSOR).observation.ok


def test_an_overcast_sky() -> None:
    cos_z = np.maximum(AIR.sky_rays() @ LEVEL, 0.01).reshape(SIZE)
    found = estimate(np.rint(1000.0 * (1.0 + 2.0 * cos_z)), AIR, SENSOR).observation
    assert SunFlag.UNIFORM in found.flags


def test_upside_down() -> None:
    image = sky_image(WATER, sun_at(1.0, 0.8, LEVEL))
    assert SunFlag.SMALL_WINDOW in estimate(image, WATER.tilted(-LEVEL), SENSOR).observation.flags


def test_a_sun_at_the_zenith() -> None:
    image = sky_image(AIR, sun_at(1.0, np.radians(3.0), LEVEL))
    assert SunFlag.NEAR_ZENITH in estimate(image, AIR, SENSOR).observation.flags


def test_night_by_the_almanac() -> None:
    image = sky_image(AIR, sun_at(1.0, 0.8, LEVEL))
    assert SunFlag.NIGHT in estimate(image, replace(AIR, sun_zenith=1.7), SENSOR).observation.flags


def test_another_height_than_the_almanac_s() -> None:
    image = sky_image(AIR, sun_at(1.0, 0.6, LEVEL))
    found = estimate(image, replace(AIR, sun_zenith=1.1), SENSOR).observation
    assert SunFlag.ZENITH_DISAGREES in found.flags


def test_most_of_the_sky_hidden() -> None:
    image = sky_image(AIR, sun_at(1.0, 0.8, LEVEL), hidden=0.8, hidden_from=2.0)
    found = estimate(image, AIR, SENSOR).observation
    assert SunFlag.SMALL_WINDOW in found.flags


def test_a_sky_darkest_at_its_sun() -> None:
    image = sky_image(AIR, sun_at(1.0, 0.8, LEVEL))
    inverted = 1e6 / np.maximum(image, 300.0)
    assert not estimate(inverted, AIR, SENSOR).observation.ok


def test_another_size_than_the_camera_s() -> None:
    with pytest.raises(DataError, match=r"360 x 360|calibration"):
        estimate(np.zeros((100, 200)), AIR, SENSOR)
