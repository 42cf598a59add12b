"""The kinematic model: its motion against an integrator, its derivatives against differences, its measurements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from uwgraph.errors import DataError
from uwgraph.filters.kinematic import InputNoise, Inputs, Kinematic, depth, fix, heading, levelled, unwrapped
from uwgraph.filters.state import State
from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray

PLAIN, BIASED = Kinematic(InputNoise()), Kinematic(InputNoise(velocity_bias_sigma=0.1, rate_bias_sigma=0.01))
INPUTS = st.tuples(*[st.floats(-3.0, 3.0)] * 3, st.floats(-0.5, 0.5)).map(np.array)
FEW = settings(max_examples=50, deadline=None)


def moved(y: FloatArray, dt: float, u: FloatArray, model: Kinematic = PLAIN) -> FloatArray:
    x = State(np.empty((1, 0, 3, 3)), y[None], np.empty(0, dtype=np.int64))
    return model.move(x, dt, u).y[0]


@given(INPUTS, st.floats(-10.0, 10.0), st.floats(0.01, 5.0))
@FEW
def test_a_step_is_the_solution_of_the_equations(u: FloatArray, psi: float, dt: float):
    def rates(t: float, y: FloatArray) -> list[float]:
        c, s = np.cos(y[3]), np.sin(y[3])
        return [u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2], u[3]]

    start = np.array([1.0, -2.0, 3.0, psi])
    solved = solve_ivp(rates, (0.0, dt), start, rtol=1e-10, atol=1e-11).y[:, -1]
    np.testing.assert_allclose(moved(start, dt, u), solved, atol=1e-7)


@given(INPUTS, st.floats(-np.pi, np.pi), st.floats(0.01, 5.0))
@FEW
def test_two_halves_are_one_step(u: FloatArray, psi: float, dt: float):
    start = np.array([0.0, 0.0, 0.0, psi])
    np.testing.assert_allclose(moved(moved(start, dt / 2, u), dt / 2, u), moved(start, dt, u), atol=1e-11)


@given(INPUTS, st.floats(-np.pi, np.pi), st.floats(0.05, 3.0))
@FEW
def test_derivative_by_the_inputs(u: FloatArray, psi: float, dt: float):
    start, h = np.array([0.0, 0.0, 0.0, psi]), 1e-5
    numeric = np.column_stack(
        [(moved(start, dt, u + h * e) - moved(start, dt, u - h * e)) / (2 * h) for e in np.eye(4)]
    )
    np.testing.assert_allclose(PLAIN.by_inputs(psi, dt, u), numeric, atol=1e-7)


def test_derivative_where_the_series_takes_over():
    u = np.array([2.0, 1.0, 0.0, 1e-3])
    below, above = (PLAIN.by_inputs(0.3, dt, u) for dt in (1.0 - 1e-9, 1.0 + 1e-9))
    np.testing.assert_allclose(below, above, atol=1e-7)


def test_biases_are_taken_off_the_inputs_and_walk():
    y = np.concatenate([[0.0, 0.0, 0.0, 0.4], [0.1, -0.2, 0.05, 0.01]])
    u = np.array([1.0, 0.0, 0.0, 0.1])
    np.testing.assert_allclose(moved(y, 2.0, u, BIASED)[:4], moved(y[:4], 2.0, u - y[4:]))
    np.testing.assert_array_equal(moved(y, 2.0, u, BIASED)[4:], y[4:])
    walking = Kinematic(InputNoise(velocity_bias_walk=0.3, rate_bias_walk=0.02))
    rows = walking.noise_rows(0.0, 4.0, u, walking.noise.root)
    np.testing.assert_allclose(np.sqrt(np.diag(rows.T @ rows))[4:], 2.0 * np.array([0.3, 0.3, 0.3, 0.02]))


def test_noise_of_many_steps_is_that_of_the_time():
    """White noise gains the same variance in one step and in ten, and that of a random walk."""
    noise, u = InputNoise(velocity_density=0.1, rate_density=1e-9), np.array([1.0, 0.5, 0.0, 0.0])
    one = Kinematic(noise).noise_rows(0.7, 1.0, u, noise.root)
    ten = Kinematic(noise).noise_rows(0.7, 0.1, u, noise.root)
    np.testing.assert_allclose(one.T @ one, 10.0 * ten.T @ ten, atol=1e-12)
    np.testing.assert_allclose((one.T @ one)[:3, :3], 0.01 * np.eye(3), atol=1e-12)


def test_levelled_velocity_forgets_roll_and_pitch_alone():
    rng = np.random.default_rng(0)
    rph = rng.uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0], (20, 3))
    R, flat = matrix_from_rph(rph), matrix_from_rph(rph * [0.0, 0.0, 1.0])
    v_b = rng.normal(size=(20, 3))
    at_level = levelled(v_b, R)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", flat, at_level), np.einsum("nij,nj->ni", R, v_b), atol=1e-12)


@given(st.floats(-20.0, 20.0), st.floats(-0.5, 0.5), st.integers(-3, 3))
@FEW
def test_headings_wrap(psi: float, off: float, turns: int):
    measured = heading(0, psi + off + 2.0 * np.pi * turns, 0.1)
    x = State(np.empty((1, 0, 3, 3)), np.array([[0.0, 0.0, 0.0, psi]]), np.empty(0, dtype=np.int64))
    assert measured.residual(x)[0, 0] == pytest.approx(-off / 0.1, abs=1e-9)


def test_sigma_points_about_the_opposite_heading_stay_together():
    around = np.pi + np.array([[0.0], [0.2], [-0.2]])
    off = unwrapped(around)
    np.testing.assert_allclose(off - off[0], around - around[0], atol=1e-12)


def test_whitened_by_the_whole_covariance():
    cov = np.array([[4.0, 1.0], [1.0, 2.0]])
    x = State(np.empty((1, 0, 3, 3)), np.array([[3.0, -1.0, 9.0, 0.0]]), np.empty(0, dtype=np.int64))
    r = fix(0, [1.0, 1.0], cov).residual(x)[0]
    assert r @ r == pytest.approx(np.array([2.0, -2.0]) @ np.linalg.solve(cov, [2.0, -2.0]))
    assert depth(0, 8.0, 0.5).residual(x)[0] == pytest.approx([2.0])


@pytest.mark.parametrize(
    "make",
    [
        lambda: heading(0, np.nan, 0.1),
        lambda: heading(0, 1.0, 0.0),
        lambda: depth(0, 1.0, np.nan),
        lambda: fix(0, [1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]]),
        lambda: fix(0, [1.0, 2.0, 3.0], np.eye(2)),
        lambda: Inputs(np.array([2, 1]), np.zeros((2, 4))),
        lambda: Inputs(np.array([1, 2]), np.zeros((2, 3))),
        lambda: Inputs(np.array([1, 2]), np.full((2, 4), np.inf)),
    ],
)
def test_bad_numbers_are_refused(make):
    with pytest.raises(DataError) as error:
        make()
    assert error.value.remedy
