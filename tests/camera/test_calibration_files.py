"""Kalibr's, allan_variance_ros's, OpenVINS's and OpenCV's files: noise, mounting, clocks; hostile ones refused."""

import contextlib
import copy
import itertools

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.camera.calibration_files import AXES, read_calibrations
from uwgraph.camera.model import UP_FORWARD
from uwgraph.dive.kalibr import rotation_of
from uwgraph.dive.logs.axes import turn
from uwgraph.dive.rig import ImuRig, Rig, SunRig
from uwgraph.errors import ConfigError, UwgraphError

KALIBR_IMU = """\
#Accelerometers
accelerometer_noise_density: 1.86e-03   #Noise density (continuous-time)
accelerometer_random_walk:   4.33e-04   #Bias random walk

#Gyroscopes
gyroscope_noise_density:     1.87e-04
gyroscope_random_walk:       2.66e-05

rostopic:                    /imu0
update_rate:                 200.0
"""
ALLAN_VARIANCE_ROS = """\
#Accelerometer
accelerometer_noise_density: 0.0018605772 \n\
accelerometer_random_walk: np.float64(4.3334e-05) \n
#Gyroscope
gyroscope_noise_density: 1e-04 \n\
gyroscope_random_walk: 2.1e-06 \n
rostopic: '/sensors/imu' #Make sure this is correct
update_rate: 400.0 #Make sure this is correct
"""
IMU_UTILS = """\
%YAML:1.0
---
type: IMU
name: "16448"
Gyr:
   unit: " rad/s"
   avg-axis:
      gyr_n: 1.8582082627718251e-04
      gyr_w: 7.2451532648461174e-05
Acc:
   unit: " m/s^2"
   avg-axis:
      acc_n: 1.9862287242243099e-03
      acc_w: 1.2148497781522122e-03
"""
CAMERA = {
    "camera_model": "pinhole",
    "intrinsics": [461.629, 460.152, 362.680, 246.049],
    "distortion_model": "radtan",
    "distortion_coeffs": [-0.27695497, 0.06712482, 0.00087538, 0.00011556],
    "resolution": [752, 480],
    "rostopic": "/cam0/image_raw",
}


@pytest.fixture
def file(tmp_path):
    counter = itertools.count()

    def write(content, name=None):
        path = tmp_path / (name or f"file{next(counter)}.yaml")
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return path

    return write


def rigid(R, p=(0.01, -0.02, 0.03)):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T.tolist()


def imu_block(**more):
    return yaml.safe_load(KALIBR_IMU) | more


def test_kalibr_imu(file):
    imu = read_calibrations([file(KALIBR_IMU)]).rig(Rig()).imu
    assert imu == ImuRig(
        accel_noise_density=1.86e-3, accel_bias_walk=4.33e-4, gyro_noise_density=1.87e-4, gyro_bias_walk=2.66e-5
    )


def test_everything_else_of_the_rig_stays(file):
    base = Rig(imu=ImuRig(gyro_bias_sigma=0.1, rotation_deg=(1, 2, 3)), sun=SunRig(time_offset_s=0.5))
    rig = read_calibrations([file({"gyroscope_noise_density": 3e-4})]).rig(base)
    assert rig == base.model_copy(update={"imu": base.imu.model_copy(update={"gyro_noise_density": 3e-4})})


def test_allan_variance_ros(file):
    imu = read_calibrations([file(ALLAN_VARIANCE_ROS)]).rig(Rig()).imu
    assert (imu.accel_noise_density, imu.accel_bias_walk) == (0.0018605772, 4.3334e-05)
    assert (imu.gyro_noise_density, imu.gyro_bias_walk) == (1e-4, 2.1e-6)


def test_imu_utils_is_refused_with_the_reason(file):
    with pytest.raises(ConfigError, match="noise per sample"):
        read_calibrations([file(IMU_UTILS)])


def test_kalibr_results_with_several_imus(file):
    R = Rotation.from_euler("ZYX", [0.3, 0.2, -0.1]).as_matrix()
    first, second = imu_block(T_i_b=rigid(np.eye(3)), time_offset=0.0), imu_block(T_i_b=rigid(R), time_offset=0.0023)
    second["gyroscope_noise_density"] = 5e-4
    path = file({"imu0": first | {"model": "calibrated"}, "imu1": second})
    assert read_calibrations([path]).rig(Rig()).imu.gyro_noise_density == 1.87e-4
    other = read_calibrations([path], imu="imu1")
    assert (other.rig(Rig()).imu.gyro_noise_density, other.rig(Rig()).imu.time_offset_s) == (5e-4, 0.0023)
    np.testing.assert_allclose(other.imu.R_ib, R, atol=1e-12)
    with pytest.raises(ConfigError, match="no IMU 'imu7'"):
        read_calibrations([path], imu="imu7")


def test_openvins_files(file):
    R = Rotation.from_euler("ZYX", [1.0, 0.2, -0.1]).as_matrix()
    imu = file("%YAML:1.0 # file type\n\n" + yaml.safe_dump({"imu0": imu_block(T_i_b=rigid(np.eye(3)), Tw=[[1, 0]])}))
    chain = file("%YAML:1.0\n" + yaml.safe_dump({"cam0": CAMERA | {"T_imu_cam": rigid(R), "timeshift_cam_imu": 0.01}}))
    found = read_calibrations([imu, chain])
    assert found.rig(Rig()).imu.gyro_noise_density == 1.87e-4
    assert found.rig(Rig()).sun.time_offset_s == 0.01
    np.testing.assert_allclose(found.mounted_camera("frd").camera.R_bs, R, atol=1e-12)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(AXES), st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.sampled_from([0.0, 1e-5]))
def test_mounting_of_a_camera_on_an_imu(file, axes, angles, rounding):
    """A direction goes the same way through the chain of frames as through R_bs."""
    R_bi0 = turn(axes)
    R_bs = Rotation.from_euler("ZYX", angles).as_matrix()
    R_cam_imu = R_bs.T @ R_bi0
    T = np.round(rigid(R_cam_imu), 5).tolist() if rounding else rigid(R_cam_imu)
    chain = file({"cam0": CAMERA | {"T_cam_imu": T, "timeshift_cam_imu": -8.121e-05}}, "chain.yaml")
    found = read_calibrations([chain])
    R = found.mounted_camera(axes).camera.R_bs
    np.testing.assert_allclose(R, R_bs, atol=3 * rounding + 1e-9)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert found.rig(Rig()).sun.time_offset_s == -8.121e-05
    # the same camera against a second IMU, whose axes are told as seen in the vehicle
    imus = file({"imu0": imu_block(), "imu1": imu_block(T_i_b=rigid(turn("flu").T @ R_bi0))}, "imus.yaml")
    second = read_calibrations([chain, imus], imu="imu1").mounted_camera("flu").camera.R_bs
    np.testing.assert_allclose(second, R_bs, atol=3 * rounding + 1e-9)


def test_lever_arm_of_a_camera_on_an_imu(file):
    """A point seen by the camera is where the chain of frames puts it, from the IMU that is the body's origin."""
    rng = np.random.default_rng(1)
    T_ci, T_21 = (np.array(rigid(Rotation.random(rng=rng).as_matrix())) for _ in range(2))
    T_ci[:3, 3], T_21[:3, 3] = rng.normal(size=(2, 3))
    chain = file({"cam0": CAMERA | {"T_cam_imu": T_ci.tolist()}}, "chain.yaml")
    imus = file({"imu0": imu_block(), "imu1": imu_block(T_i_b=T_21.tolist())}, "imus.yaml")
    camera = read_calibrations([chain, imus], imu="imu1").mounted_camera("flu").camera
    x_1 = np.array([0.3, -2.0, 1.0, 1.0])
    expected = turn("flu") @ (T_21 @ x_1)[:3]
    np.testing.assert_allclose(camera.R_bs @ (T_ci @ x_1)[:3] + camera.l_b, expected, atol=1e-9)


def test_axes():
    assert len(set(AXES)) == 24
    assert {"frd", "flu", "rfd", "urf"} & set(AXES) == {"frd", "flu", "urf"}
    for axes in AXES:
        np.testing.assert_allclose(turn(axes) @ turn(axes).T, np.eye(3))
        assert np.linalg.det(turn(axes)) == pytest.approx(1.0)


@pytest.mark.parametrize("axes", [None, "frr", "fru", "FRD", "", "frdd", "xyz"])
def test_a_mounting_without_axes_is_refused(file, axes):
    found = read_calibrations([file({"cam0": CAMERA | {"T_cam_imu": rigid(np.eye(3))}})])
    with pytest.raises(ConfigError, match="--imu-axes"):
        found.mounted_camera(axes)


def test_a_camera_without_mounting_keeps_its_own(file):
    assert np.array_equal(read_calibrations([file({"cam0": CAMERA})]).mounted_camera(None).camera.R_bs, UP_FORWARD)
    assert read_calibrations([file(KALIBR_IMU)]).mounted_camera(None) is None


def test_camera_of_a_pair(file):
    right = copy.deepcopy(CAMERA) | {
        "intrinsics": [400.0, 401.0, 320.0, 240.0],
        "T_cam_imu": rigid(np.eye(3), (1, 2, 3)),
    }
    path = file({"cam0": CAMERA, "cam1": right | {"timeshift_cam_imu": 0.25}})
    found = read_calibrations([path], camera="cam1")
    assert found.camera.camera.f == (400.0, 401.0)
    assert found.rig(Rig()).sun.time_offset_s == 0.25
    assert read_calibrations([path]).on_imu is None
    with pytest.raises(ConfigError, match="no camera 'cam5'"):
        read_calibrations([path], camera="cam5")


@pytest.mark.parametrize("suffix", ["yaml", "xml"])
def test_opencv_beside_an_imu(file, tmp_path, suffix):
    path = tmp_path / f"cv.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[500.5, 0.0, 320.25], [0.0, 501.5, 240.75], [0.0, 0.0, 1.0]]))
    storage.write("distortion_coefficients", np.array([[-0.21, 0.05, 1e-3, -2e-3, 0.01]]))
    storage.release()
    found = read_calibrations([file(KALIBR_IMU), path])
    assert found.camera.camera.f == (500.5, 501.5)
    assert found.rig(Rig()).imu.gyro_noise_density == 1.87e-4


# -- what cannot be used


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gyroscope_noise_density": 0.0}, "gyroscope_noise_density: input should be greater than 0"),
        ({"gyroscope_noise_density": -1e-4}, "gyroscope_noise_density"),
        ({"gyroscope_noise_density": float("nan")}, "gyroscope_noise_density"),
        ({"accelerometer_random_walk": float("inf")}, "accelerometer_random_walk"),
        ({"accelerometer_random_walk": [1, 2]}, "accelerometer_random_walk"),
        ({"accelerometer_random_walk": "np.float64(__import__('os'))"}, "accelerometer_random_walk"),
        ({"time_offset": 1e9}, "time_offset"),
        ({"T_i_b": [[1, 0, 0, 0]]}, "T_i_b"),
        ({"T_i_b": rigid(2 * np.eye(3))}, "holds no rotation"),
        ({"T_i_b": rigid(np.diag([1, 1, -1]))}, "mirror image"),
        ({"T_i_b": (np.eye(4) + 0.5).tolist()}, "last row"),
    ],
)
def test_unusable_imus_are_named(file, change, message):
    path = file({"imu0": imu_block(**change)})
    with pytest.raises(ConfigError, match=message) as caught:
        read_calibrations([path])
    assert str(path) in str(caught.value)
    assert "imu0" in str(caught.value)


def test_unusable_mountings_are_named(file):
    for T in (rigid(np.ones((3, 3))), [[1]], "no", rigid(np.full((3, 3), np.nan)), np.eye(3).tolist()):
        with pytest.raises(ConfigError, match=r"cam0: T_cam_imu"):
            read_calibrations([file({"cam0": CAMERA | {"T_cam_imu": T}})])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "just text",
        "- 1\n- 2\n",
        "imu0: 5\n",
        "imu0: {}\n",
        "{}",
        "target_type: aprilgrid\n",
        "imu0: !!python/object/apply:os.system ['true']\n",
        "a: &a [x, x]\nb: &b [*a, *a]\nimu0: *b\n",
        "imu0:\n" + "  " + "[" * 5000,
        "imu0: {accelerometer_noise_density: 1, accelerometer_noise_density: 2}\n",
        "%YAML:1.0\n%YAML:1.0\nimu0: 1\n",
        "cam0: {camera_model: pinhole}\n",
        "5: {camera_model: pinhole}\nx: {camera_model: omni}\n",
        "<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage>&b;</opencv_storage>",
        "\x00\x01",
        "#" * (2 << 20),
    ],
)
def test_hostile_files_are_refused(file, text):
    with pytest.raises(ConfigError):
        read_calibrations([file(text)])


def test_two_files_with_the_same(file):
    with pytest.raises(ConfigError, match="holds 'imu0', as another file does"):
        read_calibrations([file(KALIBR_IMU), file(KALIBR_IMU)])
    with pytest.raises(ConfigError, match="holds a camera, as another file does"):
        read_calibrations([file({"cam0": CAMERA}), file({"cam0": CAMERA})])


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_give_a_calibration_or_an_error_in_words(tmp_path, data):
    full = yaml.safe_dump(
        {"imu0": imu_block(T_i_b=rigid(np.eye(3)))} | {"cam0": CAMERA | {"T_cam_imu": rigid(np.eye(3))}}
    )
    source = bytearray(data.draw(st.sampled_from([KALIBR_IMU, ALLAN_VARIANCE_ROS, IMU_UTILS, full])).encode())
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(source) - 1))
        piece = data.draw(
            st.one_of(st.binary(max_size=4), st.sampled_from([b"&a", b"*a", b"!!python/x ", b"{", b": ", b"1e999"]))
        )
        source[at : at + data.draw(st.integers(0, 6))] = piece
        source = source or bytearray(b" ")
    path = tmp_path / "mutated.yaml"
    path.write_bytes(bytes(source))
    with contextlib.suppress(UwgraphError):
        found = read_calibrations([path])
        found.rig(Rig())
        found.mounted_camera("frd")


def test_rotation_of_is_exact_for_rounded_files():
    R = Rotation.from_euler("ZYX", [0.3, 0.2, -0.1]).as_matrix()
    found = rotation_of(np.round(rigid(R), 4).tolist())
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(found, R, atol=1e-4)
