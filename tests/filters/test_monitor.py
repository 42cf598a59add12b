"""What becomes of a measurement: outliers, noise that changes, a state that jumps, claims that are false."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from linear import belief_of, predicted, updated
from scalar_filter import Line, adaptive, rmse, variance

from uwgraph.filters import extended
from uwgraph.filters.monitor import RECENT, Policy, Taken, explaining
from uwgraph.filters.state import Belief
from uwgraph.filters.unscented import Seen
from uwgraph.types import FloatArray

FIXED = Policy(0.9999)
RUNS = 6


def textbook_rmse(z: FloatArray, truth: FloatArray, q: float, r: float) -> float:
    """The Kalman filter without gate and adaptation."""
    x, P, one, errors = np.zeros(1), np.eye(1), np.eye(1), []
    for measured, true in zip(z, truth, strict=True):
        x, P = predicted(x, P, one, q * one)
        x, P = updated(x, P, one, r * one, measured)
        errors.append(float(x[0] - true[0]))
    return float(np.sqrt(np.mean(np.square(errors))))


def stepped(line: Line, seed: int, steps: int = 400, growth: float = 9.0) -> tuple[FloatArray, FloatArray]:
    """Measurements whose true variance goes from 1 to ``growth`` in the middle, and the truth."""
    rng = np.random.default_rng(seed)
    truth = line.truth(rng, steps)
    sigma = np.where(np.arange(steps) < steps // 2, 1.0, np.sqrt(growth))[:, None]
    return truth + sigma * rng.normal(size=truth.shape), truth


def mean_square(errors: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


# What is said about a measurement


@pytest.mark.parametrize("policy", [FIXED, adaptive()], ids=["fixed", "adaptive"])
@pytest.mark.parametrize("m", [1, 3])
def test_what_is_taken_is_consistent(policy: Policy, m: int) -> None:
    line = Line(0.01, 1.0, m)
    rng = np.random.default_rng(m)
    truth = line.truth(rng, 300)
    z = truth + rng.normal(size=truth.shape)
    z[100] += 30.0
    history = line.filtered(z, policy)
    assert not history[100].accepted
    assert np.mean([t.accepted for t in history]) > 0.98
    for before, t in pairwise(history):
        assert t.whitened.shape == t.noise.shape == (m,)
        assert t.nis >= 0.0
        assert t.fading >= 1.0
        assert t.accepted == (t.nis * m <= policy.limit(0.9999, m))
        if not t.accepted:
            np.testing.assert_array_equal(t.belief.x.y, before.belief.x.y)
            assert t.belief.P[0, 0] > before.belief.P[0, 0]
    used = [t.nis for t in history[50:] if t.accepted]
    assert np.mean(used) == pytest.approx(1.0, abs=0.2)


def test_the_innovation_is_prediction_minus_measurement_in_stated_sigmas() -> None:
    line = Line(1.0, 4.0)
    taken = line.filtered(np.array([[3.0]]), FIXED)[0]
    assert taken.whitened[0] == pytest.approx(-3.0 / 2.0)
    assert taken.nis == pytest.approx(9.0 / (4.0 + 2.0))


def test_with_fixed_noise_it_is_the_kalman_filter() -> None:
    line = Line(0.1, 1.0)
    rng = np.random.default_rng(0)
    truth = line.truth(rng, 100)
    z = truth + 0.5 * rng.normal(size=truth.shape)
    assert rmse(line.filtered(z, FIXED), truth) == pytest.approx(textbook_rmse(z, truth, 0.1, 1.0), rel=1e-9)


def test_the_gate_is_a_quantile_of_chi_square() -> None:
    """Of single measurements of a right filter so many are refused."""
    rng = np.random.default_rng(0)
    policy = Policy(0.95)
    belief = belief_of(np.zeros(2), np.eye(2))

    def seen(belief: Belief, z: FloatArray) -> Seen:
        return extended.see(belief, z, np.eye(2))

    drawn = np.sqrt(2.0) * rng.normal(size=(4000, 2))
    refused = [not policy.take(belief, partial(seen, z=z), None).accepted for z in drawn]
    assert np.mean(refused) == pytest.approx(0.05, abs=0.011)


# Outliers


@pytest.mark.parametrize("policy", [FIXED, adaptive()], ids=["fixed", "adaptive"])
def test_a_lone_outlier_is_refused(policy: Policy) -> None:
    """Every tenth, of twenty sigmas and on either side: the filter is as good as without them."""
    line = Line(0.01, 1.0)
    rng = np.random.default_rng(1)
    truth = line.truth(rng, 400)
    clean = truth + rng.normal(size=truth.shape)
    z = clean.copy()
    z[5::10] += 20.0 * np.sign(rng.normal(size=z[5::10].shape))
    history = line.filtered(z, policy)
    assert not any(t.accepted for t in history[5::10])
    assert np.mean([t.accepted for t in history]) == pytest.approx(0.9, abs=0.01)
    assert all(t.fading == 1.0 for t in history)
    assert rmse(history, truth) < 1.1 * rmse(line.filtered(clean, policy), truth)


@pytest.mark.parametrize("policy", [FIXED, adaptive()], ids=["fixed", "adaptive"])
def test_a_filter_that_is_lost_believes_its_sensor_again(policy: Policy) -> None:
    """A hundred sigmas beside the truth and sure of itself: most are beyond the gate, so that it is to blame."""
    line = Line(0.01, 1.0)
    rng = np.random.default_rng(2)
    truth = line.truth(rng, 200, {50: 100.0})
    z = truth + rng.normal(size=truth.shape)
    history = line.filtered(z, policy)
    assert not history[50].accepted
    assert abs(history[50 + 2 * RECENT].belief.x.y[0] - truth[50 + 2 * RECENT, 0]) < 5.0
    assert rmse(history[120:], truth[120:]) < 0.6


@pytest.mark.parametrize("growth", [9.0, 81.0, 3600.0])
def test_a_filter_of_fixed_noise_does_not_take_noise_for_being_lost(growth: float) -> None:
    """However large it is: a state that is grown for nothing swings after the noise."""
    line, never, errors = Line(0.01, 1.0, 3), [], []
    for seed in range(RUNS):
        z, truth = stepped(line, seed, growth=growth)
        history = line.filtered(z, FIXED)
        assert all(t.fading == 1.0 for t in history)
        errors.append(rmse(history, truth))
        never.append(textbook_rmse(z[:, :1], truth[:, :1], line.q, line.stated))
    assert mean_square(errors) < 1.05 * mean_square(never)


def test_what_is_lost_grows_along_what_explains_it() -> None:
    """Of a state correlated with what is measured by 0.6 it grows by so much, of one that is not by nothing."""
    P = np.array([[4.0, 1.2, 0.0], [1.2, 1.0, 0.0], [0.0, 0.0, 9.0]])
    belief, H = belief_of(np.zeros(3), P), np.array([[1.0, 0.0, 0.0]])
    seen = extended.see(belief, np.array([-20.0]), H)
    grown, factor = explaining(belief, seen, np.array([-20.0]))
    np.testing.assert_allclose(grown.P - P, np.outer([20.0, 6.0, 0.0], [20.0, 6.0, 0.0]), atol=1e-9)
    assert factor == pytest.approx(1.0 + 20.0**2 / 4.0)
    np.testing.assert_allclose(grown.S, np.tril(grown.S), atol=0.0)


def test_a_claim_is_never_believed_because_most_are_beyond_the_gate() -> None:
    belief, policy = belief_of(np.zeros(1), np.eye(1)), adaptive()

    def run(opens: bool) -> list[Taken]:
        """The same claim, thirty sigmas off, over and over."""
        b, monitor, history = belief, None, []
        for _ in range(60):
            see = lambda at: extended.see(at, at.x.y + 30.0, np.eye(1))  # noqa: E731
            history.append(policy.take(b, see, monitor, opens=opens))
            b, monitor = history[-1].belief, history[-1].monitor
        return history

    claims = run(opens=False)
    assert not any(t.accepted for t in claims)
    np.testing.assert_array_equal(claims[-1].belief.S, belief.S)
    assert any(t.accepted for t in run(opens=True))


# Noise that is not what is stated


@pytest.mark.parametrize("noise", ["residual", "unbiased"])
@pytest.mark.parametrize(("stated", "true"), [(1.0, 1.0), (4.0, 1.0), (1.0, 4.0)])
def test_the_noise_is_learnt(noise: str, stated: float, true: float) -> None:
    line = Line(0.01, stated)
    learnt = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = line.truth(rng, 800)
        history = line.filtered(truth + np.sqrt(true) * rng.normal(size=truth.shape), adaptive(noise=noise))
        learnt += [float(variance(t.monitor, stated)[0, 0]) for t in history[600:]]
    assert np.mean(learnt) == pytest.approx(true, rel=0.25)


def test_noise_that_is_never_as_stated_and_grows_ninefold() -> None:
    """Stated 0.05, in truth 1 and then 9: what adapting is worth, and what it must not cost."""
    line, never, nonpositive, least = Line(0.01, 0.05), [], [], np.inf
    errors: dict[str, list[float]] = {}
    for seed in range(RUNS):
        z, truth = stepped(line, seed)
        never.append(textbook_rmse(z, truth, line.q, line.stated))
        for name, policy in {
            "residual": adaptive(),
            "unbiased": adaptive(noise="unbiased", start=0),
            "document": adaptive(convergence="document", document_S=1.0),
        }.items():
            history = line.filtered(z, policy)
            errors.setdefault(name, []).append(rmse(history, truth))
            if name == "unbiased":
                nonpositive.append(history[-1].monitor.nonpositive)
            if name == "residual":
                assert history[-1].monitor.nonpositive == 0
                least = min(least, *(float(t.monitor.noise.R[0, 0]) for t in history))
    figures = {name: mean_square(e) for name, e in errors.items()}
    fixed = mean_square(never)
    assert figures["residual"] < 0.6 * fixed, (figures, fixed)
    assert figures["unbiased"] < 0.6 * fixed, (figures, fixed)
    assert figures["document"] > 1.5 * figures["residual"], (figures, fixed)
    assert least > 0.0
    assert sum(nonpositive) > 0, "the unbiased form without a start is known to fail; if it does not, it is not it"


def test_the_documents_criterion_harms_a_right_filter_and_ours_does_not() -> None:
    """Noise as stated: a third of the good measurements exceed S = 1, and R collapses."""
    line = Line(0.01, 1.0)
    errors: dict[str, list[float]] = {"fixed": [], "ours": [], "document": []}
    faded, learnt = [], []
    for seed in range(RUNS):
        z, truth = stepped(line, seed, growth=1.0)
        errors["fixed"].append(textbook_rmse(z, truth, line.q, line.stated))
        ours = line.filtered(z, adaptive())
        document = line.filtered(z, adaptive(convergence="document", document_S=1.0))
        errors["ours"].append(rmse(ours, truth))
        errors["document"].append(rmse(document, truth))
        faded.append([np.mean([t.fading > 1.0 for t in h]) for h in (ours, document)])
        learnt.append(float(variance(document[-1].monitor, line.stated)[0, 0]))
    figures = {name: mean_square(e) for name, e in errors.items()}
    assert figures["ours"] < 1.05 * figures["fixed"], figures
    assert figures["document"] > 1.5 * figures["fixed"], figures
    ours_faded, document_faded = np.mean(faded, axis=0)
    assert ours_faded < 0.005
    assert document_faded > 0.3
    assert np.mean(learnt) < 0.6


# A state that jumps


def test_a_jump_is_answered_with_fading_and_not_with_noise() -> None:
    """Ten sigmas: within a dozen measurements the state is found again, and R has not learnt from it."""
    line, at = Line(0.01, 1.0), 250
    off, learnt, before, faded = [], [], [], []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        truth = line.truth(rng, 400, {at: 10.0 if seed % 2 else -10.0})
        history = line.filtered(truth + rng.normal(size=truth.shape), adaptive())
        before.append(float(variance(history[at - 1].monitor, 1.0)[0, 0]))
        learnt.append(float(variance(history[at + 40].monitor, 1.0)[0, 0]))
        off.append(float(history[at + 12].belief.x.y[0] - truth[at + 12, 0]))
        faded.append([t.fading for t in history])
    assert mean_square(off) < 1.5, off
    assert np.abs(np.array(learnt) - np.array(before)).max() < 0.4
    fading = np.array(faded)
    assert (fading[:, at : at + 12].max(axis=1) > 2.0).all()
    assert (fading[:, :at] == 1.0).mean() > 0.995


@pytest.mark.parametrize("growth", [9.0, 25.0])
def test_noise_that_grows_is_not_taken_for_a_jump(growth: float) -> None:
    line = Line(0.01, 1.0)
    faded, learnt = [], []
    for seed in range(RUNS):
        z, _ = stepped(line, seed, steps=600, growth=growth)
        history = line.filtered(z, adaptive())
        faded.append(np.mean([t.fading > 1.0 for t in history]))
        learnt.append(float(variance(history[-1].monitor, 1.0)[0, 0]))
    assert np.mean(faded) < 0.01
    assert 0.55 * growth < np.mean(learnt) < 1.35 * growth


def test_fading_can_be_switched_off() -> None:
    line = Line(0.01, 1.0)
    rng = np.random.default_rng(0)
    truth = line.truth(rng, 150, {80: 10.0})
    history = line.filtered(truth + rng.normal(size=truth.shape), adaptive(most_fading=1.0))
    assert all(t.fading == 1.0 for t in history)
