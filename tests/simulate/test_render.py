"""Rendered images against the sky they show: axes, mountings, the surface, depth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import UP_FORWARD, Camera
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import OccluderSettings, Scene
from uwgraph.simulate.sky import SUN_RADIUS, Sky, horizontal_axis
from uwgraph.simulate.stokes import about, transmitted

UP = np.array([0.0, 0.0, -1.0])
TILTED = matrix_from_rph(np.radians([6.0, -4.0, 130.0]))
CALM = Scene(wind=0.0, sun=0.0, vignetting=0.0, attenuation=0.0)


def toward(zenith_deg: float, azimuth_deg: float):
    z, a = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), -np.cos(z)])


def fisheye(size=96, **changes):
    return Camera("fisheye", (size / 2.4,) * 2, ((size - 1) / 2 + 0.3, (size - 1) / 2 - 0.7), (size, size), **changes)


S = toward(50.0, 75.0)


def test_analyser_models_give_back_the_e_vectors_at_any_mounting():
    """By the definition of each model: the field that its AoP stands for is the sky's, in air, at 12 mountings."""
    sky = Sky(S)
    for number in range(12):
        turn = [*np.random.default_rng(number).uniform(-0.5, 0.5, 2), float(number)]
        mounting = UP_FORWARD @ Rotation.from_rotvec(turn).as_matrix()
        for analyser in ("lens", "sheet", "projected"):
            camera = fisheye(48, R_bs=mounting, analyser=analyser)
            image = render(CALM, Shot(camera, TILTED, S)).reshape(-1, 3)
            r = camera.rays(camera.pixels())
            aop = 0.5 * np.arctan2(image[:, 2], image[:, 1])
            field = field_of(analyser, r, aop) @ (TILTED @ mounting).T
            d = r @ (TILTED @ mounting).T
            high = (-d[:, 2] > 0.1) & (r[:, 2] > 0.2)
            seen = sky.stokes(d)
            chi = 0.5 * np.arctan2(seen[:, 2], seen[:, 1])
            x = horizontal_axis(d)
            e = np.cos(chi)[:, None] * x + np.sin(chi)[:, None] * np.cross(d, x)
            np.testing.assert_allclose(np.abs((field * e).sum(axis=1))[high], 1.0, atol=1e-9)
            np.testing.assert_allclose(image[high, 0], seen[high, 0], rtol=1e-12)
            np.testing.assert_allclose(
                np.hypot(image[high, 1], image[high, 2]), np.hypot(seen[high, 1], seen[high, 2]), rtol=1e-9
            )


def field_of(analyser, r, aop):
    """The e-vector in the camera frame that an angle in the image stands for."""
    azimuth = np.arctan2(r[:, 1], r[:, 0])
    if analyser == "lens":
        theta = np.arccos(r[:, 2])
        t_th = np.column_stack([np.cos(theta) * np.cos(azimuth), np.cos(theta) * np.sin(azimuth), -np.sin(theta)])
        t_ph = np.column_stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(len(r))])
        return np.cos(aop - azimuth)[:, None] * t_th + np.sin(aop - azimuth)[:, None] * t_ph
    if analyser == "sheet":
        e = np.cross(r, np.column_stack([-np.sin(aop), np.cos(aop), np.zeros(len(r))]))
        return e / np.linalg.norm(e, axis=1)[:, None]
    x = np.array([1.0, 0.0, 0.0]) - r[:, :1] * r
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.cos(aop)[:, None] * x + np.sin(aop)[:, None] * np.cross(r, x)


def test_calm_water_is_the_analytic_image():
    """Flat sea, clear water: Snell, n^2 T and the Mueller matrix of textbooks, pixel by pixel."""
    n, camera = CALM.n, fisheye(analyser="projected")
    image = render(CALM, Shot(camera, TILTED, S, depth=4.0)).reshape(-1, 3)
    R = TILTED @ camera.R_bs
    sky = Sky(S)
    for pixel in range(0, len(image), 97):
        r = camera.rays(camera.pixels()[pixel : pixel + 1])[0]
        w = R @ r
        sin_a = n * np.sin(np.arccos(-w[2]))
        if -w[2] <= 0 or sin_a >= 0.999:
            continue
        cos_a, cos_w = np.sqrt(1 - sin_a**2), -w[2]
        a = n * w + (cos_a - n * cos_w) * UP
        light = sky.stokes(a[None])[0]
        R_s = ((cos_a - n * cos_w) / (cos_a + n * cos_w)) ** 2
        R_p = ((n * cos_a - cos_w) / (n * cos_a + cos_w)) ** 2
        s_part, p_part = (light[0] + light[1]) / 2 * (1 - R_s), (light[0] - light[1]) / 2 * (1 - R_p)
        u_part = light[2] * np.sqrt((1 - R_s) * (1 - R_p))
        expected = n**2 * np.array([s_part + p_part, s_part - p_part, u_part])
        x = R @ (np.array([1.0, 0.0, 0.0]) - r[0] * r)
        expected = about(expected[None], w[None], horizontal_axis(w[None]), (x / np.linalg.norm(x))[None])[0]
        np.testing.assert_allclose(image[pixel], expected, rtol=1e-9, atol=1e-12)


def test_outside_the_window_there_is_no_sky_and_inside_it_is_all():
    camera = fisheye()
    image = render(CALM, Shot(camera, np.eye(3), S, depth=4.0))
    zenith = np.degrees(np.arccos(camera.rays(camera.pixels())[:, 2])).reshape(96, 96)
    half = np.degrees(np.arcsin(1.0 / CALM.n))
    assert not image[zenith > half + 1e-6].any()
    assert (image[zenith < half - 0.1, 0] > 0.0).all()


@pytest.mark.parametrize("depth", [None, 0.5, 5.0, 20.0])
def test_light_is_never_more_than_fully_polarized(depth):
    body = (OccluderSettings(clutter="random", dop=1.0, share=0.4),)
    rough = Scene(wind=12.0, swell_height=2.0, dop_max=1.0, occluders=body, clouds=0.3)
    for analyser in ("lens", "sheet", "projected"):
        image = render(rough, Shot(fisheye(64, analyser=analyser), TILTED, S, depth), seed=3)
        assert np.isfinite(image).all()
        assert (np.hypot(image[..., 1], image[..., 2]) <= image[..., 0] * (1 + 1e-9)).all()


@pytest.mark.parametrize("n", [1.34, 1 / 1.34])
def test_surface_maps_physical_light_to_physical_light_and_conserves_energy(n):
    """What is not transmitted is reflected: unpolarized flux out is 1 - (R_s + R_p) / 2 of that in."""
    cos_in = np.linspace(1.0 if n > 1 else np.sqrt(1 - n**2) + 1e-3, 0.99, 50)
    cos_out = np.sqrt(1 - (1 - cos_in**2) / n**2)
    angle = np.linspace(0, 2 * np.pi, 50)
    out = transmitted(np.column_stack([np.ones(50), np.cos(angle), np.sin(angle)]), cos_in, cos_out, n)
    assert (np.hypot(out[:, 1], out[:, 2]) <= out[:, 0] * (1 + 1e-12)).all()
    flux = transmitted(np.tile([1.0, 0.0, 0.0], (50, 1)), cos_in, cos_out, n)[:, 0] / n**2
    R_s = ((cos_in - n * cos_out) / (cos_in + n * cos_out)) ** 2
    R_p = ((n * cos_in - cos_out) / (n * cos_in + cos_out)) ** 2
    np.testing.assert_allclose(flux, 1 - (R_s + R_p) / 2, rtol=1e-12)


def test_level_flat_port_undoes_the_refraction():
    """A level upward flat port shows the sky at its angles in air, twice through the same surface."""
    dome, flat = Camera("pinhole", (60.0, 60.0), (31.5, 31.5), (64, 64)), None
    flat = replace(dome, port="flat")
    under, above = (render(CALM, Shot(camera, np.eye(3), S, depth)) for camera, depth in ((flat, 3.0), (dome, None)))
    r = dome.rays(dome.pixels())
    cos_a = r[:, 2]
    cos_w = np.sqrt(1 - (1 - cos_a**2) / CALM.n**2)
    d = r @ dome.R_bs.T
    lens_x = Sky(S).stokes(d)
    behind = transmitted(transmitted(lens_x, cos_a, cos_w, CALM.n), cos_w, cos_a, 1 / CALM.n)
    np.testing.assert_allclose(under[..., 0].ravel(), behind[:, 0], rtol=1e-9)
    assert (under[..., 0] < above[..., 0]).all()


def test_waves_average_to_the_calm_sea_and_move():
    scene = CALM.model_copy(update={"wind": 2.0})
    shots = [Shot(fisheye(64), np.eye(3), S, 5.0, t_s=2.0 * k) for k in range(20)]
    images = np.stack([render(scene, shot, seed=1)[..., 0] for shot in shots])
    calm = render(CALM, shots[0])[..., 0]
    middle = np.s_[20:44, 20:44]
    np.testing.assert_allclose(images.mean(axis=0)[middle], calm[middle], rtol=0.12)
    assert np.abs(images[0] - images[1])[middle].max() > 0.02


def test_swell_tilts_the_whole_window():
    """Deep below the crests of a long swell the window leans by about (1 - 1/n) of the slope, as one."""
    scene = CALM.model_copy(update={"swell_height": 3.0, "swell_period": 10.0})
    camera = fisheye()
    row, column = np.mgrid[0:96, 0:96]
    places = []
    for t in np.arange(0.0, 20.0, 2.0):
        lit = render(scene, Shot(camera, np.eye(3), S, 3.0, t_s=float(t)), seed=2)[..., 0] > 0
        places.append([row[lit].mean(), column[lit].mean()])
    assert np.ptp(np.array(places), axis=0).max() > 0.3


def test_light_and_polarization_fade_with_depth():
    """Mean over the window's middle: radiance and degree of polarization both fall; structure is blurred."""
    scene = Scene(wind=0.0, sun=20.0, occluders=(OccluderSettings(shape="canopy", share=0.3, brightness=0.05),))
    middle = np.s_[36:60, 36:60]
    light, dop = [], []
    for depth in (0.5, 2.0, 5.0, 10.0, 20.0, 40.0):
        image = render(scene, Shot(fisheye(), np.eye(3), toward(65.0, 40.0), depth), seed=5)[middle]
        light.append(image[..., 0].mean())
        dop.append((np.hypot(image[..., 1], image[..., 2]) / image[..., 0]).mean())
    assert (np.diff(light) < 0.0).all()
    assert (np.diff(dop) < 0.0).all()


def test_sun_is_where_it_is():
    """Brightest pixel in air and through a calm sea, at the refracted direction."""
    camera, scene = fisheye(192), CALM.model_copy(update={"sun": 20.0})
    for depth, sun in ((None, S), (3.0, None)):
        if sun is None:
            sun = S / scene.n
            sun[2] = -np.sqrt(1 - sun[0] ** 2 - sun[1] ** 2)
        image = render(scene, Shot(camera, TILTED, S, depth))[..., 0]
        expected = camera.project((sun @ TILTED @ camera.R_bs)[None])[0]
        bright = np.argwhere(image > 0.5 * image.max())[:, ::-1].mean(axis=0)
        assert np.linalg.norm(bright - expected) < 1.0
    assert SUN_RADIUS < 0.005


def test_supersampling_converges_to_the_pixel_mean():
    """On the smooth calm image many samples per pixel and one agree; on waves they take the sparkle out."""
    shot = Shot(fisheye(64), np.eye(3), S, 5.0)
    one, many = (render(CALM.model_copy(update={"samples": k}), shot)[20:44, 20:44, 0] for k in (1, 4))
    np.testing.assert_allclose(one, many, rtol=5e-3)
    windy = CALM.model_copy(update={"wind": 6.0})
    rough, smooth = (render(windy.model_copy(update={"samples": k}), shot, 1)[20:44, 20:44, 0] for k in (1, 8))
    assert np.diff(smooth, axis=1).std() < 0.8 * np.diff(rough, axis=1).std()


def test_same_seed_same_image_other_seed_another():
    scene, shot = Scene(clouds=0.4, wind=3.0), Shot(fisheye(48), np.eye(3), S, 3.0)
    first, again, other = (render(scene, shot, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_vignetting_darkens_the_corners_only():
    bright, dark = (
        render(CALM.model_copy(update={"vignetting": v}), Shot(fisheye(), np.eye(3), S)) for v in (0.0, 0.4)
    )
    assert dark[48, 48, 0] == pytest.approx(bright[48, 48, 0], rel=1e-3)
    assert dark[0, 0, 0] == pytest.approx(0.6 * bright[0, 0, 0], rel=1e-6)
