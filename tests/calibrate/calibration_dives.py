"""Short simulated dives with acoustic fixes, whose DVL is not what the rig says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.rig import DvlRig, FixesRig
from uwgraph.frames import geodetic_from_ned
from uwgraph.simulate import DvlModel, HeadingModel, SimulationSettings, simulate, trajectory_of
from uwgraph.time import from_seconds
from uwgraph.types import Fixes

LEVER = (0.4, 0.1, 0.15)
TRUE_DVL = DvlRig(
    translation_m=LEVER,
    rotation_deg=(0.6, -0.4, 1.2),
    scale=1.012,
    time_offset_s=0.15,
    scale_sigma=0.0,
    misalignment_sigma_deg=0.0,
    sigma=0.004,
)
TURNING = SimulationSettings(
    duration_s=300.0,
    leg_length_m=40.0,
    line_spacing_m=30.0,
    surface_time_s=10.0,
    current=(0.35, -0.3),
    waves=1.5,
    imu_rate_hz=50.0,
    truth_rate_hz=2.0,
    grade="fog",
    dvl=DvlModel(rig=TRUE_DVL),
    compass=HeadingModel(),
)
STRAIGHT = TURNING.model_copy(
    update={"pattern": "transit", "duration_s": 360.0, "waves": 0.0, "depth": 5.0, "grade": "mems"}
)


def dive_of(settings: SimulationSettings, seed: int, fix_sigma: float = 0.3, fix_period_s: float = 5.0) -> Dive:
    """A simulated dive with fixes of the body origin all the way, and its true rig."""
    dive, motion = simulate(settings, seed), trajectory_of(settings, seed)
    t = np.arange(0.0, motion.duration_s, fix_period_s)
    noise = fix_sigma * np.random.default_rng(seed).standard_normal((len(t), 3))
    lat, lon, height = geodetic_from_ned(motion.origin, motion.position(t) + noise)
    cov = np.tile(fix_sigma**2 * np.eye(3), (len(t), 1, 1))
    fixes = Fixes(from_seconds(t, motion.start_ns), lat, lon, height, cov, np.full(len(t), "usbl"))
    return replace(dive, fixes=fixes, rig=dive.rig.model_copy(update={"fixes": FixesRig(sigma=fix_sigma)}))


def bare(dive: Dive) -> Dive:
    """The dive with nothing known of its DVL."""
    return replace(dive, rig=dive.rig.model_copy(update={"dvl": DvlRig(sigma=TRUE_DVL.sigma)}))


def cut(dive: Dive, start_s: float, end_s: float) -> Dive:
    """The dive between two times from its start."""
    assert dive.imu is not None
    t0 = dive.imu.t_ns[0]
    parts = {
        name: stream.select((stream.t_ns >= t0 + start_s * 1e9) & (stream.t_ns < t0 + end_s * 1e9))
        for name, stream in dive.streams()
    }
    return replace(dive, **parts)  # type: ignore[arg-type]
