"""Pictures of the floor along a dive: what they show is where the truth says, in one camera and in two."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.camera.file import read_camera
from uwgraph.camera.images import read_image
from uwgraph.camera.model import DOWN_FORWARD, Camera
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.rig import AltitudeRig, VisualRig
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate import (
    EchoSounder,
    FloorModel,
    Ground,
    Lamp,
    Murk,
    SimulationSettings,
    Terrain,
    add_floor_images,
    simulate,
    terrain_of,
)
from uwgraph.simulate.floor_light import Light
from uwgraph.simulate.floor_record import recorded
from uwgraph.simulate.floor_render import Eye, look, radiance, ranges
from uwgraph.simulate.floor_snow import add_snow, drift
from uwgraph.simulate.replay import ReferenceMotion

CAMERA = Camera("pinhole", (131.0, 131.0), (79.5, 59.5), (160, 120), (-0.06, 0.02, 0.0, 0.0), R_bs=DOWN_FORWARD)
ASIDE = replace(CAMERA, R_bs=Rotation.from_euler("z", 0.4).as_matrix() @ DOWN_FORWARD, l_b=np.array([0.4, -0.1, 0.2]))
CLEAR = Murk(attenuation=(0.0, 0.0, 0.0), scattering=(0.0, 0.0, 0.0), snow=0.0, diffuse_attenuation=(0.0, 0.0, 0.0))
IDEAL = FloorModel(
    water=CLEAR,
    lamps=(),
    blur=0.0,
    read_noise=0.0,
    full_well=1e7,
    white_balance=0.0,
    format="png",
    rate_hz=0.05,
    altitude=2.0,
    sounder=None,
)

FEW = EchoSounder(rate_hz=0.1)


@pytest.fixture(scope="module")
def dive():
    settings = SimulationSettings(
        pattern="patrol", duration_s=60.0, speed=0.7, depth=1.0, surface_time_s=2.0, leg_length_m=8.0,
        line_spacing_m=6.0, sun=None,
    )  # fmt: skip
    return simulate(settings, seed=3)


@pytest.fixture(scope="module")
def terrain():
    return Terrain(Ground(), 7, 10.0)


def correlation(a, b) -> float:
    return float(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1])


def test_rays_end_on_the_terrain(terrain):
    p_n, R_nb = np.array([2.0, -3.0, 7.0]), matrix_from_rph(np.radians([8.0, -6.0, 130.0]))
    rays_n = np.tensordot(R_nb.astype(np.float32), Eye(CAMERA).rays_b, axes=1)
    sight = look(terrain, p_n, rays_n, 12.0)
    assert sight.met.all()
    hit = p_n + (sight.r * rays_n).reshape(3, -1).T
    off = np.abs(hit[:, 2] - terrain.down(hit[:, :2]))
    assert np.quantile(off, 0.99) < 0.002
    assert off.max() < 0.03
    r = ranges(terrain, np.tile(p_n, (len(hit), 1)), rays_n.reshape(3, -1).T.astype(float), 12.0)
    np.testing.assert_allclose(r, sight.r.ravel(), atol=0.03)
    np.testing.assert_allclose(np.linalg.norm(sight.normal_n, axis=0), 1.0, atol=1e-5)
    assert (sight.normal_n[2] < 0.0).all()


def test_rays_that_miss_the_floor_say_so(terrain):
    up = np.zeros((3, 2, 2), dtype=np.float32)
    up[2] = [[1.0, -1.0], [0.05, 1.0]]
    sight = look(terrain, np.array([0.0, 0.0, 7.0]), up, 12.0)
    assert sight.met.tolist() == [[True, False], [False, True]]
    assert (sight.r[~sight.met] == 12.0).all()
    high = look(terrain, np.array([0.0, 0.0, -5.0]), up, 12.0)
    assert not high.met.any()
    assert np.isnan(ranges(terrain, np.array([[0.0, 0.0, -5.0]]), np.array([[0.0, 0.0, 1.0]]), 12.0)).all()


def test_pictures_show_the_floor_where_the_truth_says(dive, tmp_path):
    """Every picture is the albedo at the places that truth and calibration, and nothing of the renderer, tell."""
    seen = add_floor_images(dive, tmp_path, camera=ASIDE, model=IDEAL, seed=4)
    terrain, motion = terrain_of(seen), ReferenceMotion.of(dive)
    camera = read_camera(tmp_path / "images/down/camera.yaml").camera
    np.testing.assert_allclose(camera.l_b, ASIDE.l_b)
    images = seen.images["down"]
    assert len(images) == 4
    uv = np.random.default_rng(0).uniform([5, 5], [154, 114], (1500, 2)).round()
    for t_ns, file in list(zip(images.t_ns, images.file, strict=True))[::3]:
        t = np.array([(t_ns - motion.start_ns) * 1e-9])
        R_nb = motion.attitude(t)[0]
        p_n = motion.position(t)[0] + R_nb @ camera.l_b
        d_n = camera.rays(uv) @ camera.R_bs.T @ R_nb.T
        r = ranges(terrain, np.tile(p_n, (len(uv), 1)), d_n, 12.0)
        albedo = terrain.albedo((p_n + r[:, None] * d_n)[:, :2])
        picture = cv2.GaussianBlur(read_image(tmp_path / "images/down" / str(file)).astype(float), (0, 0), 1.0)
        values = picture[uv[:, 1].astype(int), uv[:, 0].astype(int)]
        assert correlation(values, (albedo / albedo.max()) ** (1 / 2.2)) > 0.85
        moved = terrain.albedo((p_n + r[:, None] * d_n)[:, :2] + [0.3, 0.0])
        assert correlation(values, moved) < 0.75


def test_a_stereo_pair_differs_by_the_range(terrain):
    """The right camera sees what the left one sees, moved by f b / z."""
    camera = replace(CAMERA, distortion=())
    right = replace(camera, l_b=camera.R_bs @ [0.25, 0.0, 0.0])
    p_n, light = np.array([0.0, 0.0, 7.0]), Light.at((), CLEAR, 10.0)
    views = [radiance(terrain, Eye(c), light, p_n + c.l_b, np.eye(3), 8.0).mean(axis=2) for c in (camera, right)]
    sight = look(terrain, p_n, Eye(camera).rays_b, 12.0)
    v, u = np.mgrid[10:110, 30:150].astype(np.float32)
    z = (sight.r * Eye(camera).rays_b[2])[10:110, 30:150]
    back = cv2.remap(views[1], u - camera.f[0] * 0.25 / z, v, cv2.INTER_LINEAR)
    assert correlation(back, views[0][10:110, 30:150]) > 0.98
    assert correlation(views[1][10:110, 30:150], views[0][10:110, 30:150]) < 0.8


def test_altitude_is_the_range_along_the_sounder(dive, tmp_path):
    rig = AltitudeRig(rotation_deg=(20.0, 0.0, 0.0), translation_m=(0.3, 0.0, 0.1), sigma=0.02, time_offset_s=0.5)
    model = FloorModel(sounder=EchoSounder(rig=rig, rate_hz=2.0), rate_hz=0.015, altitude=2.0, water=Murk(snow=0.0))
    seen = add_floor_images(dive, tmp_path, camera=CAMERA, model=model, seed=4)
    assert seen.rig.altitude == rig
    terrain, motion = terrain_of(seen), ReferenceMotion.of(dive)
    t = (seen.altitude.t_ns - motion.start_ns) * 1e-9 + 0.5
    R_nb = motion.attitude(t)
    end = motion.position(t) + R_nb @ rig.l_b + seen.altitude.altitude[:, None] * (R_nb @ rig.R_bs[:, 2])
    off = (end[:, 2] - terrain.down(end[:, :2])) / np.cos(np.radians(20.0))
    assert len(off) == 121
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.02, rel=0.5)
    assert seen.altitude.altitude.max() > 2.6 > seen.altitude.altitude.min() > 1.5


def test_written_dive_reads_back_and_tells_what_is_simulated(dive, tmp_path):
    late = replace(dive, rig=dive.rig.model_copy(update={"visual": VisualRig(time_offset_s=0.25)}))
    model = IDEAL.model_copy(
        update={"stereo_baseline_m": 0.2, "rate_hz": 0.02, "format": "jpg", "sounder": EchoSounder(rate_hz=0.1)}
    )
    seen = add_floor_images(late, tmp_path / "work", camera=CAMERA, model=model, seed=4)
    write_dive(seen, tmp_path / "dive", images_from=tmp_path / "work")
    back = read_dive(tmp_path / "dive")
    assert set(back.images) == {"down", "down_right"}
    np.testing.assert_array_equal(back.images["down"].t_ns, back.images["down_right"].t_ns)
    assert (back.images["down"].t_ns[0] - dive.reference.t_ns[0]) % 10**9 == 750_000_000
    right = read_camera(tmp_path / "dive/images/down_right/camera.yaml").camera
    np.testing.assert_allclose(right.l_b, [0.0, 0.2, 0.0], atol=1e-12)
    assert read_image(tmp_path / "dive/images/down" / str(back.images["down"].file[0])).shape == (120, 160, 3)
    assert {"images/down", "images/down_right", "altitude"} <= set(back.provenance["simulated"])
    ne = np.random.default_rng(0).uniform(-5, 5, (20, 2))
    np.testing.assert_array_equal(terrain_of(back).down(ne), terrain_of(seen).down(ne))


def test_same_seed_same_pictures(dive, tmp_path):
    model = FloorModel(rate_hz=0.015, altitude=2.0, format="png", sounder=None)
    made = [
        add_floor_images(dive, tmp_path / name, camera=CAMERA, model=model, seed=seed)
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    ]
    file = str(made[0].images["down"].file[-1])
    a, b, c = (read_image(tmp_path / n / "images/down" / file) for n in "abc")
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_the_same_place_looks_otherwise_under_another_lamp_and_with_new_snow(terrain):
    p_n, water = np.array([0.0, 0.0, 7.0]), Murk(daylight=0.0)
    lights = [Light.at((Lamp(place=(0.0, side, 0.0), beam=8.0),), water, 10.0) for side in (-1.0, 1.0)]
    left, right = (radiance(terrain, Eye(CAMERA), light, p_n, np.eye(3), 8.0) for light in lights)
    assert left[:, :60].mean() > 1.5 * left[:, -60:].mean()
    assert right[:, -60:].mean() > 1.5 * right[:, :60].mean()
    rng = np.random.default_rng(0)
    snowy = [left.copy() for _ in range(2)]
    for picture in snowy:
        X, radius = drift(CAMERA, 40.0, rng)
        assert len(X) > 20
        add_snow(picture, CAMERA, lights[0], X, radius)
        assert (picture >= left).all()
    assert np.mean(snowy[0] != snowy[1]) > 0.005


def test_water_takes_red_first_and_veils_with_distance(terrain):
    def seen(height: float, turbidity: float):
        light = Light.at(FloorModel().lamps, Murk(turbidity=turbidity, daylight=0.0), 10.0)
        return radiance(terrain, Eye(CAMERA), light, np.array([0.0, 0.0, 10.0 - height]), np.eye(3), 8.0)

    near, far, murky = seen(2.0, 1.0), seen(5.0, 1.0), seen(5.0, 4.0)
    blue_over_red = [float((x[..., 0] / x[..., 2]).mean()) for x in (near, far)]
    assert blue_over_red[1] > 1.15 * blue_over_red[0]
    contrast = [float((x[..., 1] - cv2.GaussianBlur(x[..., 1], (0, 0), 4)).std() / x[..., 1].mean())
                for x in (near, far, murky)]  # fmt: skip
    assert contrast[0] > contrast[1] > 3.0 * contrast[2]


def test_blank_and_blurred_pictures_can_be_made(terrain):
    light, rng = Light.at((), CLEAR, 10.0), np.random.default_rng(0)
    sharp = radiance(terrain, Eye(CAMERA), light, np.array([0.0, 0.0, 7.0]), np.eye(3), 8.0)
    blurred = recorded(sharp, IDEAL.model_copy(update={"blur": 8.0}), rng)
    assert cv2.Laplacian(blurred, cv2.CV_64F).std() < 0.2 * cv2.Laplacian(recorded(sharp, IDEAL, rng), cv2.CV_64F).std()
    assert not recorded(np.zeros_like(sharp), IDEAL, rng).any()


def test_impossible_wishes_are_refused(dive, tmp_path):
    with pytest.raises(DataError, match="never in sight"):
        add_floor_images(dive, tmp_path, camera=CAMERA, model=FloorModel(depth=60.0))
    with pytest.raises(DataError, match="never in sight"):
        add_floor_images(dive, tmp_path, camera=CAMERA, model=FloorModel(depth=0.0))
    seen = add_floor_images(dive, tmp_path, camera=CAMERA, model=FloorModel(rate_hz=0.015, altitude=2.0, sounder=FEW))
    with pytest.raises(ConfigError, match="has a camera 'down'"):
        add_floor_images(seen, tmp_path, camera=CAMERA)
    with pytest.raises(ConfigError, match="altitude"):
        add_floor_images(seen, tmp_path, camera=CAMERA, name="other")
    with pytest.raises(DataError, match="reference"):
        add_floor_images(replace(dive, reference=None), tmp_path)
    with pytest.raises(ConfigError, match="no simulated floor"):
        terrain_of(dive)
    with pytest.raises(ConfigError, match="depth and seed"):
        terrain_of(replace(seen, provenance={"floor": {"depth": "deep"}}))


def test_pictures_stay_within_the_folder(dive, tmp_path):
    folder = Path(tmp_path / "work")
    add_floor_images(dive, folder, camera=CAMERA, model=FloorModel(rate_hz=0.015, altitude=2.0, sounder=None))
    assert {p.name for p in folder.iterdir()} == {"images"}
