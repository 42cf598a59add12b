"""Simulated dives, their true tracks, and graphs built from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.dive import Dive
from uwgraph.frames import matrix_from_rph
from uwgraph.graph import SmoothSettings
from uwgraph.graph.builder import Problem, build
from uwgraph.graph.initial import initial_state
from uwgraph.graph.keyframes import schedule
from uwgraph.graph.prepare import BodyDvl, BodyImu, Prepared, prepare
from uwgraph.graph.rest import Rest
from uwgraph.graph.track import Track
from uwgraph.simulate import SimulationSettings, simulate, trajectory_of
from uwgraph.simulate.trajectory import Trajectory
from uwgraph.time import from_seconds
from uwgraph.types import FloatArray, Origin, TimeArray

START_NS = 1_725_966_000_000_000_000
ORIGIN = Origin(lat=0.75, lon=0.13)
SHORT = SimulationSettings(duration_s=60.0, leg_length_m=20.0, line_spacing_m=20.0, surface_time_s=5.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """A simulated dive and the motion behind it."""

    dive: Dive
    motion: Trajectory

    @classmethod
    def of(cls, settings: SimulationSettings, seed: int = 0) -> Truth:
        return cls(simulate(settings, seed), trajectory_of(settings, seed))

    def seconds(self, t_ns: TimeArray) -> FloatArray:
        return np.asarray((t_ns - self.motion.start_ns) * 1e-9)

    def R_nb(self, t_ns: TimeArray) -> FloatArray:
        return self.motion.attitude(self.seconds(t_ns))

    def p_n(self, t_ns: TimeArray) -> FloatArray:
        return self.motion.position(self.seconds(t_ns))

    def v_n(self, t_ns: TimeArray) -> FloatArray:
        return self.motion.velocity(self.seconds(t_ns))

    def track(self, prepared: Prepared, step_s: float = 0.1) -> Track:
        """The truth on a grid, as the graph's modules take it."""
        t = np.arange(int(self.motion.duration_s / step_s) + 1) * step_s
        t_ns = from_seconds(t, self.motion.start_ns)
        return Track(prepared, t_ns, self.R_nb(t_ns), self.p_n(t_ns), self.v_n(t_ns))

    def problem(self, settings: SmoothSettings, yaw: float = 0.0) -> Problem:
        """The graph, with the truth turned by ``yaw`` [rad] about the vertical as the first guess."""
        prepared = prepare(self.dive)
        initial = initial_state(prepared, settings)
        keyframes = schedule(prepared, settings, initial.t_ns, int(prepared.imu.t_ns[-1]))
        true = self.track(prepared)
        R = matrix_from_rph([0.0, 0.0, yaw])
        track = Track(prepared, true.t_ns, R @ true.R_nb, true.p_n @ R.T, true.v_n @ R.T)
        return build(prepared, settings, initial, keyframes, track)


def hand_made(imu: BodyImu, dvl: BodyDvl | None = None) -> Prepared:
    """A prepared dive of an IMU and perhaps a DVL, and nothing else."""
    rest = Rest(np.zeros(3), 1e-5)
    return Prepared(Dive(ORIGIN), imu, rest, dvl, depth=None, fixes=None, heading=None, sun=None, reference=None)


def turned(R: FloatArray, S: FloatArray) -> FloatArray:
    """Angle between rotations, shape (N,), rad."""
    return np.linalg.norm(R - S, axis=(-2, -1)) / np.sqrt(2.0)
