"""A simulated world of places, some of which look like each other, and a vehicle that patrols them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.filters.kinematic import Direct, InputNoise, Inputs, Kinematic, depth, heading, turned
from uwgraph.filters.place_nodes import Sighting, relative
from uwgraph.filters.state import Belief
from uwgraph.frames import wrap_pi
from uwgraph.types import FloatArray

SECOND = 1_000_000_000
START_SIGMA = np.array([0.1, 0.1, 0.1, np.radians(0.5)])
INPUT_NOISE = InputNoise(velocity_density=0.07, rate_density=1.5e-3, velocity_bias_sigma=0.06, rate_bias_sigma=6e-4)
PLACE_SIGMA, RANGE = 0.3, 7.0
DESCRIPTOR_SIZE, DESCRIPTOR_SIGMA = 32, 0.05
SUN_SIGMA, DEPTH_SIGMA = np.radians(3.0), 0.1
LAP_S = 170


@dataclass(frozen=True, eq=False)
class World:
    """One simulated patrol."""

    truth: FloatArray
    """Poses at full seconds after the first, shape (K, 4)."""
    places: FloatArray
    """Shape (P, 3)."""
    first: Belief
    inputs: Inputs
    direct: list[Direct]
    sightings: list[Sighting]
    seen: list[int]
    """The true place of each sighting."""


def patrol(seconds: int) -> FloatArray:
    """Poses every second along a lawn mower of 4 lines of 60 m that closes, at about 2 m/s, shape (K, 4)."""
    corners = np.array([[0, 0], [60, 0], [60, 14], [0, 14], [0, 28], [60, 28], [60, 42], [0, 42], [0, 0]], dtype=float)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    t = np.arange(-10, seconds + 11) * way[-1] / LAP_S
    sharp = np.column_stack([np.interp(t % way[-1], way, corners[:, k]) for k in range(2)])
    round_ = np.column_stack([np.convolve(sharp[:, k], np.hanning(7) / np.hanning(7).sum(), "same") for k in range(2)])
    psi = np.unwrap(np.arctan2(*np.gradient(round_, axis=0).T[::-1]))
    down = 20.0 + 2.0 * np.sin(0.05 * t)
    return np.column_stack([round_, down, psi])[10:-10]


def inputs_between(poses: FloatArray) -> FloatArray:
    """Constant inputs that lead from each pose to the next one a second later, shape (K - 1, 4)."""
    step = np.diff(poses, axis=0)
    chord = np.sinc(step[:, 3] / (2.0 * np.pi))
    forward, starboard = turned(-(poses[:-1, 3] + 0.5 * step[:, 3]), step[:, 0] / chord, step[:, 1] / chord)
    return np.column_stack([forward, starboard, step[:, 2:]])


def world(
    seed: int,
    seconds: int = 3 * LAP_S // 2,
    count: int = 24,
    aliases: int = 3,
    step_at: int | None = None,
    descriptor_sigma: float = DESCRIPTOR_SIGMA,
    noise: InputNoise = INPUT_NOISE,
) -> World:
    """A patrol; from ``step_at`` on the noise of sightings has nine times the variance that is stated."""
    rng = np.random.default_rng(seed)
    poses = patrol(seconds)
    lap = poses[:LAP_S]
    places = lap[np.linspace(0, LAP_S, count, endpoint=False).astype(int), :3] + rng.normal(
        0, [2.5, 2.5, 0.3], (count, 3)
    )
    places[:, 2] += 4.0
    looks = rng.normal(size=(count, DESCRIPTOR_SIZE))
    for k in range(aliases):
        looks[count // 2 + 2 * k] = looks[2 * k] + 0.1 * rng.normal(size=DESCRIPTOR_SIZE)
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)

    bias = rng.normal(0.0, [noise.velocity_bias_sigma] * 3 + [noise.rate_bias_sigma])
    white = rng.normal(0.0, [noise.velocity_density] * 3 + [noise.rate_density], (seconds, 4))
    t_ns = np.arange(1, seconds + 1) * SECOND
    inputs = Inputs(t_ns, inputs_between(poses) + bias + white)

    direct, sightings, seen = [], [], []
    for t, pose in zip(t_ns.tolist(), poses[1:], strict=True):
        second = t // SECOND
        if second % 10 == 0:
            direct.append(heading(t, float(wrap_pi(pose[3] + rng.normal(0.0, SUN_SIGMA))), SUN_SIGMA, "sun"))
        if second % 5 == 0:
            direct.append(depth(t, pose[2] + rng.normal(0.0, DEPTH_SIGMA), DEPTH_SIGMA))
        near = np.flatnonzero(np.linalg.norm(places[:, :2] - pose[:2], axis=1) < RANGE)
        sigma = PLACE_SIGMA * (3.0 if step_at is not None and second >= step_at else 1.0)
        for k in near if second % 2 == 0 else []:
            state = np.concatenate([pose, places[k]])[None]
            z = relative(state, np.arange(4, 7))[0] + rng.normal(0.0, sigma, 3)
            look = looks[k] + rng.normal(0.0, descriptor_sigma, DESCRIPTOR_SIZE)
            sightings.append(Sighting(t, z, PLACE_SIGMA**2 * np.eye(3), look))
            seen.append(int(k))
    start = poses[0] + rng.normal(0.0, START_SIGMA)
    first = Kinematic(noise).start(0, start[:3], float(start[3]), np.diag(START_SIGMA**2))
    return World(poses[1:], places, first, inputs, direct, sightings, seen)
