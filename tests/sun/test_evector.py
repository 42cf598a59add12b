"""E-vectors in space: analyser models, port and surface, against a renderer that shares none of the code."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polar_sky import CLEAR, POLARIZERS, fisheye, sun_at

from uwgraph.camera.sensor import Sensor
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate.exposure import behind_polarizer
from uwgraph.simulate.render import Shot, render
from uwgraph.sun.eigen import residuals
from uwgraph.sun.evector import Unknowns, light_of, skylight
from uwgraph.sun.observation import up_from_tilt
from uwgraph.sun.stokes import StokesImage, from_channels
from uwgraph.sun.view import View

SENSOR = Sensor(white=1e9)
RPH = (0.12, -0.08, 2.0)
S_N = sun_at(0.7, np.radians(55.0))
CLEAR_WATER = CLEAR.model_copy(update={"attenuation": 1e-6})


def sky_of(camera, depth=None):
    """Skylight of every pixel within 70 deg of the zenith, the view, and the sun in the body."""
    R = matrix_from_rph(np.array(RPH))
    stokes = render(CLEAR_WATER, Shot(camera, R, S_N, depth=depth))
    image = from_channels([1e6 * behind_polarizer(stokes, float(b)) for b in POLARIZERS], POLARIZERS, SENSOR)
    view = View(camera, up_from_tilt(*RPH[:2]), n=1.0 if depth is None else CLEAR.n)
    pixels = np.flatnonzero(view.sky_rays() @ view.up_b > np.cos(np.radians(70.0)))
    return skylight(light_of(image, view, pixels, pixels, 0.0), view.up_b, view.n), R.T @ S_N


def worst_residual(light, s_b, unknowns=None):
    """Degrees, away from the sun."""
    sky = light.evectors(unknowns or Unknowns())
    away = np.abs(sky.a_b @ s_b) < np.cos(np.radians(10.0))
    return np.degrees(np.abs(residuals(sky, s_b)[away]).max())


@pytest.mark.parametrize("analyser", ["lens", "sheet", "projected"])
def test_each_analyser_model_leads_to_the_sun(analyser):
    light, s_b = sky_of(fisheye(64, 60.0, analyser=analyser))
    assert worst_residual(light, s_b) < 1e-3


def test_the_wrong_analyser_model_does_not():
    camera = fisheye(64, 60.0, analyser="lens")
    R = matrix_from_rph(np.array(RPH))
    stokes = render(CLEAR, Shot(camera, R, S_N))
    image = from_channels([1e6 * behind_polarizer(stokes, float(b)) for b in POLARIZERS], POLARIZERS, SENSOR)
    view = View(fisheye(64, 60.0, analyser="sheet"), up_from_tilt(*RPH[:2]))
    pixels = np.flatnonzero(view.sky_rays() @ view.up_b > np.cos(np.radians(70.0)))
    wrong = skylight(light_of(image, view, pixels, pixels, 0.0), view.up_b, view.n)
    assert worst_residual(wrong, R.T @ S_N) > 5.0


@pytest.mark.parametrize("analyser", ["lens", "projected"])
@pytest.mark.parametrize("port", ["dome", "flat"])
def test_surface_and_port_are_undone(analyser, port):
    light, s_b = sky_of(fisheye(64, 42.0, analyser=analyser, port=port), depth=2.0)
    assert worst_residual(light, s_b) < 0.02


def test_without_the_surface_the_pattern_is_bent():
    light, s_b = sky_of(fisheye(64, 45.0), depth=2.0)
    sky = light.light.evectors()
    assert np.degrees(np.abs(residuals(sky, s_b)).max()) > 5.0


@settings(max_examples=25, deadline=None)
@given(log_kappa=st.floats(0.0, 1.0), twice=st.floats(-0.05, 0.1), depth=st.sampled_from([None, 2.0]))
def test_derivatives_are_those_of_the_angles(log_kappa, twice, depth):
    light, s_b = SKIES[depth]
    at, h = Unknowns(log_kappa if depth else 0.0, twice), 1e-6
    # at the e-vectors themselves model and measurement agree: make the sun's pattern the measured one
    here = light.evectors(at)
    for column, step in enumerate((Unknowns(at.log_kappa + h, twice), Unknowns(at.log_kappa, twice + h))):
        there = light.evectors(step)
        turned = np.einsum("ni,ni->n", np.cross(here.e_b, there.e_b), here.a_b)
        turned *= np.sign(np.einsum("ni,ni->n", here.e_b, there.e_b))
        close = np.abs(residuals(here, s_b)) < np.radians(0.1)
        stated = light.derivatives(at, s_b)[:, column]
        scale = np.abs(stated).max() + 1e-3
        assert close.sum() > 20
        assert np.abs(turned / h - stated)[close].max() < 0.01 * scale


SKIES = {None: sky_of(fisheye(32, 55.0)), 2.0: sky_of(fisheye(32, 42.0), depth=2.0)}


def test_turning_the_camera_about_its_axis_turns_nothing_in_the_body():
    """The same sky, once with the image's axes along the body's and once turned by 40 deg."""
    camera = fisheye(65, 50.0)
    turn = np.radians(40.0)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    turned = fisheye(65, 50.0, R_bs=camera.R_bs @ about_z)
    for c in (camera, turned):
        light, s_b = sky_of(c)
        assert worst_residual(light, s_b) < 1e-3


def test_a_pixel_that_looks_straight_up_is_no_exception():
    camera = fisheye(65, 50.0)
    flat = np.ones((65, 65))
    none = np.zeros((65, 65), dtype=bool)
    image = StokesImage(flat, 0.3 * flat, 0.1 * flat, 1e-3 * flat, none, none, 0.0)
    middle = np.array([32 * 65 + 32])
    sky = skylight(light_of(image, View(camera), middle, middle, 0.0), np.array([0.0, 0.0, -1.0]), 1.0)
    assert np.isfinite(sky.evectors(Unknowns()).e_b).all()
