"""Images along a dive: what is written, when, and that they show the sun of the time and place."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.camera.file import read_camera
from uwgraph.camera.model import Camera
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate import ImageModel, Scene, SimulationSettings, add_sun_images, simulate
from uwgraph.sun import sun_azimuth_elevation
from uwgraph.time import from_seconds

CAMERA = Camera("fisheye", f=(42.0, 42.0), c=(47.5, 47.5), size=(96, 96))
MODEL = ImageModel(rate_hz=0.05)
CALM = Scene(wind=0.0, attenuation=0.05, albedo=0.0, vignetting=0.0)


@pytest.fixture(scope="module")
def dive():
    return simulate(SimulationSettings(duration_s=300.0, truth_rate_hz=5.0, depth=8.0), seed=3)


def pictures(folder: Path, dive):
    return [cv2.imread(str(folder / "images/sky" / f), cv2.IMREAD_UNCHANGED) for f in dive.images["sky"].file]


def test_images_show_the_sun_of_time_and_place(dive, tmp_path):
    """The brightest spot, refracted back and turned by the true attitude, is at the almanac's azimuth and zenith."""
    seen = add_sun_images(dive, tmp_path, camera=CAMERA, scene=CALM, model=MODEL)
    reference, images = dive.reference, seen.images["sky"]
    assert len(images) > 8
    for t_ns, picture in zip(images.t_ns, pictures(tmp_path, seen), strict=True):
        now = int(np.argmin(np.abs(reference.t_ns - t_ns)))
        assert reference.t_ns[now] == t_ns
        bright = np.argwhere(picture >= 0.9 * picture.max())[:, ::-1].mean(axis=0)
        w = matrix_from_rph(reference.rph[now]) @ CAMERA.R_bs @ CAMERA.rays(bright[None])[0]
        azimuth, elevation = sun_azimuth_elevation(t_ns, reference.lat[now], reference.lon[now])
        assert abs(wrap_pi(np.arctan2(w[1], w[0]) - azimuth[0])) < np.radians(4.0)
        zenith = np.arcsin(1.34 * np.hypot(w[0], w[1]))
        assert abs(zenith - (np.pi / 2 - elevation[0])) < np.radians(4.0)


def test_written_dive_reads_back_with_its_images(dive, tmp_path):
    seen = add_sun_images(dive, tmp_path / "work", camera=CAMERA, scene=CALM, model=MODEL)
    write_dive(seen, tmp_path / "dive", images_from=tmp_path / "work")
    back = read_dive(tmp_path / "dive")
    assert back.images["sky"].file.tolist() == seen.images["sky"].file.tolist()
    assert read_camera(tmp_path / "dive/images/sky/camera.yaml").camera.size == (96, 96)
    first = pictures(tmp_path / "dive", back)[0]
    assert first.dtype == np.uint16
    assert first.shape == (96, 96)
    assert 2000 < first.max() <= 4095
    assert "images/sky" in back.provenance["simulated"]


def test_calibration_is_written_beside_the_images(dive, tmp_path):
    camera = Camera(
        "fisheye", (42.0, 43.0), (47.5, 47.0), (96, 96), R_bs=Rotation.from_rotvec([3.0, 0.2, 0.1]).as_matrix()
    )
    model = ImageModel(kind="polarization", rate_hz=0.005, depth=3.0)
    add_sun_images(dive, tmp_path, camera=camera, scene=CALM, model=model)
    file = read_camera(tmp_path / "images/sky/camera.yaml")
    assert (file.camera.f, file.camera.c, file.mosaic) == (camera.f, camera.c, "sony")
    np.testing.assert_allclose(file.camera.R_bs, camera.R_bs, atol=1e-12)
    assert file.sensor == model.sensor


def test_same_seed_same_pictures(dive, tmp_path):
    folders = [tmp_path / name for name in ("a", "b", "c")]
    made = [
        add_sun_images(dive, folder, camera=CAMERA, scene=Scene(wind=3.0), model=MODEL, seed=seed)
        for folder, seed in zip(folders, (1, 1, 2), strict=True)
    ]
    first, again, other = (np.stack(pictures(f, d)) for f, d in zip(folders, made, strict=True))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


def test_deep_water_is_dark_in_spite_of_the_automatic_exposure(dive, tmp_path):
    level = []
    for depth in (5.0, 60.0):
        model = ImageModel(rate_hz=0.005, depth=depth)
        seen = add_sun_images(dive, tmp_path / f"{depth}", camera=CAMERA, scene=Scene(wind=0.0), model=model)
        level.append(np.median(pictures(tmp_path / f"{depth}", seen)[0]))
    assert level[1] < 0.1 * level[0]


def test_mosaic_images_have_four_polarizers(dive, tmp_path):
    model = MODEL.model_copy(update={"kind": "polarization", "bits": 16, "full_well": 1e6})
    seen = add_sun_images(dive, tmp_path, camera=CAMERA, scene=Scene(wind=0.0, sun=0.0), model=model)
    raw = pictures(tmp_path, seen)[0].astype(float)
    f90, f45, f135, f0 = raw[0::2, 0::2], raw[0::2, 1::2], raw[1::2, 0::2], raw[1::2, 1::2]
    window = np.s_[14:34, 14:34]
    total = (f0 + f90 + f45 + f135)[window]
    assert np.median(np.abs(f0 + f90 - f45 - f135)[window] / total) < 0.01
    assert np.median(np.hypot(f0 - f90, f45 - f135)[window] / total) > 0.1


def test_no_image_while_surfaced(dive, tmp_path):
    seen = add_sun_images(dive, tmp_path / "a", camera=CAMERA, scene=CALM, model=ImageModel(rate_hz=0.2))
    deep = np.interp(seen.images["sky"].t_ns, dive.reference.t_ns, -dive.reference.height)
    assert (deep > 0.05).all()
    dry = replace(dive, reference=replace(dive.reference, height=np.full_like(dive.reference.height, 5.0)))
    with pytest.raises(DataError, match="never under water"):
        add_sun_images(dry, tmp_path / "b", camera=CAMERA, scene=CALM, model=MODEL)
    held = add_sun_images(dry, tmp_path / "c", camera=CAMERA, scene=CALM, model=ImageModel(rate_hz=0.01, depth=5.0))
    assert len(held.images["sky"]) == 4


def test_night_and_a_taken_name_are_refused(dive, tmp_path):
    reference = dive.reference
    night = replace(
        dive, reference=replace(reference, t_ns=from_seconds(12 * 3600.0 + reference.t_s, reference.t_ns[0]))
    )
    with pytest.raises(DataError, match="the sun is below"):
        add_sun_images(night, tmp_path, camera=CAMERA, model=MODEL)
    seen = add_sun_images(dive, tmp_path, camera=CAMERA, scene=CALM, model=ImageModel(rate_hz=0.005, depth=3.0))
    with pytest.raises(ConfigError, match="has a camera 'sky'"):
        add_sun_images(seen, tmp_path, camera=CAMERA, scene=CALM, model=MODEL)


@pytest.mark.slow
def test_command_renders_images_along_a_dive(tmp_path):
    uwgraph = Path(sys.executable).with_name("uwgraph")

    def run(*arguments):
        command = [str(uwgraph), "simulate", *map(str, arguments)]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "200"}
        )

    short = ("--duration", 60, "--no-sun", "--image-rate", 0.05, "--image-depth", 5)
    done = run(tmp_path / "dive", *short, "--images", "polarization", "--wind", 2)
    assert done.returncode == 0, done.stderr
    seen = read_dive(tmp_path / "dive")
    assert len(seen.images["sky"]) == 4
    assert [entry.name for entry in tmp_path.iterdir()] == ["dive"]
    again = run(tmp_path / "again", "--on", tmp_path / "dive", "--images", "gradient")
    assert again.returncode == 2
    assert "has a camera 'sky'" in again.stderr
    refused = run(tmp_path / "other", *short)
    assert refused.returncode == 2
    assert "--images" in refused.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["dive"]
