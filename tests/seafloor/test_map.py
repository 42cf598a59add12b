"""Whole maps of a floor that is known: accuracy, re-deformation, what is left out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
from floor_scene import Scene, height_error
from scipy.spatial.transform import Rotation

from uwgraph.camera.eyes import choose_eyes
from uwgraph.errors import DataError
from uwgraph.export import Track
from uwgraph.frames import geodetic_from_ned, rph_from_matrix
from uwgraph.seafloor import MapSettings, deform_map, make_map
from uwgraph.seafloor.links import closure_links
from uwgraph.seafloor.patch import read_patch
from uwgraph.seafloor.poses import poses_at
from uwgraph.types import FloatArray, RelativePoses

QUICK = MapSettings(voxel_m=0.06, pixel_m=0.04)
FILES = {"cloud.ply", "map.png", "ortho.png", "ortho.pgw", "graph.json", "map.json", "config.yaml", "keyframes"}


def points_n(folder: Path) -> FloatArray:
    east, north, up = np.asarray(o3d.io.read_point_cloud(str(folder / "cloud.ply")).points).T
    return np.column_stack([north, east, -up])


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def single_frames(scene: Scene, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Errors of all keyframes' points at the true poses, and their stated 1-sigma: the sensor's own noise."""
    files = sorted((folder / "keyframes").iterdir())
    poses, _ = poses_at(scene.dive, scene.truth, np.array([int(f.stem) for f in files]))
    errors, sigmas = [], []
    for k, file in enumerate(files):
        patch = read_patch(file)
        errors.append(height_error(patch.points_n(poses.R_nb[k], poses.p_n[k])[patch.measured]))
        sigmas.append(np.hypot(patch.sigma, patch.common)[patch.measured])
    return np.concatenate(errors), np.concatenate(sigmas)


def drifted(track: Track) -> Track:
    """A track that walks away by 1.5 m and turns by 3 degrees."""
    share = np.linspace(0.0, 1.0, len(track))
    R = Rotation.from_rotvec(np.radians(3.0) * share[:, None] * [0.0, 0.0, 1.0]).as_matrix() @ track.R_nb
    p_n = track.p_n + share[:, None] * [1.2, -0.9, 0.0]
    lat, lon, height = geodetic_from_ned(track.origin, p_n)
    rph = rph_from_matrix(np.swapaxes(track.R_n_local, 1, 2) @ R)
    return replace(track, p_n=p_n, lat=lat, lon=lon, height=height, rph=rph)


@pytest.fixture(scope="module")
def stereo_map(stereo_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("stereo_map") / "map"
    make_map(stereo_scene.dive, choose_eyes(stereo_scene.dive, stereo_scene.folder), stereo_scene.truth, out, QUICK)
    return out


def test_a_stereo_map_is_better_than_one_look(stereo_scene: Scene, stereo_map: Path) -> None:
    error, sigma = single_frames(stereo_scene, stereo_map)
    cloud = points_n(stereo_map)
    assert rms(error) < 0.035
    assert rms(height_error(cloud)) < rms(error)
    assert 0.3 < 1.4826 * np.median(np.abs(error / sigma)) < 1.2  # careful on so clear a texture, never bold
    assert {f.name for f in stereo_map.iterdir()} == FILES
    report = json.loads((stereo_map / "map.json").read_text())
    assert report["ranges"] == "stereo"
    assert report["keyframes"] == 36
    assert report["spread_m"] < 0.03
    covered = cv2.imread(str(stereo_map / "ortho.png"), cv2.IMREAD_UNCHANGED)[..., 3].mean() / 255
    assert covered > 0.5


def test_a_map_of_soundings(mono_scene: Scene, tmp_path: Path) -> None:
    figures = make_map(
        mono_scene.dive, choose_eyes(mono_scene.dive, mono_scene.folder), mono_scene.truth, tmp_path / "m"
    )
    error, sigma = single_frames(mono_scene, tmp_path / "m")
    assert figures["ranges"] == "altitude"
    assert rms(height_error(points_n(tmp_path / "m"))) < 0.1  # the floor bends by 0.14 m within an image
    assert 0.5 < rms(error / sigma) < 1.5


@pytest.mark.slow
def test_a_deformed_map_is_the_map_of_the_better_solution(
    stereo_scene: Scene, stereo_map: Path, tmp_path: Path
) -> None:
    scene = stereo_scene
    eyes, bad = choose_eyes(scene.dive, scene.folder), drifted(scene.truth)
    before = make_map(scene.dive, eyes, bad, tmp_path / "bad", QUICK)
    after = deform_map(replace(scene.dive, images={}), tmp_path / "bad", scene.truth, tmp_path / "good")
    truth = points_n(stereo_map)
    assert rms(height_error(points_n(tmp_path / "bad"))) > 1.5 * rms(height_error(truth))
    assert before["spread_m"] > 1.5 * after["spread_m"]
    assert rms(height_error(points_n(tmp_path / "good"))) < 1.02 * rms(height_error(truth))
    assert len(points_n(tmp_path / "good")) == pytest.approx(len(truth), rel=0.01)
    again = deform_map(scene.dive, tmp_path / "good", scene.truth, tmp_path / "good", overwrite=True)
    assert again["points"] == after["points"]
    assert {f.name for f in (tmp_path / "good").iterdir()} == FILES


def test_closures_are_links_of_the_graph(stereo_scene: Scene, stereo_map: Path, tmp_path: Path) -> None:
    t_ns = stereo_scene.dive.images["down"].t_ns
    ends = np.array([[2, 25], [3, 26], [4, 20]])
    closures = RelativePoses(
        t_ns[ends[:, 1]], from_ns=t_ns[ends[:, 0]], p=np.zeros((3, 3)), rotvec=np.zeros((3, 3)),
        cov=np.tile(np.eye(6), (3, 1, 1)), accepted=np.array([True, True, False]),
        reason=np.array(["verified"] * 3), inliers=np.full(3, 50),
    )  # fmt: skip
    dive = replace(stereo_scene.dive, closures=closures)
    figures = deform_map(dive, stereo_map, stereo_scene.truth, tmp_path / "m")
    graph = json.loads((tmp_path / "m" / "graph.json").read_text())
    assert figures["closures"] == 2
    assert len(graph["nodes"]) == 36
    assert [(x["source"], x["target"]) for x in graph["links"] if x["kind"] == "closure"] == [(2, 25), (3, 26)]
    assert sum(x["kind"] == "way" for x in graph["links"]) == 35
    assert closure_links(t_ns[ends[:1]], t_ns).tolist() == [[2, 25]]
    assert not len(closure_links(t_ns[ends] + 10**13, t_ns))


def _broken(scene: Scene, spoil: Callable[[Path], None], place: Path) -> Path:
    """A copy of the images by links, with some spoiled."""
    for camera in scene.dive.images:
        folder = place / "images" / camera
        folder.mkdir(parents=True)
        for file in (scene.folder / "images" / camera).iterdir():
            (folder / file.name).symlink_to(file)
    spoil(place / "images" / "down")
    return place


def _spoil_some(folder: Path) -> None:
    files = sorted(folder.glob("*.png"))
    files[3].unlink()
    whole = files[5].read_bytes()
    files[5].unlink()
    files[5].write_bytes(whole[: len(whole) // 3])
    for k, size in ((7, (192, 256)), (9, (100, 100))):
        files[k].unlink()
        cv2.imwrite(str(files[k]), np.full((*size, 3), 80, np.uint8))


def test_bad_images_are_left_out_and_told(stereo_scene: Scene, tmp_path: Path) -> None:
    place = _broken(stereo_scene, _spoil_some, tmp_path / "dive")
    track = stereo_scene.truth.select(stereo_scene.truth.t_ns < stereo_scene.truth.t_ns[0] + 45 * 10**9)
    figures = make_map(stereo_scene.dive, choose_eyes(stereo_scene.dive, place), track, tmp_path / "m", QUICK)
    assert figures["keyframes"] == 9
    told = " ".join(figures["refused"])
    assert sum(figures["refused"].values()) == 4
    for word in ("no such image", "100 x 100", "hardly anything agrees"):
        assert word in told


def test_a_stereo_pair_finds_the_floor_without_a_sounder(stereo_scene: Scene, tmp_path: Path) -> None:
    track = stereo_scene.truth.select(stereo_scene.truth.t_ns < stereo_scene.truth.t_ns[0] + 32 * 10**9)
    dive = replace(stereo_scene.dive, altitude=None)
    figures = make_map(dive, choose_eyes(dive, stereo_scene.folder), track, tmp_path / "m", MapSettings(pixel_m=0.04))
    assert figures["voxel_m"] == pytest.approx(0.03, rel=0.15)
    assert figures["keyframes"] == 6
    assert rms(height_error(points_n(tmp_path / "m"))) < 0.02


def test_no_usable_image_is_an_error_and_nothing_is_written(mono_scene: Scene, tmp_path: Path) -> None:
    place = _broken(mono_scene, lambda folder: [f.unlink() for f in folder.glob("*.png")], tmp_path / "dive")
    with pytest.raises(DataError, match="none of 36 images"):
        make_map(mono_scene.dive, choose_eyes(mono_scene.dive, place), mono_scene.truth, tmp_path / "m")
    assert not (tmp_path / "m").exists()


def test_what_a_map_needs(mono_scene: Scene, tmp_path: Path) -> None:
    dive, folder, truth = mono_scene.dive, mono_scene.folder, mono_scene.truth
    eyes = choose_eyes(dive, folder)
    with pytest.raises(DataError, match="how far the floor"):
        make_map(replace(dive, altitude=None), eyes, truth, tmp_path / "m")
    early = truth.select(truth.t_ns < truth.t_ns[0] + 5 * 10**9)
    with pytest.raises(DataError, match="none of the images"):
        make_map(dive, eyes, early, tmp_path / "m")
    with pytest.raises(DataError, match="fewer than two poses"):
        make_map(dive, eyes, truth.select(slice(0, 1)), tmp_path / "m")
    with pytest.raises(DataError, match="is no map"):
        deform_map(dive, tmp_path, truth, tmp_path / "m")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    with pytest.raises(DataError, match="not empty"):
        make_map(dive, eyes, truth, tmp_path / "mine", overwrite=True)
    assert not (tmp_path / "m").exists()


def test_part_of_the_way_and_fewer_keyframes(mono_scene: Scene, tmp_path: Path) -> None:
    part = mono_scene.truth.select(mono_scene.truth.t_ns < mono_scene.truth.t_ns[0] + 50 * 10**9)
    figures = make_map(
        mono_scene.dive, choose_eyes(mono_scene.dive, mono_scene.folder), part, tmp_path / "m",
        MapSettings(keyframe_step=0.6, voxel_m=0.1, pixel_m=0.05),
    )  # fmt: skip
    assert figures["left_out"]["outside the solution"] == 21
    assert figures["left_out"]["close to the last keyframe"] >= 5
    assert figures["voxel_m"] == 0.1
    assert figures["pixel_m"] == 0.05
