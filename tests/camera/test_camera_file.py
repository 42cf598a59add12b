"""Camera files: ours, Kalibr's, OpenCV's; what is wrong is named by file and field."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.camera.file import CameraFile, read_camera, write_camera
from uwgraph.camera.model import DOWN_FORWARD, UP_FORWARD, Camera, check_size
from uwgraph.camera.sensor import Sensor
from uwgraph.errors import ConfigError, DataError, UwgraphError

OURS = {"model": "fisheye", "f": [820.5, 819.8], "c": [1223.2, 1022.9], "size": [2448, 2048]}
MATRIX = np.array([[500.5, 0.0, 320.25], [0.0, 501.5, 240.75], [0.0, 0.0, 1.0]])
RADTAN = np.array([[-0.21, 0.05, 1e-3, -2e-3, 0.01]])


@pytest.fixture
def given_file(tmp_path):
    def write(values, name="cam.yaml"):
        path = tmp_path / name
        path.write_text(values if isinstance(values, str) else yaml.safe_dump(values))
        return path

    return write


def opencv_file(path, marker=None, distortion=RADTAN):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", distortion)
    if marker:
        storage.write(*marker)
    storage.release()
    return path


def same(a: Camera, b: Camera) -> bool:
    plain = ("model", "f", "c", "size", "distortion", "port", "analyser")
    return all(getattr(a, name) == getattr(b, name) for name in plain) and np.allclose(a.R_bs, b.R_bs, atol=1e-12)


def test_ours_with_defaults(given_file):
    found = read_camera(given_file(OURS))
    assert same(found.camera, Camera("fisheye", (820.5, 819.8), (1223.2, 1022.9), (2448, 2048)))
    assert np.array_equal(found.camera.R_bs, UP_FORWARD)
    assert found.sensor is None
    assert found.mosaic is None
    assert found.polarizer_deg is None


@pytest.mark.parametrize("rows", [False, True])
def test_mounting_as_numbers_or_rows(given_file, rows):
    R = Rotation.from_euler("ZYX", [0.3, -0.2, 0.1]).as_matrix()
    found = read_camera(given_file(OURS | {"R_bs": R.tolist() if rows else R.ravel().tolist(), "f": 800}))
    np.testing.assert_allclose(found.camera.R_bs, R, atol=1e-12)
    assert found.camera.f == (800.0, 800.0)


def test_rounded_rotation_becomes_exact(given_file):
    R = Rotation.from_euler("ZYX", [0.3, -0.2, 0.1]).as_matrix().round(4)
    found = read_camera(given_file(OURS | {"R_bs": R.ravel().tolist()})).camera.R_bs
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    model=st.sampled_from(["pinhole", "fisheye"]),
    numbers=st.lists(st.floats(0.1, 5000.0), min_size=4, max_size=4),
    angles=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    port=st.sampled_from(["dome", "flat"]),
    analyser=st.sampled_from(["lens", "sheet", "projected"]),
    sensor=st.none() | st.builds(Sensor, white=st.floats(1.0, 65535.0), black=st.floats(0.0, 500.0)),
    mosaic=st.none() | st.just("sony"),
    polarizer=st.none() | st.just((0.0, 45.0, 90.0, 135.0)),
)
def test_written_is_read_back(tmp_path, model, numbers, angles, port, analyser, sensor, mosaic, polarizer):
    fu, fv, cu, cv = numbers
    R = Rotation.from_euler("ZYX", angles).as_matrix()
    camera = Camera(model, (fu, fv), (cu, cv), (640, 480), (0.1, -0.02, 0.0, 1e-3), R, port, analyser, np.array(angles))
    write_camera(tmp_path / "c.yaml", CameraFile(camera, sensor, mosaic, polarizer))
    found = read_camera(tmp_path / "c.yaml")
    assert same(found.camera, camera)
    np.testing.assert_array_equal(found.camera.l_b, camera.l_b)
    assert (found.sensor, found.mosaic, found.polarizer_deg) == (sensor, mosaic, polarizer)


@pytest.mark.parametrize("R_bs", [UP_FORWARD, DOWN_FORWARD])
def test_usual_mountings_are_named(tmp_path, R_bs):
    write_camera(tmp_path / "c.yaml", CameraFile(Camera("pinhole", (500, 500), (320, 240), (640, 480), R_bs=R_bs)))
    assert "mount: " in (tmp_path / "c.yaml").read_text()
    np.testing.assert_array_equal(read_camera(tmp_path / "c.yaml").camera.R_bs, R_bs)


def test_down_forward_looks_down_and_ahead():
    axes = DOWN_FORWARD @ np.eye(3)
    np.testing.assert_array_equal(axes[:, 2], [0, 0, 1])  # the optical axis points down
    np.testing.assert_array_equal(axes[:, 0], [0, 1, 0])  # columns grow to starboard
    np.testing.assert_array_equal(-axes[:, 1], [1, 0, 0])  # the image's top is ahead


@pytest.mark.parametrize(("bend", "model"), [("radtan", "pinhole"), ("equidistant", "fisheye"), ("equi", "fisheye")])
def test_kalibr(given_file, bend, model):
    chain = {
        name: {
            "camera_model": "pinhole",
            "distortion_model": bend,
            "distortion_coeffs": [0.01, 0.02, 0.003, k],
            "intrinsics": [461.6, 460.3, 363.0, 248.1],
            "resolution": [752, 480],
            "rostopic": "/cam0/image_raw",
            "T_cam_imu": np.eye(4).tolist(),
        }
        for name, k in (("cam1", 9.0), ("cam0", 0.004))
    }
    camera = read_camera(given_file(chain)).camera
    assert same(camera, Camera(model, (461.6, 460.3), (363.0, 248.1), (752, 480), (0.01, 0.02, 0.003, 0.004)))


@pytest.mark.parametrize("name", ["c.yml", "c.xml"])
def test_opencv(tmp_path, name):
    camera = read_camera(opencv_file(tmp_path / name)).camera
    assert same(camera, Camera("pinhole", (500.5, 501.5), (320.25, 240.75), (640, 480), tuple(RADTAN.ravel())))


@pytest.mark.parametrize("name", ["c.yml", "c.xml"])
@pytest.mark.parametrize("marker", [("fisheye_model", 1), ("distortion_model", "fisheye")])
def test_opencv_fisheye(tmp_path, name, marker):
    camera = read_camera(opencv_file(tmp_path / name, marker, np.full((4, 1), 0.01))).camera
    assert same(camera, Camera("fisheye", (500.5, 501.5), (320.25, 240.75), (640, 480), (0.01,) * 4))


def test_opencv_4_header(tmp_path):
    path = opencv_file(tmp_path / "c.yml")
    body = path.read_text().split("---", 1)[1]
    path.write_text("%YAML:1.0\n---" + body)
    assert read_camera(path).camera.f == (500.5, 501.5)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"f": [-1, 800]}, "f"),
        ({"f": [float("nan"), 800]}, "f"),
        ({"size": [0, 10]}, "size"),
        ({"size": [640.5, 480]}, "size"),
        ({"model": "omni"}, "model"),
        ({"port": "round"}, "port"),
        ({"analyser": "mirror"}, "analyser"),
        ({"mount": "down"}, "mount"),
        ({"distortion": [0.1, 0.2]}, "distortion"),
        ({"mount": "up-forward", "R_bs": np.eye(3).ravel().tolist()}, "R_bs"),
        ({"R_bs": [1, 0, 0, 0, 1, 0, 0, 0.1, 1]}, "R_bs"),
        ({"R_bs": [1, 0, 0, 0, 1, 0, 0, 0, -1]}, "R_bs"),
        ({"R_bs": [1, 0, 0]}, "R_bs"),
        ({"sensor": {"black": 3}}, "sensor.white"),
        ({"sensor": {"white": 4000, "gain": 0}}, "sensor.gain"),
        ({"polarizer_deg": [0, 90]}, "polarizer_deg"),
        ({"focal": 3}, "focal"),
    ],
)
def test_faults_name_file_and_field(given_file, change, field):
    path = given_file(OURS | change)
    with pytest.raises(ConfigError) as caught:
        read_camera(path)
    assert str(path) in caught.value.where
    assert field in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "3",
        "model: [",
        "a: &a [1]\nb: *a",
        "!!python/object/apply:os.system ['true']",
        "cam0: {camera_model: omni, distortion_model: radtan}",
        "cam0: {camera_model: pinhole}",
        "cam0: {camera_model: pinhole, intrinsics: 3, resolution: [1, 2]}",
        "cam0: {camera_model: pinhole, intrinsics: [a, 1, 1, 1], resolution: [1, 2]}",
        "%YAML:1.0\n---\ncamera_matrix: 3\n",
        "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n  rows: 100000\n  cols: 100000\n  dt: d\n  data: [1.]\n",
        '<?xml version="1.0"?><opencv_storage><a>',
        '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "b">]><opencv_storage>&a;</opencv_storage>',
        '<?xml version="1.0"?><opencv_storage><camera_matrix>x</camera_matrix></opencv_storage>',
        "x: " + "y" * (1 << 20),
    ],
)
def test_hostile_files_are_refused(given_file, text):
    with pytest.raises(ConfigError):
        read_camera(given_file(text))


@pytest.mark.parametrize("name", ["c.yml", "c.xml"])
def test_damaged_opencv_files_never_crash(tmp_path, name):
    whole = opencv_file(tmp_path / name).read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), 3):
            damaged[at] = rng.integers(32, 127)
        (tmp_path / "damaged").write_bytes(bytes(damaged[: rng.integers(1, len(whole) + 1)]))
        try:
            read_camera(tmp_path / "damaged")
        except UwgraphError:
            refused += 1
    assert refused > 100


def test_missing_file(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_camera(tmp_path / "none.yaml")


def test_size_of_the_image():
    camera = Camera("pinhole", (500.0, 500.0), (320.0, 240.0), (640, 480))
    check_size(camera, np.zeros((480, 640)))
    check_size(camera, np.zeros((480, 640, 3)))
    with pytest.raises(DataError, match="480 x 640"):
        check_size(camera, np.zeros((640, 480)), "a.png")
    with pytest.raises(DataError, match=r"a\.png"):
        check_size(replace(camera, size=(320, 240)), np.zeros((480, 640)), "a.png")


ROS = """
image_width: 640
image_height: 480
camera_name: sky
camera_matrix: {rows: 3, cols: 3, data: [300.0, 0, 320.5, 0, 301.0, 240.5, 0, 0, 1]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.01, -0.002, 0.0, 0.0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
PLAIN = "model: fisheye\nfx: 300.0\nfy: 301.0\ncx: 320.5\ncy: 240.5\nwidth: 640\nheight: 480\nD: [0.01, -0.002, 0, 0]\n"
ROWS = (
    "model: fisheye\nsize: [640, 480]\nK: [[300.0, 0, 320.5], [0, 301.0, 240.5], [0, 0, 1]]\nD: [0.01, -0.002, 0, 0]\n"
)
SINGLE = """
camera_model: pinhole
distortion_model: equidistant
intrinsics: [300.0, 301.0, 320.5, 240.5]
distortion_coeffs: [0.01, -0.002, 0.0, 0.0]
resolution: [640, 480]
"""


NAMED = PLAIN.replace("D: [0.01, -0.002, 0, 0]", "k1: 0.01\nk2: -0.002")


@pytest.mark.parametrize("text", [ROS, PLAIN, ROWS, SINGLE, NAMED], ids=["ros", "plain", "rows", "single", "named"])
def test_other_spellings_of_one_camera(given_file, text):
    file = read_camera(given_file(text + "mosaic: sony\nanalyser: sheet\n"))
    camera = file.camera
    assert (camera.model, camera.f, camera.c, camera.size) == ("fisheye", (300.0, 301.0), (320.5, 240.5), (640, 480))
    assert camera.distortion == (0.01, -0.002, 0.0, 0.0)
    assert (file.mosaic, camera.analyser) == ("sony", "sheet")
