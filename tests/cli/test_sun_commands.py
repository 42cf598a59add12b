"""``uwgraph sun`` from outside, on rendered images: right headings, and nothing confident from bad input."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import commandline
import cv2
import numpy as np
import pytest
from commandline import Done
from typer.testing import CliRunner

from uwgraph.camera.file import CameraFile, write_camera
from uwgraph.cli import sun
from uwgraph.dive.folder import read_dive
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate import SKY_CAMERA, ImageModel, Scene, Shot, render
from uwgraph.simulate.exposure import auto_scale, behind_polarizer, expose, mosaic
from uwgraph.sun.ephemeris import sun_azimuth_elevation

LAT_DEG, LON_DEG, UTC, T_NS = 32.8, 34.9, "2022-06-08T06:30:00Z", 1_654_669_800_000_000_000
ROLL_DEG, PITCH_DEG, HEADING_DEG = -3.0, 4.0, 215.0
WHERE = ("--utc", UTC, "--lat", LAT_DEG, "--lon", LON_DEG)
TILT = ("--roll-deg", ROLL_DEG, "--pitch-deg", PITCH_DEG)
SENSOR = ImageModel().sensor


def run(*arguments: object) -> Done:
    return commandline.run("sun", *arguments)


def estimated(*arguments: object) -> dict[str, object]:
    """``sun estimate`` in this process: starting one takes longer than the estimate."""
    done = CliRunner().invoke(sun.app, ["estimate", *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.exception
    result: dict[str, object] = json.loads(done.stdout)
    return result


@dataclass(frozen=True)
class Pictures:
    """Rendered images of one moment, in air and under water."""

    folder: Path
    sony: Path
    channels: Sequence[Path]
    light: Path
    camera: Path


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Pictures:
    folder = tmp_path_factory.mktemp("sky")
    (azimuth,), (elevation,) = sun_azimuth_elevation(T_NS, *np.radians([LAT_DEG, LON_DEG]))
    level = np.cos(elevation)
    s_l = np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])
    R_lb = matrix_from_rph(np.radians([ROLL_DEG, PITCH_DEG, HEADING_DEG]))
    rng = np.random.default_rng(5)

    def write(name: str, radiance: np.ndarray) -> Path:
        counts = expose(radiance, SENSOR, auto_scale(radiance, SENSOR.white), 12, rng)
        cv2.imwrite(str(folder / name), counts)
        return folder / name

    water = render(Scene(wind=1.0), Shot(SKY_CAMERA, R_lb, s_l, depth=2.0), seed=3)
    air = render(Scene(), Shot(SKY_CAMERA, R_lb, s_l), seed=3)
    scale = auto_scale(air[..., 0], SENSOR.white)
    channels = []
    for angle in (0, 45, 90, 135):
        counts = expose(behind_polarizer(air, np.radians(angle)), SENSOR, scale, 12, rng)
        channels.append(folder / f"air_{angle}.png")
        cv2.imwrite(str(channels[-1]), counts)
    camera = folder / "camera.yaml"
    write_camera(camera, CameraFile(SKY_CAMERA, SENSOR))
    return Pictures(folder, write("sony.png", mosaic(water)), channels, write("light.png", water[..., 0]), camera)


def off_by(found: dict[str, object]) -> float:
    assert found["flags"] == []
    heading = found["heading_deg"]
    assert isinstance(heading, float)
    return abs((heading - HEADING_DEG + 180.0) % 360.0 - 180.0)


def test_mosaic_under_water(pictures: Pictures) -> None:
    arguments = (pictures.sony, "--mosaic", "sony", "--camera", pictures.camera, *WHERE, *TILT)
    found = estimated(*arguments)
    assert json.loads(run("estimate", *arguments, "--json").stdout) == found
    assert found["method"] == "polarization"
    assert off_by(found) < 0.5
    information = np.array(found["information"])
    assert np.linalg.matrix_rank(information, tol=1e-6 * np.trace(information)) == 2
    assert np.abs(information @ np.array(found["sun_b"])).max() < 1e-6 * np.trace(information)


def test_channels_in_air_in_any_order(pictures: Pictures) -> None:
    order = [2, 0, 3, 1]
    files = [pictures.channels[k] for k in order]
    angles = ",".join(str(45 * k) for k in order)
    common = ("--camera", pictures.camera, "--medium", "air", *WHERE, *TILT)
    assert off_by(estimated(*files, "--polarizer-deg", angles, *common)) < 0.2
    wrong = estimated(*files, "--polarizer-deg", "0,45,90,135", *common)
    assert wrong["flags"]
    assert wrong["heading_deg"] is None


def test_light_gradient_under_water(pictures: Pictures) -> None:
    found = estimated(pictures.light, "--camera", pictures.camera, *WHERE, *TILT)
    assert found["method"] == "gradient"
    assert off_by(found) < 2.0


def test_a_tilt_that_is_not_known_well_widens_the_heading(pictures: Pictures) -> None:
    common = (pictures.light, "--camera", pictures.camera, *WHERE, *TILT)
    sure, unsure = (estimated(*common, "--tilt-sigma-deg", s)["heading_sigma_deg"] for s in (0.0, 1.0))
    assert unsure > sure + 0.5


@pytest.mark.parametrize("what", ["black", "white", "flat", "noise"])
def test_images_of_nothing_are_flagged(pictures: Pictures, what: str) -> None:
    shape = SKY_CAMERA.size[::-1]
    rng = np.random.default_rng(0)
    images = {
        "black": np.zeros(shape, dtype=np.uint16),
        "white": np.full(shape, 4095, dtype=np.uint16),
        "flat": rng.poisson(2000.0, shape).astype(np.uint16),
        "noise": rng.integers(0, 4096, shape, dtype=np.uint16),
    }
    file = pictures.folder / f"{what}.png"
    cv2.imwrite(str(file), images[what])
    for method in (("--mosaic", "sony"), ("--method", "gradient")):
        found = estimated(file, *method, "--camera", pictures.camera, *WHERE)
        assert found["flags"], method
        assert found["heading_deg"] is None


def test_wrong_circumstances_are_flagged(pictures: Pictures) -> None:
    common = (pictures.sony, "--mosaic", "sony", "--camera", pictures.camera, *TILT)
    night = estimated(*common, "--utc", "2022-06-08T22:00:00Z", "--lat", LAT_DEG, "--lon", LON_DEG)
    assert "night" in night["flags"]
    assert estimated(*common, "--utc", "2022-06-08T10:00:00Z", "--lat", LAT_DEG, "--lon", LON_DEG)["flags"]
    text = pictures.camera.read_text()
    long = pictures.folder / "long.yaml"
    long.write_text(text.replace("165.0", "330.0"))
    assert estimated(pictures.sony, "--mosaic", "sony", "--camera", long, *TILT, *WHERE)["flags"]
    down = pictures.folder / "down.yaml"
    down.write_text(text.replace("mount: up-forward", "R_bs: [0, -1, 0, 1, 0, 0, 0, 0, 1]"))
    assert "small_window" in estimated(pictures.sony, "--mosaic", "sony", "--camera", down, *TILT, *WHERE)["flags"]


def test_what_cannot_be_read_is_told(pictures: Pictures) -> None:
    small = pictures.folder / "small.png"
    cv2.imwrite(str(small), np.zeros((10, 10), dtype=np.uint8))
    cut = pictures.folder / "cut.png"
    cut.write_bytes(pictures.light.read_bytes()[:5000])
    text = pictures.folder / "text.png"
    text.write_text("no image")
    camera = ("--camera", pictures.camera)
    for arguments, code, word in [
        ((small, *camera), 3, "10 x 10"),
        ((cut, *camera), 3, "cut.png"),
        ((text, *camera), 3, "text.png"),
        ((pictures.folder / "none.png", *camera), 3, "none.png"),
        ((pictures.light, "--camera", pictures.folder / "none.yaml"), 2, "none.yaml"),
        ((pictures.light, *camera, "--utc", "2022-06-08T06:30:00", "--lat", 1, "--lon", 2), 2, "time zone"),
        ((pictures.light, *camera, "--utc", UTC), 2, "--lat"),
        ((pictures.light, *camera, "--polarizer-deg", "0,nan,90"), 2, "--polarizer-deg"),
    ]:
        done = run("estimate", *arguments, "--json")
        assert done.returncode == code, done.stderr
        assert word in done.stderr
        assert done.stdout == ""
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("arguments", [("--mosaic", "sony"), ("--method", "gradient")])
def test_show_draws(pictures: Pictures, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    file = pictures.sony if "sony" in arguments else pictures.light
    done = run("show", file, *arguments, "--camera", pictures.camera, "-o", tmp_path / "sun.png", *WHERE, *TILT)
    assert done.returncode == 0, done.stderr
    assert min(cv2.imread(str(tmp_path / "sun.png")).shape[:2]) > 300


@pytest.mark.slow
def test_process_makes_a_sun_stream(tmp_path: Path) -> None:
    dive = tmp_path / "dive"
    made = commandline.run(
        *("simulate", dive, "--images", "polarization", "--image-rate", "0.05"),
        *("--image-depth", "5", "--duration", "120", "--no-sun"),
    )
    assert made.returncode == 0, made.stderr
    damaged = sorted((dive / "images" / "sky").glob("*.png"))[2]
    damaged.write_bytes(b"no image")
    done = run("process", dive, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["images"] == 7
    assert result["refused"]["unreadable"] == 1
    stream = read_dive(dive).sun
    assert stream is not None
    assert 4 <= np.count_nonzero(stream.flags == 0) == result["used"]
    again = run("process", dive)
    assert again.returncode == 2
    assert "--force" in again.stderr


def test_locate_from_a_day_of_suns(tmp_path: Path) -> None:
    t = T_NS + np.arange(10) * 3600 * 10**9
    azimuth, elevation = map(np.degrees, sun_azimuth_elevation(t, *np.radians([LAT_DEG, LON_DEG])))
    up = elevation > 5.0
    stamps = np.datetime_as_string(t.astype("datetime64[ns]"), unit="s")
    rows = [f"{s}Z,{a},{e},0.2" for s, a, e in zip(stamps[up], azimuth[up] + 10.0, elevation[up], strict=True)]
    table = tmp_path / "day.csv"
    table.write_text("\n".join(["utc,azimuth_deg,elevation_deg,sigma_deg", *rows]))
    done = run("locate", table, "--offset-sigma-deg", "inf", "--json")
    assert done.returncode == 0, done.stderr
    place = json.loads(done.stdout)
    assert abs(place["lat_deg"] - LAT_DEG) < 0.05
    assert abs(place["lon_deg"] - LON_DEG) < 0.05
    assert abs(place["heading_offset_deg"] + 10.0) < 0.05
    assert run("locate", tmp_path / "none.csv").returncode == 3
