"""``calibrate noise`` and ``calibrate import`` from outside."""

import json
import re

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from uwgraph.camera.file import read_camera
from uwgraph.cli.calibrate import app
from uwgraph.dive.folder import write_dive
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import DvlRig, ImuRig, Rig
from uwgraph.dive.rigfile import read_rig, write_rig
from uwgraph.errors import ConfigError, DataError
from uwgraph.simulate.imu import ImuGrade, imu_errors
from uwgraph.simulate.noise import Noise
from uwgraph.types import Imu, Origin

TRUE = ImuRig(gyro_noise_density=2e-4, accel_noise_density=3e-3, gyro_bias_walk=1e-9, accel_bias_walk=1e-9)
BEFORE = Rig(imu=ImuRig(gyro_bias_sigma=0.01, gyro_bias_walk=3e-7), dvl=DvlRig(scale=1.01))
START_NS = 1_700_000_000_000_000_000


def run(*arguments):
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A dive whose first 200 seconds are still, and the next 100 are not."""
    dt = np.full(300 * 50, 0.02)
    errors = imu_errors(ImuGrade(rig=TRUE), dt, Noise.of(4, "imu"))
    t = np.cumsum(dt)
    roll = np.where(t > 200.0, 0.2 * np.sin(t), 0.0)
    imu = Imu(
        START_NS + np.round(t * 1e9).astype(np.int64),
        f_s=errors.accel + np.stack([0 * t, -9.81 * np.sin(roll), -9.81 * np.cos(roll)], axis=-1),
        w_s=errors.gyro + np.gradient(roll, t)[:, None] * [1.0, 0.0, 0.0],
    )
    path = tmp_path_factory.mktemp("dives") / "run1"
    write_dive(Dive(Origin(0.5, 0.6), BEFORE, imu=imu), path)
    return path


def test_noise_to_a_rig_file(dive, tmp_path):
    out, picture = tmp_path / "rig.yaml", tmp_path / "allan.png"
    done = run("noise", dive, "-o", out, "--plot", picture)
    rig = read_rig(out)
    assert rig.imu.gyro_noise_density == pytest.approx(TRUE.gyro_noise_density, rel=0.03)
    assert rig.imu.accel_noise_density == pytest.approx(TRUE.accel_noise_density, rel=0.03)
    # 200 s show no walk: left as it was, like everything that is not of noise
    assert rig.imu.gyro_bias_walk == BEFORE.imu.gyro_bias_walk
    assert rig.model_copy(update={"imu": BEFORE.imu}) == BEFORE
    assert "run1" in out.read_text().splitlines()[0]
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert re.search(r"still for (199|200|201) s from 0 s on", done.stdout)
    assert "left: not seen, below" in done.stdout


def test_noise_as_json(dive):
    said = json.loads(run("noise", dive, "--json").stdout)
    assert set(said["rig_imu"]) == {"gyro_noise_density", "accel_noise_density"}
    assert set(said["refused"]) == {"gyro_bias_walk", "accel_bias_walk"}
    assert said["refused"]["gyro_bias_walk"]["limit_95"] > TRUE.gyro_bias_walk
    axis = said["gyro"]["axes"]["z"]
    assert len(axis["tau_s"]) == len(axis["allan_deviation"])
    assert axis["tau_s"][0] == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize(
    ("between", "still"),
    [
        (("--from", "50"), (0, 150)),
        (("--from", "50", "--to", "120"), (0, 70)),
        (("--to", "2023-11-14T22:14:50Z"), (0, 90)),
    ],
)
def test_part_of_a_recording(dive, between, still):
    said = json.loads(run("noise", dive, "--json", *between).stdout)
    assert said["still_from_s"] == pytest.approx(still[0], abs=1.5)
    assert said["still_for_s"] == pytest.approx(still[1], abs=1.5)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--from", "210"), DataError, "still"),
        (("--from", "400"), DataError, "holds nothing"),
        (("--to", "-1"), DataError, "holds nothing"),
        (("--from", "nan"), ConfigError, "--from"),
        (("--from", "1e300"), ConfigError, "--from"),
        (("--to", "yesterday"), ConfigError, "--to"),
        (("--to", "2023-11-14T22:14:50"), ConfigError, "no time zone"),
    ],
)
def test_noise_refused(dive, tmp_path, arguments, error, message):
    with pytest.raises(error, match=message):
        run("noise", dive, "-o", tmp_path / "rig.yaml", *arguments)
    assert not list(tmp_path.iterdir())


def test_nothing_is_replaced_unasked(dive, tmp_path):
    out = tmp_path / "rig.yaml"
    out.write_text("mine")
    with pytest.raises(DataError, match="there is such a file"):
        run("noise", dive, "-o", out)
    assert out.read_text() == "mine"
    run("noise", dive, "-o", out, "--force")
    assert read_rig(out).dvl.scale == 1.01


def test_import_kalibr(tmp_path):
    imu = {"accelerometer_noise_density": 1.86e-3, "gyroscope_noise_density": 1.87e-4, "update_rate": 200.0}
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [460.0, 461.0, 360.0, 240.0],
        "distortion_model": "equidistant",
        "distortion_coeffs": [0.01, 0.0, 0.0, 0.0],
        "resolution": [720, 480],
        "T_cam_imu": np.eye(4).tolist(),
        "timeshift_cam_imu": 0.0125,
    }
    (tmp_path / "imu.yaml").write_text(yaml.safe_dump(imu))
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    write_rig(BEFORE, tmp_path / "before.yaml")
    files = (tmp_path / "chain.yaml", tmp_path / "imu.yaml")
    outs = ("-o", tmp_path / "rig.yaml", "--camera-out", tmp_path / "camera.yaml")

    with pytest.raises(ConfigError, match="--imu-axes"):
        run("import", *files, *outs)
    assert not (tmp_path / "rig.yaml").exists()

    done = run("import", *files, *outs, "--imu-axes", "flu", "--rig", tmp_path / "before.yaml")
    rig = read_rig(tmp_path / "rig.yaml")
    assert (rig.imu.gyro_noise_density, rig.imu.gyro_bias_walk) == (1.87e-4, BEFORE.imu.gyro_bias_walk)
    assert (rig.sun.time_offset_s, rig.dvl.scale) == (0.0125, 1.01)
    np.testing.assert_allclose(read_camera(tmp_path / "camera.yaml").camera.R_bs, np.diag([1, -1, -1]), atol=1e-12)
    assert "imu.gyro_noise_density" in done.stdout

    said = json.loads(run("import", files[1], "--json").stdout)
    assert said["changed"] == {"imu.gyro_noise_density": 1.87e-4, "imu.accel_noise_density": 1.86e-3}
    with pytest.raises(ConfigError, match="none of the files holds a camera"):
        run("import", files[1], "--camera-out", tmp_path / "other.yaml")
    with pytest.raises(DataError, match="there is such a file"):
        run("import", *files, *outs, "--imu-axes", "flu")
