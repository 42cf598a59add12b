"""From a mission to a trajectory: rest at the surface, cruise, dive, work, and perhaps come up again.

A mission is a few rates over time (turn rate, vertical rate, speed), each a train of smooth bumps. Their exact
integrals give course and depth; course, speed and current give the horizontal path, which is laid on the ellipsoid;
depth is then measured along the local vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.interpolate import make_interp_spline

from uwgraph.dive.rig import Finite, NonNegative, Positive, Settings
from uwgraph.errors import ConfigError
from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph, ned_from_geodetic, rph_from_matrix
from uwgraph.simulate.trajectory import DEGREE, Trajectory
from uwgraph.types import FloatArray, Origin

KNOT_S: Final = 0.25
_PAD_S: Final = 5.0
_ACCELERATION_S: Final = 15.0
_TURN_BLEND_S: Final = 5.0
_DIVE_BLEND_S: Final = 10.0
_DIVE_SLOPE: Final = np.tan(np.radians(12.0))
_SURFACED_S: Final = 30.0
_WAVE_DEPTH_M: Final = 5.0
_ROLL_PER_TURN_RATE_S: Final = 0.5


class Mission(Settings):
    """What the vehicle is told to do.

    A lawn mower flies parallel legs, a patrol the same rectangle (legs by spacing) again and again.
    """

    pattern: Literal["lawnmower", "patrol", "helix", "transit"] = "lawnmower"
    duration_s: Positive = 1200.0
    speed: Positive = 1.5
    """m/s through the water."""
    depth: NonNegative = 20.0
    """m, working depth of the body origin along the local vertical."""
    heading_deg: Finite = 30.0
    """Course over the ground of the first leg, against the north of n."""
    leg_length_m: Positive = 150.0
    line_spacing_m: Positive = 50.0
    helix_radius_m: Positive = 30.0
    turn_rate_deg_s: Positive = 6.0
    current: tuple[Finite, Finite] = (0.1, -0.15)
    """North and east velocity of the water, m/s."""
    surface_time_s: NonNegative = 30.0
    """Time drifting at the surface before the start."""
    surface_depth: NonNegative = 0.3
    """m, depth of the body origin when surfaced."""
    surface_at_end: bool = False
    waves: NonNegative = 1.0
    """Scale of the wobble of roll, pitch, heading and heave; 0 is dead calm."""


@dataclass(frozen=True)
class _Turns:
    start_s: list[float]
    angle: list[float]


def smoothstep(x: FloatArray) -> FloatArray:
    """From 0 at x <= 0 to 1 at x >= 1 with four continuous derivatives; its integral over [0, 1] is 1/2."""
    x = np.clip(x, 0.0, 1.0)
    y: FloatArray = x**5 * (126.0 + x * (-420.0 + x * (540.0 + x * (-315.0 + x * 70.0))))
    return y


def _bump(t: FloatArray, start: float, end: float, blend: float) -> FloatArray:
    """1 between start and end, blended smoothly after both: its integral is exactly end - start."""
    return smoothstep((t - start) / blend) - smoothstep((t - end) / blend)


def _integral(t: FloatArray, rate: FloatArray) -> FloatArray:
    """The exact integral, zero at t = 0, of the spline through ``rate``, at ``t``."""
    integral = make_interp_spline(t, rate, k=DEGREE).antiderivative()
    return np.asarray(integral(t) - integral(0.0))


def plan(mission: Mission, origin: Origin, start_ns: int, rng: np.random.Generator) -> Trajectory:
    """The trajectory of a mission from the origin; ``rng`` draws the phases of the wobble.

    Raises
    ------
    ConfigError
        When the current is too strong to hold a course, or the time too short to come up again.
    """
    _refuse_impossible(mission)
    t = np.arange(-_PAD_S, mission.duration_s + _PAD_S + KNOT_S, KNOT_S)
    turn_rate = _turn_rate(mission, t)
    sink_rate = _sink_rate(mission, t)
    speed = mission.speed * smoothstep((t - mission.surface_time_s) / _ACCELERATION_S)
    depth = mission.surface_depth + _integral(t, sink_rate)
    heading = _crab(mission, np.radians(mission.heading_deg) + _integral(t, turn_rate))
    roll_w, pitch_w, heading_w, heave = _wobble(mission, t, depth, rng)

    v_north = speed * np.cos(heading) + mission.current[0]
    v_east = speed * np.sin(heading) + mission.current[1]
    plane = np.stack([_integral(t, v_north), _integral(t, v_east), np.zeros_like(t)], axis=-1)
    lat, lon, _ = geodetic_from_ned(origin, plane)
    p_n = ned_from_geodetic(origin, lat, lon, -(depth + heave))

    roll = _ROLL_PER_TURN_RATE_S * turn_rate + roll_w
    pitch = -np.arctan(sink_rate / mission.speed) + pitch_w
    R_nl = R_n_local(origin, lat, lon)
    # north of n, seen in local axes: courses were planned against it, attitudes are against local axes
    convergence = np.arctan2(R_nl[:, 0, 1], R_nl[:, 0, 0])
    R_nb = R_nl @ matrix_from_rph(np.stack([roll, pitch, heading + convergence + heading_w], axis=-1))
    rph_n = np.unwrap(rph_from_matrix(R_nb), axis=0)
    return Trajectory.through(origin, start_ns, mission.duration_s, t, p_n, rph_n)


def _refuse_impossible(mission: Mission) -> None:
    current = float(np.hypot(*mission.current))
    if current > 0.8 * mission.speed:
        raise ConfigError(
            f"a current of {current:.2f} m/s leaves no course to hold at {mission.speed:.2f} m/s through the water",
            where="current",
            remedy="keep the current below 0.8 of the speed",
        )
    dive = (mission.depth - mission.surface_depth) / _vertical_speed(mission) + _DIVE_BLEND_S
    needed = mission.surface_time_s + _ACCELERATION_S + 2.0 * dive + _SURFACED_S
    if mission.surface_at_end and mission.pattern != "helix" and mission.duration_s < needed:
        raise ConfigError(
            f"{mission.duration_s:.0f} s are too short to dive to {mission.depth:.0f} m and surface again",
            where="duration_s",
            remedy=f"give at least {np.ceil(needed):.0f} s, or a smaller depth",
        )


def _vertical_speed(mission: Mission) -> float:
    return float(mission.speed * _DIVE_SLOPE)


def _crab(mission: Mission, course: FloatArray) -> FloatArray:
    """Heading that makes the ground track follow the course in the current at cruising speed."""
    across = -np.sin(course) * mission.current[0] + np.cos(course) * mission.current[1]
    heading: FloatArray = course - np.arcsin(across / mission.speed)
    return heading


def _ground_speed(mission: Mission, course: float) -> float:
    along = np.cos(course) * mission.current[0] + np.sin(course) * mission.current[1]
    drift = float(_crab(mission, np.array([course]))[0]) - course
    return float(mission.speed * np.cos(drift) + along)


def _turn_rate(mission: Mission, t: FloatArray) -> FloatArray:
    work_start = mission.surface_time_s + _ACCELERATION_S
    if mission.pattern == "transit":
        return np.zeros_like(t)
    if mission.pattern == "helix":
        rate = mission.speed / mission.helix_radius_m
        return rate * smoothstep((t - work_start) / _TURN_BLEND_S)
    turns = (_patrol_turns if mission.pattern == "patrol" else _lawnmower_turns)(mission, work_start)
    rate = np.radians(mission.turn_rate_deg_s)
    total = np.zeros_like(t)
    for start, angle in zip(turns.start_s, turns.angle, strict=True):
        end = start + abs(angle) / rate
        near = slice(*np.searchsorted(t, [start, end + _TURN_BLEND_S + KNOT_S]))
        total[near] += np.sign(angle) * rate * _bump(t[near], start, end, _TURN_BLEND_S)
    return total


def _lawnmower_turns(mission: Mission, start: float) -> _Turns:
    """Legs up and down joined by short cross legs: two quarter turns right, two left, and so on."""
    quarter = 0.5 * np.pi
    turn_s = quarter / np.radians(mission.turn_rate_deg_s)
    radius = mission.speed / np.radians(mission.turn_rate_deg_s)
    course = np.radians(mission.heading_deg)
    turns = _Turns([], [])
    side = 1.0
    now = start
    while now < mission.duration_s:
        for length in (mission.leg_length_m, max(mission.line_spacing_m - 2.0 * radius, 0.0)):
            now += length / _ground_speed(mission, course)
            turns.start_s.append(now)
            turns.angle.append(side * quarter)
            now += turn_s
            course += side * quarter
        side = -side
    return turns


def _patrol_turns(mission: Mission, start: float) -> _Turns:
    """Quarter turns right around one rectangle; its last two legs make up for what the current does in the turns."""
    quarter = 0.5 * np.pi
    courses = np.radians(mission.heading_deg) + quarter * np.arange(4)
    along = np.stack([np.cos(courses[:2]), np.sin(courses[:2])], axis=1)
    defect = along @ np.sum([_quarter_turn(mission, course) for course in courses], axis=0)
    sides = np.array([mission.leg_length_m, mission.line_spacing_m])
    lengths = np.concatenate([sides, sides + defect])
    if lengths.min() <= 0.0:
        raise ConfigError(
            f"the current leaves no rectangle of {sides[0]:g} by {sides[1]:g} m to go around",
            where="leg_length_m, line_spacing_m",
            remedy="make it larger, or the current weaker",
        )
    turns = _Turns([], [])
    now = start
    while now < mission.duration_s:
        for course, length in zip(courses, lengths, strict=True):
            now += length / _ground_speed(mission, course)
            turns.start_s.append(now)
            turns.angle.append(quarter)
            now += quarter / np.radians(mission.turn_rate_deg_s)
    return turns


def _quarter_turn(mission: Mission, course: float) -> FloatArray:
    """Where a quarter turn right out of a course leads beyond the blend on the next one, shape (2,), m."""
    rate = np.radians(mission.turn_rate_deg_s)
    turn_s = 0.5 * np.pi / rate
    t = np.linspace(0.0, turn_s + _TURN_BLEND_S, 400)
    courses = course + _integral(t, rate * _bump(t, 0.0, turn_s, _TURN_BLEND_S))
    heading = _crab(mission, courses)
    v = mission.speed * np.stack([np.cos(heading), np.sin(heading)]) + np.array(mission.current)[:, None]
    after: FloatArray = np.trapezoid(v, t, axis=1) - _TURN_BLEND_S * v[:, -1]
    return after


def _sink_rate(mission: Mission, t: FloatArray) -> FloatArray:
    """Rate of the planned depth: down after the start, and up again if asked."""
    way = mission.depth - mission.surface_depth
    if way <= 0.0:
        return np.zeros_like(t)
    start = mission.surface_time_s + _ACCELERATION_S
    up_s = way / _vertical_speed(mission) if mission.surface_at_end else 0.0
    up_start = mission.duration_s - up_s - _DIVE_BLEND_S - _SURFACED_S if mission.surface_at_end else np.inf
    down_s = way / _vertical_speed(mission)
    if mission.pattern == "helix":
        down_s = max(down_s, min(up_start, mission.duration_s) - _DIVE_BLEND_S - start)
    rate = way / down_s * _bump(t, start, start + down_s, _DIVE_BLEND_S)
    if mission.surface_at_end:
        rate -= way / up_s * _bump(t, up_start, up_start + up_s, _DIVE_BLEND_S)
    return rate


def _wobble(
    mission: Mission, t: FloatArray, depth: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Roll, pitch, heading [rad] and heave [m]: strong in the waves, small (the controller's own) at depth."""
    at_surface = np.array([np.radians(3.0), np.radians(2.0), np.radians(1.0), 0.10])
    at_depth = np.array([np.radians(0.6), np.radians(0.4), np.radians(0.3), 0.0])
    decay = np.exp(-np.maximum(depth, 0.0) / _WAVE_DEPTH_M)[:, None]
    amplitude = mission.waves * (at_depth + (at_surface - at_depth) * decay)
    period = rng.uniform(4.0, 9.0, size=(3, 1, 4))
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(3, 1, 4))
    unit = np.sin(2.0 * np.pi * t[None, :, None] / period + phase).mean(axis=0)
    roll, pitch, heading, heave = np.moveaxis(amplitude * unit, -1, 0)
    return roll, pitch, heading, heave
