"""From images of a level camera in the water to angles of polarization about the horizontal."""

from dataclasses import replace

import numpy as np
import pytest

from uwgraph.camera.model import Camera
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph
from uwgraph.sun.observation import level_axes, up_from_tilt
from uwgraph.sun.scattering import dolp, scattered_aop, scattered_stokes, wrap_half
from uwgraph.sun.scattering_fit import fit_sun
from uwgraph.sun.stokes import StokesImage
from uwgraph.sun.sweep import Sweep, joined
from uwgraph.sun.sweep_image import sweep_of_image
from uwgraph.sun.view import View

LOOKS_AHEAD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SUN = 0.7, 0.8  # azimuth from the bow, zenith angle
N = 1.34


def camera(analyser="projected", R_bs=LOOKS_AHEAD):
    return Camera("pinhole", (90.0, 90.0), (59.5, 44.5), (120, 90), R_bs=R_bs, analyser=analyser)


def image_of(view, sun=SUN, sigma=0.2):
    """What a camera sees of the water under ``sun``, by its analyser's definition (before the lens, or projected)."""
    cam, up = view.camera, view.up_b
    inside = cam.rays(cam.pixels())
    w = inside @ cam.R_bs.T
    right = np.cross(w, up)
    right /= np.linalg.norm(right, axis=1)[:, None]
    bow, starboard, _ = level_axes(up)
    where = np.arctan2(w @ starboard, w @ bow), np.arcsin(w @ up)
    S = scattered_stokes(*sun, *where, view.n)
    angle = np.arctan2(S[:, 2], S[:, 1]) / 2.0
    e = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * np.cross(right, w)
    e_s = e @ cam.R_bs
    if cam.analyser == "projected":
        X = np.array([1.0, 0.0, 0.0]) - inside[:, :1] * inside
        X /= np.linalg.norm(X, axis=1)[:, None]
        phi = np.arctan2(np.sum(e_s * np.cross(inside, X), axis=1), np.sum(e_s * X, axis=1))
    else:  # the lens turns each meridional plane as a whole
        alpha, theta = np.arctan2(inside[:, 1], inside[:, 0]), np.arccos(inside[:, 2])
        radial = np.stack([np.cos(theta) * np.cos(alpha), np.cos(theta) * np.sin(alpha), -np.sin(theta)], axis=1)
        around = np.stack([-np.sin(alpha), np.cos(alpha), np.zeros_like(alpha)], axis=1)
        phi = alpha + np.arctan2(np.sum(e_s * around, axis=1), np.sum(e_s * radial, axis=1))
    I = np.full(len(w), 1000.0)  # noqa: E741
    shape = cam.size[::-1]
    Q, U = (I * dolp(S) * f(2.0 * phi) for f in (np.cos, np.sin))
    I, Q, U = (x.reshape(shape) for x in (I, Q, U))  # noqa: E741
    return StokesImage(I, Q, U, np.full(shape, sigma), np.zeros(shape, bool), np.zeros(shape, bool), 0.0)


@pytest.mark.parametrize("analyser", ["projected", "lens"])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.12, -0.2)])
@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, 0.1, 1.2)])
def test_angles_are_about_the_horizontal(analyser, tilt, mount):
    view = View(camera(analyser, matrix_from_rph(mount) @ LOOKS_AHEAD), up_from_tilt(*tilt), N)
    sweep = sweep_of_image(image_of(view), view)
    expected = scattered_aop(*SUN, sweep.azimuth, sweep.elevation, N)
    assert len(sweep) > 40
    assert np.degrees(np.abs(wrap_half(sweep.aop - expected)).max()) < 0.5  # the blocks' own size
    assert np.degrees(np.abs(sweep.azimuth - mount[2]).max()) < 50.0
    S = scattered_stokes(*SUN, sweep.azimuth, sweep.elevation, N)
    np.testing.assert_allclose(sweep.dolp, dolp(S), atol=0.01)


def test_one_image_tells_the_sun():
    view = View(camera("lens"), up_from_tilt(0.05, 0.1), N)
    found = fit_sun(sweep_of_image(image_of(view), view)).observation
    assert np.degrees(abs(found.azimuth_b - SUN[0])) < 0.5
    assert np.degrees(abs(np.pi / 2 - found.elevation - SUN[1])) < 0.5


def test_turns_of_the_vehicle_are_taken_out():
    sweeps = []
    for yaw in np.radians([0.0, 90.0, 180.0, 270.0]):
        view = View(camera(), up_from_tilt(0.05, 0.1), N)
        sweeps.append(sweep_of_image(image_of(view, (SUN[0] - yaw, SUN[1])), view).turned(yaw))
    whole = joined(sweeps)
    assert len(whole) == sum(map(len, sweeps))
    found = fit_sun(whole).observation
    assert np.degrees(abs(found.azimuth_b - SUN[0])) < 0.1
    assert np.degrees(abs(np.pi / 2 - found.elevation - SUN[1])) < 0.1
    assert found.ok
    assert found.quality > 0.9


def test_noise_of_a_view_is_that_of_the_mean_of_its_pixels():
    view = View(camera(), n=N)
    rng = np.random.default_rng(0)
    image = image_of(view, sigma=100.0)
    noisy = replace(
        image,
        Q=image.Q + 100.0 * rng.standard_normal(image.Q.shape),
        U=image.U + 100.0 * rng.standard_normal(image.Q.shape),
    )
    clean, sweep = sweep_of_image(image, view), sweep_of_image(noisy, view)
    z = wrap_half(sweep.aop - clean.aop) / sweep.sigma
    assert 0.75 < np.std(z) < 1.25


def test_masked_pixels_do_not_count():
    view = View(camera(), n=N)
    image = image_of(view)
    saturated = np.zeros(image.I.shape, bool)
    saturated[:, ::3] = True
    spoilt = replace(
        image, saturated=saturated, I=np.where(saturated, 65535.0, image.I), Q=np.where(saturated, 0, image.Q)
    )
    sweep, clean = sweep_of_image(spoilt, view), sweep_of_image(image, view)
    assert len(sweep) == len(clean)
    assert np.degrees(np.abs(wrap_half(sweep.aop - clean.aop)).max()) < 0.6
    image.saturated[:, :60] = True
    assert sweep_of_image(image, view).azimuth.min() > -0.02


def test_steep_views_are_left_out():
    up = View(replace(camera(), R_bs=matrix_from_rph([0.0, 0.6, 0.0]) @ LOOKS_AHEAD), n=N)
    sweep = sweep_of_image(image_of(up), up)
    assert np.abs(sweep.elevation).max() < np.radians(30.0)


def test_refusals():
    view = View(camera(), n=N)
    image = image_of(view)
    with pytest.raises(DataError, match="medium water"):
        sweep_of_image(image, replace(view, n=1.0))
    with pytest.raises(DataError, match="exposure"):
        sweep_of_image(replace(image, dark=np.ones(image.I.shape, bool)), view)
    with pytest.raises(DataError, match="exposure"):
        sweep_of_image(image, View(Camera("pinhole", (90.0, 90.0), (59.5, 44.5), (120, 90)), n=N))  # looks up


def test_evectors_by_hand():
    """A horizontal e-vector is 0; one that rises to the right of the view is positive."""
    up = np.array([0.0, 0.0, -1.0])
    ahead, starboard = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    e = np.array([starboard, starboard + up, -ahead + up]) / np.array([[1.0], [np.sqrt(2)], [np.sqrt(2)]])
    sweep = Sweep.of_evectors(np.array([ahead, ahead, starboard]), e, np.full(3, 0.01), up)
    np.testing.assert_allclose(np.degrees(sweep.azimuth), [0.0, 0.0, 90.0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(sweep.aop), [0.0, 45.0, 45.0], atol=1e-12)
