"""Simulated closures and visual odometry against the truth they come from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.rig import VisualRig
from uwgraph.dive.validate import validate_dive
from uwgraph.errors import DataError
from uwgraph.simulate import ClosureModel, OdometryModel, SimulationSettings, add_closures, add_odometry, simulate
from uwgraph.simulate.closures import CORNER, RANDOM, SHIFTED, TRUE
from uwgraph.simulate.replay import ReferenceMotion
from uwgraph.types import FloatArray, RelativePoses

PATROL = SimulationSettings(pattern="patrol", duration_s=600.0, leg_length_m=60.0, line_spacing_m=30.0)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate(PATROL)


def errors(dive: Dive, stream: RelativePoses, offset_ns: int = 0) -> FloatArray:
    """Rotation and translation off the truth, shape (N, 6), in the axes of the end body."""
    motion = ReferenceMotion.of(dive)
    a, b = ((t + offset_ns - motion.start_ns) * 1e-9 for t in (stream.from_ns, stream.t_ns))
    R_a, R_b = motion.attitude(a), motion.attitude(b)
    R = Rotation.from_rotvec(stream.rotvec).as_matrix()
    turn = Rotation.from_matrix(np.swapaxes(R_b, 1, 2) @ R_a @ R).as_rotvec()
    p_n = motion.position(a) + np.einsum("nij,nj->ni", R_a, stream.p)
    return np.column_stack([turn, np.einsum("nji,nj->ni", R_b, p_n - motion.position(b))])


def test_true_closures_have_the_noise_they_state(dive: Dive) -> None:
    seen = add_closures(dive, ClosureModel(period_s=1.0, sigma=0.2, sigma_deg=0.7), seed=3).closures
    assert seen is not None
    white = errors(dive, seen) / np.sqrt(np.diagonal(seen.cov, axis1=1, axis2=2))
    assert len(seen) > 200
    np.testing.assert_allclose(np.sqrt(np.mean(white**2, axis=0)), 1.0, atol=0.15)
    assert (np.linalg.norm(seen.p, axis=1) < 5.0).all()
    assert (seen.t_ns - seen.from_ns > 55 * 10**9).all()


def test_false_closures_are_as_many_as_asked_and_far_from_true(dive: Dive) -> None:
    model = ClosureModel(period_s=2.0, false_share=0.3)
    seen = add_closures(dive, model, seed=1).closures
    assert seen is not None
    false = seen.reason != TRUE
    assert false.sum() == round(0.3 * len(seen))
    assert {RANDOM, CORNER, SHIFTED} <= set(seen.reason.tolist())
    off = np.linalg.norm(errors(dive, seen)[:, 3:], axis=1)
    assert (off[seen.reason == RANDOM] > 2.0).all()
    assert np.median(off[false]) > 5.0
    assert off[~false].max() < 1.0
    validate_dive(replace(dive, closures=seen))


def test_groups_agree_with_each_other(dive: Dive) -> None:
    """Errors of a group are one motion of the whole in n."""
    model = ClosureModel(period_s=2.0, false_share=0.1, grouped_share=1.0, group=100, sigma=1e-6, sigma_deg=1e-6)
    for seed in range(3):
        seen = add_closures(dive, model, seed=seed).closures
        assert seen is not None
        group = seen.select(seen.reason != TRUE)
        motion = ReferenceMotion.of(dive)
        a, b = ((t - motion.start_ns) * 1e-9 for t in (group.from_ns, group.t_ns))
        R_D = (
            motion.attitude(a) @ Rotation.from_rotvec(group.rotvec).as_matrix() @ np.swapaxes(motion.attitude(b), 1, 2)
        )
        claimed = motion.position(a) + np.einsum("nij,nj->ni", motion.attitude(a), group.p)
        p_D = claimed - np.einsum("nij,nj->ni", R_D, motion.position(b))
        np.testing.assert_allclose(R_D, R_D[:1].repeat(len(R_D), axis=0), atol=1e-5)
        np.testing.assert_allclose(p_D, p_D[:1].repeat(len(p_D), axis=0), atol=1e-3)


def test_odometry_follows_the_motion_and_the_camera_clock(dive: Dive, tmp_path: Path) -> None:
    model = OdometryModel(period_s=0.5, rig=VisualRig(time_offset_s=0.12))
    seen = add_odometry(dive, model, seed=2)
    odometry = seen.odometry
    assert odometry is not None
    assert seen.rig.visual.time_offset_s == 0.12
    np.testing.assert_array_equal(odometry.from_ns[1:], odometry.t_ns[:-1])
    white = errors(dive, odometry, offset_ns=120_000_000) / np.sqrt(np.diagonal(odometry.cov, axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt(np.mean(white**2, axis=0)), 1.0, atol=0.1)
    assert "visual odometry" in seen.provenance["simulated"]["odometry"]
    write_dive(seen, tmp_path / "dive")
    read = read_dive(tmp_path / "dive").odometry
    assert read is not None
    np.testing.assert_allclose(read.rotvec, odometry.rotvec, atol=1e-12)


def test_the_same_seed_gives_the_same_closures(dive: Dive) -> None:
    one, two, other = (add_closures(dive, ClosureModel(false_share=0.2), seed).closures for seed in (1, 1, 2))
    assert one is not None
    assert two is not None
    assert other is not None
    np.testing.assert_array_equal(one.p, two.p)
    assert one.p.shape != other.p.shape or not np.array_equal(one.p, other.p)


def test_a_way_that_never_comes_back_is_refused() -> None:
    transit = simulate(SimulationSettings(pattern="transit", duration_s=200.0))
    with pytest.raises(DataError, match="never comes back"):
        add_closures(transit)
