"""Contests of made-up estimators on the hand-made dive: simulated, all of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from hand_made import ORIGIN, as_reference, truth
from scipy.spatial.transform import Rotation

from uwgraph.dive import Dive
from uwgraph.evaluate import Judged, metrics
from uwgraph.evaluate.align import Alignment
from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.types import FloatArray, Innovations, Reference, Solution, TimeArray

MANY = ("dr", "eskf", "rts", "ukf", "aukf", "smooth")


def drifted(solution: Solution, metres: float, degrees: float) -> Solution:
    """Off to the north-east and clockwise by as much at the end, and as unsure of it."""
    share = np.linspace(0.0, 1.0, len(solution))
    turn = Rotation.from_rotvec(np.radians(degrees) * share[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    unsure = np.diag([0.0, 0.0, np.radians(degrees) ** 2, *[metres**2] * 3])
    p_n = solution.p_n + share[:, None] * metres * np.array([0.8, 0.6, 0.0])
    cov = solution.cov_pose + share[:, None, None] ** 2 * unsure
    return replace(solution, p_n=p_n, R_nb=turn @ solution.R_nb, cov_pose=cov)


def entry(name: str, solution: Solution, reference: Reference | None, alignment: Alignment = "none") -> Entry:
    judged = Judged(solution, reference, metrics(solution, reference, alignment))
    return Entry(name, f"made-up {name}", judged, innovations(solution.t_ns) if name.endswith("kf") else None)


def contest(
    errors: Mapping[str, float] | None = None,
    *,
    n: int = 200,
    referenced: bool = True,
    title: str = "made-up dive",
    failed: Mapping[str, str] | None = None,
    alignment: Alignment = "none",
) -> Contest:
    """Estimators that end so many metres and tenths of a degree from the truth."""
    errors = {name: 3.0 - 0.4 * i for i, name in enumerate(MANY)} if errors is None else errors
    reference = as_reference(truth(n))
    known = reference if referenced else None
    entries = [entry(name, drifted(truth(n), size, 0.1 * size), known, alignment) for name, size in errors.items()]
    dive = Dive(ORIGIN, reference=known, provenance={"source": "simulated"})
    return Contest(dive, title, tuple(entries), failed or {})


def innovations(t_ns: TimeArray, seed: int = 0) -> Innovations:
    """White innovations of a velocity (3) and a depth (1) at every stamp; one in fifty wild and refused."""
    rng = np.random.default_rng(seed)
    n = len(t_ns)
    dof = np.tile([3, 1], n)
    whitened = rng.standard_normal((2 * n, 3))
    whitened[1::2, 1:] = np.nan
    wild = np.arange(2 * n) % 50 == 49
    whitened[wild] *= 40.0
    noise = np.where(np.isfinite(whitened), 1.0, np.nan)
    nis: FloatArray = np.nansum(whitened**2, axis=1) / dof
    fading = np.where(np.arange(2 * n) % 90 == 30, 4.0, 1.0)
    return Innovations(np.repeat(t_ns, 2), np.tile(["dvl", "depth"], n), dof, whitened, nis, ~wild, noise, fading)
