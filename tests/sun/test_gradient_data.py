"""The gradient of the light on real fisheye images of a clear sky."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uwgraph.camera.sensor import Sensor

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("UWGRAPH_DATA", ROOT.parent / "shared" / "data")) / "sky_images"
sys.path.insert(0, str(ROOT / "benchmarks"))

from sky_images import calibrate, judge, srgb_to_linear  # noqa: E402


@pytest.mark.data
@pytest.mark.slow
def test_the_sun_marked_by_hand_is_found() -> None:
    if not DATA.is_dir():
        pytest.skip(f"no {DATA}: set UWGRAPH_DATA to the folder of the recordings")
    marks = pd.read_csv(DATA / "sun_annotations.csv")
    camera = calibrate(marks, (1640, 1232), None, None)
    light = srgb_to_linear()
    sensor = Sensor(white=float(light[250]), gain=40.0)
    rows = pd.DataFrame([judge(DATA / f"{m.image}.jpg", m, camera, light, sensor) for _, m in marks.iterrows()])
    high = rows[rows["altitude"] > 10.0]
    assert high["used_azimuth"].abs().median() < 3.0
    assert high["used_angle"].median() < 6.0
    assert high["used_angle"].max() < 15.0
    assert (high["masked"] > 0.02).all()  # the disc and what it overexposes
    assert (high["flags"] == "").mean() > 0.75
    night = rows[rows["altitude"] < 0.0]
    assert (night["flags"] != "").all()
    assert np.isfinite(high["sigma_azimuth"]).all()
