"""The gradient of the light: accuracy, what must not change it, and whether its sigma is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gradient_sky import SENSOR, azimuth_error_deg, fisheye, sky_image, sun_at
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import UP_FORWARD
from uwgraph.sun.gradient import estimate
from uwgraph.sun.gradient_field import gradient_field, sky_light
from uwgraph.sun.gradient_ring import ring_sun
from uwgraph.sun.observation import up_from_tilt
from uwgraph.sun.view import View

LEVEL = np.array([0.0, 0.0, -1.0])
AIR = View(fisheye())
WATER = View(fisheye(104.0), n=1.34)


@pytest.mark.parametrize("zenith_deg", [30, 50, 70])
@pytest.mark.parametrize("hidden", [0.0, 0.25, 0.5])
@pytest.mark.parametrize("view", [AIR, WATER], ids=["air", "water"])
def test_a_clear_sky_without_noise(view: View, hidden: float, zenith_deg: float) -> None:
    s = sun_at(2.0, np.radians(zenith_deg), LEVEL)
    found = estimate(sky_image(view, s, hidden=hidden, hidden_from=2.6), view, SENSOR)
    assert found.observation.ok, found.observation.flags
    assert abs(azimuth_error_deg(found.observation.s_b, s, LEVEL)) < 0.1
    assert np.degrees(np.arccos(found.observation.s_b @ s)) < 0.2
    assert found.form == "ring"


def test_the_plain_form_errs_where_the_ring_form_does_not() -> None:
    s = sun_at(2.0, np.radians(70.0), LEVEL)
    found = estimate(sky_image(AIR, s, hidden=0.25, hidden_from=2.6), AIR, SENSOR)
    assert found.plain is not None
    assert found.ring is not None
    assert abs(azimuth_error_deg(found.plain.s, s, LEVEL)) > 20.0
    assert abs(azimuth_error_deg(found.ring.s, s, LEVEL)) < 1.0


def test_the_plain_form_is_chosen_where_it_holds() -> None:
    s = sun_at(1.0, np.radians(40.0), LEVEL)
    image = sky_image(AIR, s, gradation=0.0, rng=np.random.default_rng(0))
    found = estimate(image, AIR, SENSOR)
    assert found.form == "plain"
    assert found.plain is not None
    assert found.plain.signs_agree
    assert np.degrees(np.arccos(found.plain.s @ s)) < 1.0
    assert np.degrees(np.arccos(found.observation.s_b @ s)) < 0.1


@settings(max_examples=8, deadline=None)
@given(turn=st.floats(0.0, 6.28), azimuth=st.floats(0.0, 6.28))
def test_turning_the_camera_about_the_vertical_turns_nothing_in_the_body(turn: float, azimuth: float) -> None:
    s = sun_at(azimuth, 0.8, LEVEL)
    turned = View(fisheye(R_bs=Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix() @ UP_FORWARD))
    found = estimate(sky_image(turned, s), turned, SENSOR).observation
    assert found.ok
    assert np.degrees(np.arccos(found.s_b @ s)) < 0.1


@settings(max_examples=8, deadline=None)
@given(roll=st.floats(-0.2, 0.2), pitch=st.floats(-0.2, 0.2), water=st.booleans())
def test_a_known_tilt_does_no_harm(roll: float, pitch: float, water: bool) -> None:
    up = up_from_tilt(roll, pitch)
    view = (View(fisheye(120.0), n=1.34) if water else AIR).tilted(up)
    s = sun_at(1.0, 0.8, up)
    found = estimate(sky_image(view, s), view, SENSOR).observation
    assert found.ok, found.flags
    assert abs(azimuth_error_deg(found.s_b, s, up)) < 0.1


@settings(max_examples=6, deadline=None)
@given(scale=st.floats(0.05, 1.3))
def test_brightness_does_not_matter(scale: float) -> None:
    image = sky_image(AIR, sun_at(1.0, 0.8, LEVEL))
    a, b = (estimate(x, AIR, SENSOR).observation for x in (image, scale * image))
    assert np.degrees(np.arccos(min(1.0, a.s_b @ b.s_b))) < 0.01


def test_a_power_law_of_the_sensor_does_not_move_the_sun() -> None:
    image = sky_image(AIR, sun_at(1.0, 0.8, LEVEL))
    coded = 4000.0 * (image / 4000.0) ** (1.0 / 2.2)
    a, b = (estimate(x, AIR, SENSOR).observation for x in (image, coded))
    assert np.degrees(np.arccos(min(1.0, a.s_b @ b.s_b))) < 0.05


@settings(max_examples=8, deadline=None)
@given(start=st.floats(0.0, 6.28), share=st.floats(0.05, 0.4))
def test_what_is_hidden_does_not_matter(start: float, share: float) -> None:
    s = sun_at(1.0, 0.9, LEVEL)
    found = estimate(sky_image(AIR, s, hidden=share, hidden_from=start), AIR, SENSOR).observation
    assert abs(azimuth_error_deg(found.s_b, s, LEVEL)) < 0.3


def test_disc_and_glints_are_masked() -> None:
    s = sun_at(1.0, 0.8, LEVEL)
    image = sky_image(AIR, s)
    u, v = np.round(AIR.camera.project((s @ AIR.camera.R_bs)[None])[0]).astype(int)
    image[v - 5 : v + 6, u - 5 : u + 6] = 4095.0
    image[100:104, 150:154] = 3900.0
    found = estimate(image, AIR, SENSOR)
    factor = round(float(np.sqrt(image.size / 4096)))
    assert not found.light.good[v // factor, u // factor]
    assert not found.light.good[102 // factor, 152 // factor]
    assert np.degrees(np.arccos(found.observation.s_b @ s)) < 0.1


def test_the_gradient_on_the_sphere_is_that_of_the_sky() -> None:
    s = sun_at(1.0, 0.8, LEVEL)
    image = np.exp(2.0 * (AIR.sky_rays() @ s)).reshape(AIR.camera.size) * 100.0
    field = gradient_field(sky_light(image, AIR, SENSOR, 6), 1.0)
    expected = 2.0 * (s - field.a * (field.a @ s)[:, None])
    assert np.abs(np.einsum("ni,ni->n", field.g, field.a)).max() < 1e-9
    assert np.median(np.linalg.norm(field.g - expected, axis=1)) < 0.02


def test_the_height_of_the_almanac_is_imposed_and_is_no_information() -> None:
    s = sun_at(1.0, 0.8, LEVEL)
    image = sky_image(AIR, s, rng=np.random.default_rng(1))
    free, held = (estimate(image, replace(AIR, sun_zenith=z), SENSOR).observation for z in (None, 0.8))
    assert held.ok
    assert held.elevation == pytest.approx(np.pi / 2.0 - 0.8, abs=1e-6)
    assert abs(azimuth_error_deg(held.s_b, s, LEVEL)) < 0.1
    height = np.cross(held.s_b, np.cross(held.s_b, LEVEL))
    height /= np.linalg.norm(height)
    assert height @ held.cov_b @ height == pytest.approx(height @ free.cov_b @ height, rel=0.3)


def test_an_unsure_vertical_makes_an_unsure_sun() -> None:
    s = sun_at(1.0, 0.8, LEVEL)
    image = sky_image(WATER, s)
    tilt = np.radians(1.0)
    sure, unsure = (estimate(image, replace(WATER, tilt_sigma=t), SENSOR).observation for t in (0.0, tilt))
    wrong = estimate(image, WATER.tilted(up_from_tilt(tilt, 0.0)), SENSOR).observation
    assert np.trace(unsure.cov_b) > np.trace(sure.cov_b)
    added = unsure.cov_b - sure.cov_b
    d = wrong.s_b - sure.s_b
    assert d @ np.linalg.pinv(added + 1e-12 * np.eye(3), rcond=1e-3) @ d < 6.0  # about a 1-sigma error


@pytest.mark.slow
def test_sigma_is_true_of_noise() -> None:
    """NEES over its 2 degrees of freedom; the floor of the calibration is taken off."""
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(60):
        s = sun_at(rng.uniform(0.0, 6.28), rng.uniform(0.5, 1.1), LEVEL)
        found = estimate(sky_image(AIR, s, level=120.0, rng=rng), AIR, SENSOR)
        assert found.fit is not None
        e = found.fit.E.T @ (found.observation.s_b - s)
        nees.append(e @ np.linalg.solve(found.fit.cov, e) / 2.0)
    assert 0.6 < np.mean(nees) < 1.6


def test_ring_sun_reports_the_sense_of_the_light() -> None:
    s = sun_at(1.0, 0.8, LEVEL)
    image = sky_image(AIR, s)
    dark_sun = image.max() * image[image > 0].min() / np.maximum(image, image[image > 0].min())
    for picture, grows in ((image, True), (dark_sun, False)):
        field = gradient_field(sky_light(picture, AIR, SENSOR, 6), 1.2)
        assert ring_sun(field, LEVEL).grows is grows
