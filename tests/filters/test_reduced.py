"""The kinematic filter against the full inertial one on the same dives."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from uwgraph.dive.importing import read_recording
from uwgraph.errors import DataError
from uwgraph.filters.estimate import Task, filter_dive, ins_of, solution_of, task_of
from uwgraph.filters.kalman import Unscented
from uwgraph.filters.monitor import Policy
from uwgraph.filters.reduced import reduced
from uwgraph.filters.settings import FilterSettings
from uwgraph.filters.slam import Slam, SlamSettings
from uwgraph.frames import rph_from_matrix, wrap_pi
from uwgraph.graph.settings import SmoothSettings
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.simulate.degrade import add_sun_heading
from uwgraph.types import FloatArray

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
MISSION = SimulationSettings(duration_s=180.0, leg_length_m=40.0, line_spacing_m=20.0, surface_time_s=10.0)


@dataclass(frozen=True, eq=False)
class Difference:
    """Reduced minus full, north, east, down [m] and heading [rad], at the pings: shape (K, 4) each."""

    off: FloatArray
    joint: FloatArray
    """1-sigma of both together, as if they were independent."""


def compared(task: Task) -> Difference:
    small = reduced(task.prepared, task.initial)
    kinematic = Slam(small.first, SlamSettings(inputs=small.noise, learns="nothing")).run(small.inputs, small.measured)
    settings = FilterSettings(samples_per_step=5)
    task = replace(task, t_ns=kinematic.t_ns)
    filtered = filter_dive(task, Unscented(ins_of(task.prepared, settings)), Policy(settings.gate), settings)
    full = solution_of(task.prepared, filtered.beliefs)
    heading = rph_from_matrix(full.R_nb)[:, 2]
    cov_theta, cov_p = (
        full.R_nb @ full.cov_pose[:, at, at] @ np.swapaxes(full.R_nb, 1, 2) for at in (slice(0, 3), slice(3, 6))
    )
    variance = np.column_stack([np.diagonal(cov_p, axis1=1, axis2=2), cov_theta[:, 2, 2]])
    off = np.column_stack([kinematic.y[:, :3] - full.p_n, wrap_pi(kinematic.y[:, 3] - heading)])
    return Difference(off, np.sqrt(variance + np.diagonal(kinematic.cov, axis1=1, axis2=2)))


def test_agrees_with_the_inertial_filter_on_a_simulated_dive():
    """With a sun; 1-sigma joint, though both use the same log and gyro and should be closer still."""
    d = compared(task_of(simulate(MISSION, 0)))
    normalised = d.off / d.joint
    # what the accelerometer sees of heave between pings, the reduced model cannot: depth by its own sensor alone
    assert np.all(np.sqrt(np.mean(normalised**2, axis=0)) < [1.0, 1.0, 1.5, 1.0])
    assert np.abs(normalised[:, [0, 1, 3]]).max() < 2.5
    assert np.degrees(np.abs(d.off[-1, 3])) < 1.0


@pytest.mark.data
def test_agrees_with_the_inertial_filter_on_a_real_run():
    """Snapir; the headings by the sun are simulated."""
    run = DATA / "snapir" / "Trajectory1"
    if not run.exists():
        pytest.skip(f"no {run}: set UWGRAPH_DATA to the folder of the recordings")
    dive = add_sun_heading(read_recording(run).dive)
    d = compared(task_of(dive, SmoothSettings(initial="reference")))
    assert np.abs(d.off / d.joint).max() < 1.5
    assert np.linalg.norm(d.off[-1, :2]) < 1.0
    assert np.degrees(np.abs(d.off[:, 3])).max() < 0.02


def test_without_a_doppler_log_there_is_nothing_to_drive_it():
    task = task_of(simulate(MISSION.model_copy(update={"dvl": None, "duration_s": 60.0}), 0))
    with pytest.raises(DataError, match="velocity"):
        reduced(task.prepared, task.initial)
