"""Rays and their Jacobians against OpenCV and finite differences; ports; binning."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import UP_FORWARD, Camera
from uwgraph.camera.refraction import refract
from uwgraph.sun.surface import to_air

PINHOLE = Camera("pinhole", (500.0, 510.0), (322.0, 238.0), (640, 480), (-0.12, 0.05, 1e-3, -2e-3, 0.01))
FISHEYE = Camera("fisheye", (230.0, 231.0), (322.0, 238.0), (640, 480), (0.02, -0.01, 0.003, -0.0005))
WIDE = Camera("fisheye", (150.0, 150.0), (319.5, 319.5), (640, 640))
CAMERAS = pytest.mark.parametrize("camera", [PINHOLE, FISHEYE, WIDE, replace(PINHOLE, distortion=())])


@pytest.fixture
def uv():
    """Pixels all over the image, the principal point among them."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform([0, 0], [639, 479], (300, 2)), [[322.0, 238.0], [322.0, 100.0], [400.0, 238.0]]])


@CAMERAS
def test_rays_are_unit_and_project_back(camera, uv):
    r = camera.rays(uv)
    np.testing.assert_allclose(np.linalg.norm(r, axis=1), 1.0, atol=1e-13)
    np.testing.assert_allclose(camera.project(r), uv, atol=1e-7)


def test_pinhole_projects_as_opencv(uv):
    r = PINHOLE.rays(uv)
    K = np.array([[500.0, 0.0, 322.0], [0.0, 510.0, 238.0], [0.0, 0.0, 1.0]])
    seen, _ = cv2.projectPoints(7.0 * r, np.zeros(3), np.zeros(3), K, np.array(PINHOLE.distortion))
    np.testing.assert_allclose(seen.reshape(-1, 2), uv, atol=1e-7)


def test_fisheye_projects_as_opencv(uv):
    r = FISHEYE.rays(uv)
    ahead = r[:, 2] > 0.05
    K = np.array([[230.0, 0.0, 322.0], [0.0, 231.0, 238.0], [0.0, 0.0, 1.0]])
    points = (5.0 * r[ahead] / r[ahead, 2:])[:, None]
    seen, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(FISHEYE.distortion))
    assert ahead.sum() > 200
    np.testing.assert_allclose(seen.reshape(-1, 2), uv[ahead], atol=1e-7)


def test_fisheye_sees_behind_itself():
    beyond = np.array([[319.5 + 150.0 * np.radians(100.0), 319.5]])
    r = WIDE.rays(beyond)
    np.testing.assert_allclose(r[0], [np.sin(np.radians(100)), 0.0, np.cos(np.radians(100))], atol=1e-12)
    np.testing.assert_allclose(WIDE.project(r), beyond)


def test_beyond_the_model_is_nan():
    assert np.isnan(replace(FISHEYE, distortion=(-0.3, 0.0, 0.0, 0.0)).rays([[0.0, 0.0]])).all()
    assert np.isnan(PINHOLE.project([[0.0, 0.1, -1.0]])).all()


@CAMERAS
def test_jacobian_of_rays(camera, uv):
    _, J = camera.rays_and_jacobian(uv)
    h = 1e-4
    for k, step in enumerate(h * np.eye(2)):
        difference = (camera.rays(uv + step) - camera.rays(uv - step)) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], difference, atol=2e-9)


@pytest.mark.parametrize("port", ["dome", "flat"])
@pytest.mark.parametrize("camera", [PINHOLE, replace(FISHEYE, f=(300.0, 301.0))])
def test_jacobian_outside_the_housing(camera, port, uv):
    R_bs = Rotation.from_euler("ZYX", [0.4, -0.3, 2.0]).as_matrix()
    camera = replace(camera, port=port, R_bs=R_bs)
    w, J = camera.outside(uv, 1.34)
    h = 1e-4
    for k, step in enumerate(h * np.eye(2)):
        difference = (camera.outside(uv + step, 1.34)[0] - camera.outside(uv - step, 1.34)[0]) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], difference, atol=2e-9)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-13)


def test_dome_keeps_the_rays_and_flat_bends_them(uv):
    inside = PINHOLE.rays(uv) @ UP_FORWARD.T
    np.testing.assert_array_equal(PINHOLE.outside(uv, 1.34)[0], inside)
    flat = replace(PINHOLE, port="flat")
    np.testing.assert_array_equal(flat.outside(uv, 1.0)[0], inside)
    w = flat.outside(uv, 1.34)[0]
    axis = UP_FORWARD[:, 2]
    sine = np.linalg.norm(np.cross(w, axis), axis=1)
    np.testing.assert_allclose(1.34 * sine, np.linalg.norm(np.cross(inside, axis), axis=1), atol=1e-12)


def test_level_flat_port_undoes_the_surface(uv):
    """n_a sin a = n_w sin w = n_a sin inside: no compensation is left to do."""
    up = np.array([0.0, 0.0, -1.0])
    w = replace(FISHEYE, port="flat").outside(uv, 1.34)[0]
    inside = FISHEYE.rays(uv) @ UP_FORWARD.T
    seen = inside @ up > 0.02
    np.testing.assert_allclose(to_air(w, up, 1.34)[seen], inside[seen], atol=1e-12)
    assert np.isnan(w[inside @ up <= 0.0]).all()


def test_up_forward_mounting():
    """Optical axis up, image top towards the bow, columns growing to port."""
    r = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]) @ UP_FORWARD.T
    np.testing.assert_allclose(r, [[0, 0, -1], [1, 0, 0], [0, -1, 0]], atol=1e-15)
    assert np.linalg.det(UP_FORWARD) == pytest.approx(1.0)


@CAMERAS
@pytest.mark.parametrize("factor", [1, 2, 4])
def test_binned_pixel_looks_where_its_middle_did(camera, factor):
    small = camera.binned(factor)
    assert small.size == (camera.size[0] // factor, camera.size[1] // factor)
    bins = np.array([[0.0, 0.0], [10.0, 7.0], [79.0, 59.0]])
    np.testing.assert_allclose(small.rays(bins), camera.rays(factor * bins + (factor - 1) / 2), atol=1e-12)


def test_pixels_run_row_by_row():
    pixels = replace(PINHOLE, size=(3, 2)).pixels()
    np.testing.assert_array_equal(pixels, [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]])


def test_total_reflection_in_the_port():
    steep = np.array([[np.sin(1.5), 0.0, np.cos(1.5)]])
    assert np.isfinite(refract(steep, np.array([0.0, 0.0, 1.0]), 1.34)).all()
    assert np.isnan(refract(steep, np.array([0.0, 0.0, 1.0]), 1 / 1.34)).all()
