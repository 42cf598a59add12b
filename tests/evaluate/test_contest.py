"""Several estimators on one dive, each in a process of its own: the same questions, and nobody takes others along."""

from __future__ import annotations

import math
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
from contests import innovations
from own_estimators import BAD

from uwgraph.dive import Dive
from uwgraph.errors import ConfigError, InitialisationError, SolveError
from uwgraph.evaluate.contest import common_stamps, run_contest
from uwgraph.evaluate.contest_output import comparison
from uwgraph.evaluate.entries import Contest
from uwgraph.evaluate.nis import nis_metrics
from uwgraph.filters import ESTIMATORS, Estimate, EstimatorSettings, FilterSettings, Named, task_of
from uwgraph.graph import SmoothSettings
from uwgraph.plain import json_values
from uwgraph.simulate import SimulationSettings, simulate

SETTINGS = EstimatorSettings(filter=FilterSettings(samples_per_step=4))
GOOD = ("dr", "eskf", "smooth")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate(SimulationSettings(duration_s=40.0, imu_rate_hz=50.0, surface_time_s=5.0), 0)


@pytest.fixture(scope="module")
def told() -> list[tuple[str, float]]:
    return []


@pytest.fixture(scope="module")
def contest(dive: Dive, told: list[tuple[str, float]]) -> Contest:
    """Good ones between bad ones, two at a time."""
    names = ["dr", "killed", "eskf", "stumbles", "diverges", "smooth", "dr"]
    return run_contest(
        dive, names, SETTINGS, title="made up", jobs=2, own=BAD, progress=lambda what, share: told.append((what, share))
    )


def test_each_is_listed_once_in_the_order_asked_for(contest: Contest) -> None:
    assert tuple(entry.name for entry in contest.entries) == GOOD
    assert [entry.title for entry in contest.entries] == [ESTIMATORS[name].title for name in GOOD]
    assert contest.title == "made up"


def test_who_fails_says_why_and_harms_nobody(contest: Contest) -> None:
    assert list(contest.failed) == ["killed", "stumbles", "diverges"]
    assert "signal 9" in contest.failed["killed"]
    assert "memory" in contest.failed["killed"]
    assert contest.failed["stumbles"] == "ZeroDivisionError: by zero"
    assert "diverged" in contest.failed["diverges"]
    assert not multiprocessing.active_children()


def test_all_answer_at_the_same_stamps_of_the_reference(contest: Contest, dive: Dive) -> None:
    stamps = common_stamps(dive, SETTINGS)
    assert dive.reference is not None
    assert np.isin(stamps, dive.reference.t_ns).all()
    for entry in contest.entries:
        np.testing.assert_array_equal(entry.judged.solution.t_ns, stamps)
        assert entry.judged.metrics["matched"] == len(stamps)


def test_a_process_of_its_own_changes_no_result(contest: Contest, dive: Dive) -> None:
    task = task_of(dive, t_ns=common_stamps(dive, SETTINGS))
    for entry in contest.entries:
        here = ESTIMATORS[entry.name].run(task, SETTINGS, lambda what, share: None)
        np.testing.assert_allclose(entry.judged.solution.p_n, here.solution.p_n, atol=1e-9)
        np.testing.assert_allclose(entry.judged.solution.R_nb, here.solution.R_nb, atol=1e-9)


def test_figures(contest: Contest) -> None:
    figures = {entry.name: entry.judged.metrics for entry in contest.entries}
    for name in GOOD:
        assert 0.0 < figures[name]["runtime_s"] < 60.0
        assert 50.0 < figures[name]["memory_mb"] < 4000.0
        assert figures[name]["horizontal_rmse_m"] >= 0.0
        assert figures[name]["heading_rmse_deg"] >= 0.0
    assert figures["dr"]["nees_position"] is None or math.isnan(figures["dr"]["nees_position"])
    assert 0.0 < figures["eskf"]["nees_position"] < 6.0
    for kind in ("dvl", "depth", "sun", "fixes"):
        assert figures["eskf"][f"measurements_{kind}"] > 10
        assert figures["eskf"][f"refused_{kind}"] == 0
        assert figures["eskf"][f"nis_{kind}"] == pytest.approx(1.0, abs=0.6)
        assert figures["eskf"][f"noise_{kind}"] == 1.0
        assert f"nis_{kind}" not in figures["dr"]


def test_the_comparison_is_plain_and_whole(contest: Contest) -> None:
    plain = json_values(comparison(contest))
    assert set(plain["estimators"]) == set(GOOD)
    assert plain["failed"] == dict(contest.failed)
    assert plain["simulated"]
    assert plain["estimators"]["eskf"]["title"] == "error-state Kalman filter"
    assert isinstance(plain["estimators"]["smooth"]["rpe"], list)


def test_progress_is_told_and_grows(contest: Contest, told: list[tuple[str, float]]) -> None:
    assert told[0] == ("reading the streams", 0.0)
    assert told[-1] == ("judging", 1.0)
    assert any(what.startswith("eskf: ") for what, _ in told)
    shares = [share for what, share in told if ":" in what]
    assert 0.0 <= min(shares) <= max(shares) <= 1.0


# What cannot be run


def test_an_unknown_estimator_is_named_with_those_there_are(dive: Dive) -> None:
    with pytest.raises(ConfigError, match="no estimator 'kalman'") as failure:
        run_contest(dive, ["dr", "kalman"])
    assert "ukf" in str(failure.value)
    with pytest.raises(ConfigError):
        run_contest(dive, [])


def test_an_estimator_that_no_other_process_finds_is_refused(dive: Dive) -> None:
    own = {"mine": Named("mine", True, lambda task, settings, progress: Estimate(None))}  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="does not find the estimator 'mine'"):
        run_contest(dive, ["mine"], own=own)


def test_when_nobody_has_a_result_it_is_an_error(dive: Dive) -> None:
    with pytest.raises(SolveError, match=r"leaves: .* status 3") as failure:
        run_contest(dive, ["leaves", "refuses"], SETTINGS, jobs=2, own=BAD)
    assert "refuses: x7: the matrix is singular" in str(failure.value)


def test_a_dive_without_any_heading_is_refused_at_once(dive: Dive) -> None:
    with pytest.raises(InitialisationError, match="heading"):
        run_contest(replace(dive, sun=None, fixes=None, heading=None, reference=None), ["dr"])


def test_without_a_reference_the_sigmas_are_told(dive: Dive) -> None:
    settings = EstimatorSettings(smooth=SmoothSettings(heading_deg=30.0))
    contest = run_contest(replace(dive, reference=None, sun=None), ["eskf"], settings)
    figures = contest.entries[0].judged.metrics
    assert "horizontal_rmse_m" not in figures
    assert figures["sigma"]["heading_deg"]["final"] > 0.0
    assert figures["nis_dvl"] > 0.0


# Innovations as figures


def test_nis_is_that_of_the_measurements_used() -> None:
    seen = innovations(np.arange(500) * 1_000_000_000)
    figures = nis_metrics(seen)
    for kind, dof in (("dvl", 3), ("depth", 1)):
        of_kind = seen.select(seen.kind == kind)
        assert figures[f"measurements_{kind}"] == 500
        assert figures[f"refused_{kind}"] == int((~of_kind.accepted).sum())
        used = of_kind.nis[of_kind.accepted]
        assert figures[f"nis_{kind}"] == pytest.approx(used.mean())
        low, high = figures[f"nis_{kind}_95"]
        assert low < figures[f"nis_{kind}"] < high
        assert high - low == pytest.approx(2.0 * 1.96 * math.sqrt(2.0 / (dof * len(used))), rel=0.02)
        assert figures[f"noise_{kind}"] == 1.0


def test_a_sensor_of_which_all_is_refused_has_no_nis() -> None:
    seen = innovations(np.arange(20) * 1_000_000_000)
    figures = nis_metrics(replace(seen, accepted=np.zeros(len(seen), dtype=np.bool_)))
    assert figures["refused_dvl"] == figures["measurements_dvl"] == 20
    assert "nis_dvl" not in figures
    assert nis_metrics(None) == {}
