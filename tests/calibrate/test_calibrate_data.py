"""A real DVL from a rig that knows nothing of it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from uwgraph.calibrate import ReferenceUse, calibrate_dives
from uwgraph.dive.importing import read_recording
from uwgraph.dive.rig import DvlRig
from uwgraph.graph import SmoothSettings

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data")) / "snapir"


@pytest.mark.data
@pytest.mark.slow
def test_the_sensors_alone_and_the_reference_agree() -> None:
    """IMU and DVL among themselves tell the same mounting, scale and clock as the reference's positions do."""
    if not DATA.is_dir():
        pytest.skip(f"no {DATA}: set UWGRAPH_DATA to the folder of the recordings")
    dives = [read_recording(DATA / f"Trajectory{n}").dive for n in (1, 4)]
    dives = [replace(d, rig=d.rig.model_copy(update={"dvl": DvlRig(sigma=0.02)})) for d in dives]
    alone = calibrate_dives(dives, "dvl", settings=SmoothSettings(initial="reference"))
    aided = calibrate_dives(dives, "dvl", reference=ReferenceUse())
    for found in (alone, aided):
        assert found.converged
        assert found.unseen == ()
        assert found.estimate("dvl.rotation_deg.yaw").after == pytest.approx(-0.26, abs=0.1)
        assert found.estimate("dvl.time_offset_s").after == pytest.approx(1.03, abs=0.03)
    for e in aided.estimates:
        assert abs(e.after - alone.estimate(e.name).after) < 3.0 * alone.estimate(e.name).sigma, e.name
