"""The sun from a sweep: accuracy, covariance, second modes, what is refused, and what is learnt."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.frames import wrap_pi
from uwgraph.sun.m_estimate import Loss
from uwgraph.sun.observation import SunFlag, level_axes, up_from_tilt
from uwgraph.sun.residual_model import ResidualModel
from uwgraph.sun.scattering import scattered_aop
from uwgraph.sun.scattering_fit import fit_sun, learn_residuals
from uwgraph.sun.sweep import Sweep

LOSSES: tuple[Loss, ...] = ("l1", "l2", "huber", "soft_l1")
AROUND = np.radians(np.arange(0.0, 360.0, 10.0))
NOISE = float(np.radians(2.0))
UP = np.array([0.0, 0.0, -1.0])
N = 1.34
DAY = 86_400 * 10**9


def sweep_of(azimuth, zenith, rng=None, views=AROUND, noise=NOISE, error=lambda relative: 0.0, **changes):
    """What a perfect camera sees; ``error`` is what the model does not know, by azimuth of the view from the sun."""
    aop = scattered_aop(azimuth, zenith, views, 0.0, N) + error(views - azimuth)
    if rng is not None:
        aop = aop + noise * rng.standard_normal(len(views))
    return replace(Sweep(views, np.zeros(len(views)), aop, np.full(len(views), noise), n=N), **changes)


def sun_b(azimuth, zenith, up_b=UP):
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]) @ level_axes(
        up_b
    )


@settings(max_examples=20, deadline=None)
@given(azimuth=st.floats(-3.1, 3.1), zenith=st.floats(0.1, 1.45), loss=st.sampled_from(LOSSES), turns=st.integers(0, 3))
def test_exact_without_noise(azimuth, zenith, loss, turns):
    sweep = sweep_of(azimuth, zenith)
    found = fit_sun(replace(sweep, aop=sweep.aop + np.pi * (np.arange(36) % (turns + 1))), loss=loss).observation
    np.testing.assert_allclose(found.s_b, sun_b(azimuth, zenith), atol=1e-6)
    assert found.method == "scattering"


@pytest.mark.parametrize("loss", LOSSES)
def test_covariance_is_that_of_the_errors(loss):
    rng = np.random.default_rng(0)
    nees, errors = [], []
    for _ in range(30):
        azimuth, zenith = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(20, 75))
        found = fit_sun(sweep_of(azimuth, zenith, rng), loss=loss, model_error=0.0).observation
        s = sun_b(azimuth, zenith)
        nees.append(s @ found.information_b @ s / 2.0)
        errors.append(found.azimuth_b - azimuth)
        assert found.ok
    assert 0.5 < np.mean(nees) < 1.4
    assert np.degrees(np.median(np.abs(wrap_pi(errors)))) < 1.0


def test_information_is_of_rank_two_along_the_sun():
    found = fit_sun(sweep_of(0.3, 0.8, np.random.default_rng(1), up_b=up_from_tilt(0.1, -0.2))).observation
    assert np.linalg.norm(found.information_b @ found.s_b) < 1e-6 * np.linalg.norm(found.information_b)
    np.testing.assert_allclose(np.linalg.pinv(found.information_b, rcond=1e-9), found.cov_b, atol=1e-12)
    np.testing.assert_allclose(found.s_b, sun_b(found.azimuth_b, np.pi / 2 - found.elevation, found.up_b), atol=1e-12)


@pytest.mark.parametrize("loss", ["l1", "huber", "soft_l1"])
def test_outlying_views(loss):
    rng = np.random.default_rng(2)
    sweep = sweep_of(1.0, 0.8, rng)
    wrong = rng.choice(36, 7, replace=False)
    aop = sweep.aop.copy()
    aop[wrong] = rng.uniform(-np.pi / 2, np.pi / 2, 7)
    found = fit_sun(replace(sweep, aop=aop), loss=loss).observation
    assert np.degrees(np.arccos(found.s_b @ sun_b(1.0, 0.8))) < 3.0
    assert found.ok


def test_model_error_and_tilt_widen_the_covariance():
    sweep = sweep_of(1.0, 0.8, np.random.default_rng(3))
    plain, wide = fit_sun(sweep, model_error=0.0).observation, fit_sun(sweep, model_error=0.2).observation
    assert np.trace(wide.cov_b) > 4.0 * np.trace(plain.cov_b)
    assert wide.azimuth_sigma == pytest.approx(plain.azimuth_sigma, rel=1e-6)
    tilted = fit_sun(replace(sweep, tilt_sigma=np.radians(2.0)), model_error=0.0).observation
    grown = np.linalg.eigvalsh(tilted.cov_b - plain.cov_b)
    assert grown.min() > -1e-12
    # (n cos w / cos a - 1) along and about (tan a - n tan w...) across, of 2 deg: below 2 deg each
    assert 0.1 < np.degrees(np.sqrt(grown[-1])) < 2.0


def test_tilt_error_is_what_the_covariance_says():
    """The same e-vectors, taken about a vertical that is wrong by 2 deg."""
    true_up, wrong_up = UP, up_from_tilt(np.radians(2.0), 0.0)
    s, n_views = sun_b(1.0, 0.9), 36
    right_sweep = sweep_of(1.0, 0.9)
    w = np.stack([np.cos(AROUND), np.sin(AROUND), np.zeros(n_views)], axis=1)
    right = np.cross(w, true_up)
    e = np.cos(right_sweep.aop)[:, None] * right + np.sin(right_sweep.aop)[:, None] * np.cross(right, w)
    sweep = Sweep.of_evectors(w, e, np.full(n_views, NOISE), wrong_up, n=N, tilt_sigma=np.radians(2.0))
    found = fit_sun(sweep, model_error=0.0).observation
    error = s - found.s_b
    assert 0.3 < np.degrees(np.linalg.norm(error)) < 2.0
    assert error @ found.information_b @ error < 4.0


def test_few_headings_leave_two_suns_or_none():
    rng = np.random.default_rng(4)
    for views in (np.radians([-5.0, 0.0, 5.0]), np.radians([0.0, 90.0, 180.0])):
        found = fit_sun(sweep_of(0.6, 0.9, rng, np.tile(views, 4))).observation
        s = sun_b(0.6, 0.9)
        assert s @ found.information_b @ s < 20.0 or not found.ok


def test_random_angles_are_refused():
    rng = np.random.default_rng(5)
    for _ in range(10):
        aop = rng.uniform(-np.pi / 2, np.pi / 2, 36)
        found = fit_sun(Sweep(AROUND, np.zeros(36), aop, np.full(36, NOISE), n=N)).observation
        assert not found.ok
        assert found.quality < 0.3


@pytest.mark.parametrize(
    ("changes", "sun_zenith", "flag"),
    [
        ({"dolp": np.full(36, 0.005)}, None, SunFlag.UNPOLARIZED),
        ({}, np.radians(95.0), SunFlag.NIGHT),
        ({}, np.radians(15.0), SunFlag.ZENITH_DISAGREES),
        ({}, 0.8, SunFlag(0)),
    ],
)
def test_flags(changes, sun_zenith, flag):
    sweep = sweep_of(1.0, 0.8, np.random.default_rng(6), **changes)
    assert fit_sun(sweep, sun_zenith=sun_zenith).observation.flags == flag


def test_sun_in_the_zenith_gives_no_heading():
    found = fit_sun(sweep_of(1.0, 0.01, np.random.default_rng(7))).observation
    assert SunFlag.NEAR_ZENITH in found.flags


@pytest.mark.parametrize(
    "sweep",
    [
        Sweep(AROUND[:2], np.zeros(2), np.zeros(2), np.ones(2)),
        Sweep(AROUND, np.zeros(36), np.full(36, np.nan), np.ones(36)),
        Sweep(AROUND, np.zeros(36), np.zeros(36), np.zeros(36)),
    ],
)
def test_unusable_sweeps(sweep):
    with pytest.raises(DataError, match="sweep"):
        fit_sun(sweep)


def learning_material(error, rng, days=4, each=7):
    sweeps, suns = [], []
    for day in range(days):
        for zenith in np.radians(np.linspace(15, 70, each)) + 0.02 * rng.standard_normal(each):
            azimuth = rng.uniform(-np.pi, np.pi)
            sweeps.append(sweep_of(azimuth, zenith, rng, error=error, t_ns=DAY * (20_000 + day) + 1))
            suns.append((azimuth, zenith))
    return sweeps, suns


def skylight(relative):
    """An error of the kind that light from the whole sky makes, in radians."""
    return np.radians(-5.0 * np.sin(relative) - 3.0 * np.sin(2.0 * relative) + 2.0 * np.cos(relative) + 1.0)


@pytest.fixture(scope="module")
def learnt():
    return learn_residuals(*learning_material(skylight, np.random.default_rng(8)))


def test_learnt_residuals_are_the_error(learnt):
    relative = np.radians(np.arange(0.0, 360.0, 15.0))
    mean, spread = learnt.predict(relative, np.full(24, 0.8))
    assert np.degrees(np.abs(mean - skylight(-relative)).max()) < 1.3
    assert np.degrees(np.sqrt(np.mean((mean - skylight(-relative)) ** 2))) < 0.6
    assert 1.0 < np.degrees(np.median(spread)) < 3.0


def test_correction_takes_the_error_away(learnt):
    rng = np.random.default_rng(9)
    nees, errors = [], {True: [], False: []}
    for _ in range(30):
        azimuth, zenith = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(20, 65))
        sweep, s = sweep_of(azimuth, zenith, rng, error=skylight), sun_b(azimuth, zenith)
        for corrected in (True, False):
            found = fit_sun(sweep, residual_model=learnt if corrected else None).observation
            errors[corrected].append(np.degrees(np.arccos(np.clip(found.s_b @ s, -1, 1))))
            if corrected:
                nees.append(s @ found.information_b @ s / 2.0)
    assert np.median(errors[True]) < 1.5
    assert np.median(errors[True]) < 0.3 * np.median(errors[False])
    assert 0.4 < np.mean(nees) < 1.5


def test_far_from_what_was_learnt_nothing_is_corrected(learnt):
    high = ResidualModel.learn(
        np.linspace(0, 6, 200), np.full(200, 0.3), np.full(200, 0.2), np.arange(200, dtype=np.intp) // 20
    )
    near, _ = high.predict(np.array([1.0]), np.array([0.3]))
    far, _ = high.predict(np.array([1.0]), np.array([1.2]))
    assert near[0] == pytest.approx(0.2, abs=0.01)
    assert abs(far[0]) < 1e-3
    assert high.sun_sigma(0.3) is None


def test_where_no_suns_were_fitted_the_model_error_stands(learnt):
    sweep = sweep_of(1.0, 0.8, np.random.default_rng(11), error=skylight)
    blind = replace(learnt, fitted_zenith=np.zeros(0), sun_errors=np.zeros((0, 2)))
    known, unknown = (fit_sun(sweep, residual_model=m).observation for m in (learnt, blind))
    np.testing.assert_array_equal(known.s_b, unknown.s_b)
    assert np.trace(unknown.cov_b) > 2.0 * np.trace(known.cov_b)


def test_learning_keeps_what_the_days_have_in_common():
    """A shift of one day only is no reason to follow single neighbours, and it widens the suns of other days."""
    rng = np.random.default_rng(10)
    sweeps, suns = learning_material(skylight, rng)
    shifted = [replace(s, aop=s.aop + np.radians(4.0) * np.sin(s.azimuth - a) * (s.t_ns // DAY % 2))
               for s, (a, _) in zip(sweeps, suns, strict=True)]  # fmt: skip
    steady, unsteady = learn_residuals(sweeps, suns), learn_residuals(shifted, suns)
    assert unsteady.sun_sigma(0.8)[1] > 1.5 * steady.sun_sigma(0.8)[1]


def test_model_is_written_and_read(learnt, tmp_path):
    learnt.save(tmp_path / "m.npz")
    again = ResidualModel.load(tmp_path / "m.npz")
    for name in ("suns", "residuals", "neighbours", "fitted_zenith", "sun_errors"):
        np.testing.assert_array_equal(getattr(again, name), getattr(learnt, name))


def test_hostile_models_are_refused(learnt, tmp_path):
    path = tmp_path / "m.npz"
    learnt.save(path)
    whole = path.read_bytes()
    arrays = dict(np.load(path))
    cases = [b"", b"no", whole[:200], whole[: len(whole) // 2]]
    for change in ({"residuals": np.zeros(3)}, {"suns": np.zeros((2, 2))}, {"neighbours": np.array(0)},
                   {"residuals": np.full_like(arrays["residuals"], np.nan)},
                   {"suns": np.array([{}], dtype=object)}):  # fmt: skip
        np.savez(path, **(arrays | change))
        cases.append(path.read_bytes())
    for case in cases:
        path.write_bytes(case)
        with pytest.raises(DataError, match=r"m\.npz"):
            ResidualModel.load(path)
    with pytest.raises(DataError):
        ResidualModel.load(tmp_path / "none.npz")


def test_too_little_to_learn_from():
    with pytest.raises(DataError, match="too few"):
        ResidualModel.learn(np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(5, dtype=np.intp))
