"""The rig's columns against differences of the whole smoothing, and against the analytic DVL factor."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from calibration_dives import LEVER, STRAIGHT, TURNING, cut, dive_of

from uwgraph.calibrate.column_noise import reliability
from uwgraph.calibrate.columns import euler_axes, rig_columns
from uwgraph.calibrate.information import rig_information
from uwgraph.calibrate.parameters import CAN, RATE, Limits, Parameter, Priors, chosen, with_values
from uwgraph.dive import Dive
from uwgraph.dive.rig import DvlRig
from uwgraph.frames import matrix_from_rph
from uwgraph.graph import SmoothSettings
from uwgraph.graph.builder import DVL_CALIBRATION
from uwgraph.graph.smooth import Smoothed, solve_dive
from uwgraph.simulate import DvlModel
from uwgraph.types import Solution

PLAIN = SmoothSettings(dvl_calibration=False, loss="none", covariances=False)
STEPS = {"scale": 1e-3, "rotation_deg": 0.05, "translation_m": 0.02, "time_offset_s": 0.01}
NAMES = [f"{s}.{f}" for s in ("dvl", "depth", "fixes", "heading", "sun") for f in CAN[s]]


def smoothed(dive: Dive, settings: SmoothSettings = PLAIN, guess: Solution | None = None) -> Smoothed:
    return solve_dive(dive, settings, lambda doing, share: None, guess)


def with_dvl(dive: Dive, **update: object) -> Dive:
    return replace(dive, rig=dive.rig.model_copy(update={"dvl": dive.rig.dvl.model_copy(update=update)}))


@pytest.fixture(scope="module")
def dive() -> Dive:
    settings = TURNING.model_copy(update={"grade": "noise_free", "duration_s": 150.0, "leg_length_m": 30.0})
    return dive_of(settings, 0, fix_sigma=1e-3)


@pytest.fixture(scope="module")
def parameters(dive: Dive) -> tuple[Parameter, ...]:
    return chosen(NAMES, [dive], (), Priors(), Limits())


@pytest.mark.slow
def test_the_information_is_the_change_of_the_score(dive: Dive, parameters: tuple[Parameter, ...]) -> None:
    """A rig that is wrong by h moves the score by information times h: clocks, levers, mountings alike."""
    track = smoothed(dive).solution
    at_truth = smoothed(dive, guess=track)
    here = rig_information(at_truth, parameters)
    size = np.sqrt(np.diag(here.matrix))
    for i, p in enumerate(parameters):
        if p.field == RATE:
            continue
        h = STEPS[p.field]
        wrong = replace(dive, rig=with_values(dive.rig, [p], [p.value(dive.rig) + h]))
        there = rig_information(smoothed(wrong, guess=track), parameters)
        change = -(there.vector - here.vector) / h * p.prior
        assert change[i] == pytest.approx(here.matrix[i, i], rel=0.03), p.name
        # against every other number, as a correlation
        assert np.abs(change - here.matrix[i]).max() < 0.06 * size.max() * size[i], p.name
        assert np.quantile(np.abs(change - here.matrix[i]) / (size * size[i]), 0.9) < 0.06, p.name


def test_scale_and_mounting_are_those_of_the_calibrated_displacement() -> None:
    """The same information as the analytic factor with the DVL's calibration as a variable, at the same states."""
    true = DvlRig(translation_m=LEVER, scale_sigma=0.0, misalignment_sigma_deg=0.0)
    dive = dive_of(TURNING.model_copy(update={"duration_s": 150.0, "dvl": DvlModel(rig=true)}), 0)
    free = with_dvl(dive, scale_sigma=1e-4, misalignment_sigma_deg=1e-3)
    bulk = smoothed(free, PLAIN.model_copy(update={"dvl_calibration": True}))
    linear = bulk.problem.linearize(bulk.solved.values)
    order = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [DVL_CALIBRATION])
    last = linear.eliminateSequential(order, gtsam.EliminateQR).back()
    prior = np.diag([1e-4, *np.radians([1e-3] * 3)]) ** 2
    to_rig = np.diag([1.0, *np.radians([1.0] * 3)])  # the rig has degrees
    expected = to_rig @ (last.information() - np.linalg.inv(prior)) @ to_rig

    parameters = chosen(["dvl.scale", "dvl.rotation_deg"], [dive], (), Priors(), Limits())
    units = np.array([p.prior for p in parameters])
    matrix = rig_information(smoothed(dive), parameters).matrix / np.outer(units, units)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(matrix / np.outer(size, size), expected / np.outer(size, size), atol=0.02)


def test_a_robust_loss_weighs_the_columns_too(dive: Dive, parameters: tuple[Parameter, ...]) -> None:
    assert dive.fixes is not None
    height = dive.fixes.height.copy()
    height[3] += 50.0
    wild = replace(dive, fixes=replace(dive.fixes, height=height))
    found = smoothed(wild, PLAIN.model_copy(update={"loss": "huber"}))
    linear = found.problem.linearize(found.solved.values)
    columns = rig_columns(found, linear, parameters)
    first = sum(list(found.problem.counts.values())[: list(found.problem.counts).index("fixes")])
    size = [np.abs(columns[first + k]).max() for k in (2, 3, 4)]
    assert size[1] < 0.1 * min(size[0], size[2])


@pytest.mark.parametrize("rph", [(0.0, 0.0, 0.0), (3.0, -7.0, 45.0), (180.0, 0.0, -90.0)])
def test_euler_axes_turn_the_body(rph: tuple[float, float, float]) -> None:
    axes = euler_axes(rph)
    R = matrix_from_rph(np.radians(rph))
    for i in range(3):
        more = np.array(rph)
        more[i] += 1e-5
        dR = (matrix_from_rph(np.radians(more)) - R) @ R.T / 1e-5
        np.testing.assert_allclose([dR[2, 1], dR[0, 2], dR[1, 0]], axes[:, i], atol=1e-8)


def test_what_a_straight_run_seems_to_tell_of_a_clock_is_noise() -> None:
    """Of a lever arm too; where the vehicle turns, next to nothing of it is."""
    parameters = chosen(
        ["dvl.translation_m", "dvl.time_offset_s", "dvl.scale"], [dive_of(TURNING, 0)], (), Priors(), Limits()
    )
    shares = []
    for run in (cut(dive_of(STRAIGHT, 0), 160.0, 350.0), dive_of(TURNING, 0)):
        found = smoothed(run)
        linear = found.problem.linearize(found.solved.values)
        columns = rig_columns(found, linear, parameters)
        shares.append(reliability(found, linear, columns, parameters))
    np.testing.assert_array_equal(shares[0], [0.0, 0.0, 0.0, 0.0, 1.0])
    assert (shares[1] > 0.99).all()
