"""LMNN as people use it: scikit-learn's own checks, hard input, what it is for."""

import io

import joblib
import numpy as np
import pytest
from sklearn.base import clone
from sklearn.datasets import load_digits, load_iris, load_wine, make_blobs, make_moons
from sklearn.decomposition import PCA
from sklearn.exceptions import ConvergenceWarning, NotFittedError
from sklearn.model_selection import GridSearchCV, StratifiedShuffleSplit, cross_val_score
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from uwgraph.places.lmnn import LMNN

SOLVERS = ("lbfgs", "projected")


def squared(A):
    return ((A[:, None] - A[None]) ** 2).sum(axis=-1)


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore:LMNN:UserWarning")
@parametrize_with_checks([LMNN(), LMNN(solver="projected")])
def test_scikit_learn_checks(estimator, check):
    check(estimator)


def test_grid_search_in_a_pipeline():
    X, y = load_iris(return_X_y=True)
    pipeline = make_pipeline(StandardScaler(), LMNN(), KNeighborsClassifier(3))
    search = GridSearchCV(pipeline, {"lmnn__n_components": [2, None], "lmnn__shrinkage": [0.1, 1.0]}, cv=3).fit(X, y)
    assert search.best_score_ > 0.94
    assert search.best_estimator_[:2].get_feature_names_out()[0] == "lmnn0"


def test_clone_and_joblib_keep_what_was_learned():
    X, y = load_iris(return_X_y=True)
    fitted = LMNN(n_components=2).fit(X, y)
    file = io.BytesIO()
    joblib.dump(fitted, file)
    file.seek(0)
    np.testing.assert_array_equal(joblib.load(file).transform(X), fitted.transform(X))
    with pytest.raises(NotFittedError):
        clone(fitted).transform(X)
    np.testing.assert_array_equal(clone(fitted).fit(X, y).components_, fitted.components_)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("load", [load_iris, load_wine])
def test_the_objective_never_rises(load, solver):
    X, y = load(return_X_y=True)
    fitted = LMNN(solver=solver, max_iter=300).fit(StandardScaler().fit_transform(X), y)
    assert len(fitted.objective_) == fitted.n_iter_ + 1
    assert np.all(np.diff(fitted.objective_) <= 0.0)
    assert fitted.objective_[-1] < 0.95 * fitted.objective_[0]


@pytest.mark.parametrize(
    ("load", "shrinkage", "tolerance"), [(load_iris, 0.0, 1e-3), (load_wine, 1.0, 2e-3), (load_wine, 0.1, 1e-2)]
)
def test_both_solvers_come_to_the_same_optimum(load, shrinkage, tolerance):
    X, y = load(return_X_y=True)
    X = StandardScaler().fit_transform(X)
    ends = [LMNN(solver=s, shrinkage=shrinkage, max_iter=1000, tol=1e-6).fit(X, y).objective_[-1] for s in SOLVERS]
    assert ends[0] == pytest.approx(ends[1], rel=tolerance)


def test_shrinkage_holds_the_metric_at_the_start():
    X, y = load_wine(return_X_y=True)
    X = StandardScaler().fit_transform(X)
    changes = []
    for shrinkage in (0.1, 1.0, 10.0, 1e4):
        L = LMNN(shrinkage=shrinkage).fit(X, y).components_
        M = L.T @ L
        changes.append(np.linalg.norm(M / np.trace(M) * 13 - np.eye(13)))
    assert np.all(np.diff(changes) < 0.0)
    assert changes[-1] < 0.01


def test_the_learned_metric_has_unit_margin_in_the_units_of_the_data():
    """``objective_`` is the equation's value at ``components_`` on the raw data, brute force."""
    X, y = load_iris(return_X_y=True)
    X = 1e4 * X + 1e6
    fitted = LMNN(n_neighbors=2, push_weight=0.3, shrinkage=0.0).fit(X, y)
    raw, d = squared(X), squared(fitted.transform(X))
    pull, push = 0.0, 0.0
    for i in range(len(X)):
        same = np.flatnonzero(y == y[i])
        for j in same[np.argsort(raw[i, same])][1:3]:
            pull += d[i, j]
            push += np.maximum(1.0 + d[i, j] - d[i, y != y[i]], 0.0).sum()
    assert 0.7 * pull + 0.3 * push == pytest.approx(fitted.objective_[-1], rel=0.02)  # equally near targets


@pytest.mark.parametrize("solver", SOLVERS)
def test_units_places_and_axes_of_the_data_do_not_matter(solver):
    X, y = make_blobs(90, 4, centers=3, cluster_std=3.0, random_state=1)
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    plain, moved = (LMNN(solver=solver, tol=1e-6, max_iter=1000) for _ in range(2))
    d = squared(plain.fit_transform(X, y))
    np.testing.assert_allclose(
        squared(moved.fit_transform(1e-5 * X @ R.T + 3.0, y)), d, rtol=0.02, atol=0.02 * d.mean()
    )
    assert moved.objective_[-1] == pytest.approx(plain.objective_[-1], rel=1e-3)


def test_nuisance_directions_are_suppressed():
    """The classes lie in two directions, ten times weaker than the other eight; without shrinkage these go."""
    rng = np.random.default_rng(3)
    y = rng.integers(4, size=400)
    signal = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])[y] + 0.3 * rng.normal(size=(400, 2))
    X = np.hstack([signal, 10.0 * rng.normal(size=(400, 8))]) @ np.linalg.qr(rng.normal(size=(10, 10)))[0]
    train, test = np.arange(250), np.arange(250, 400)
    scores = [
        make_pipeline(front, KNeighborsClassifier(3)).fit(X[train], y[train]).score(X[test], y[test])
        for front in ("passthrough", LMNN(shrinkage=0.0))
    ]
    assert scores[0] < 0.5
    assert scores[1] > 0.97


def test_digits_among_noise():
    X, y = load_digits(return_X_y=True)
    X = np.hstack([X, np.random.default_rng(0).normal(scale=8.0, size=(len(X), 20))])
    train, test = next(StratifiedShuffleSplit(1, test_size=0.3, random_state=11).split(X, y))
    scores = [
        make_pipeline(front, KNeighborsClassifier(3)).fit(X[train], y[train]).score(X[test], y[test])
        for front in ("passthrough", LMNN())
    ]
    assert scores[0] < 0.95
    assert scores[1] > 0.97


def test_low_rank_has_as_many_rows_as_asked_for():
    X, y = load_wine(return_X_y=True)
    for solver in SOLVERS:
        assert LMNN(3, solver=solver).fit(StandardScaler().fit_transform(X), y).transform(X).shape == (len(X), 3)


def test_more_features_than_samples():
    rng = np.random.default_rng(0)
    y = np.arange(40) % 4
    X = rng.normal(size=(40, 300)) + 2.0 * rng.normal(size=(4, 300))[y]
    assert LMNN().fit(X, y).components_.shape == (40, 300)
    assert LMNN(init="identity").fit(X, y).components_.shape == (300, 300)
    with pytest.raises(ValueError, match="n_components=41 is more than 40"):
        LMNN(41).fit(X, y)


@pytest.mark.parametrize("solver", SOLVERS)
def test_separated_classes_without_impostors(solver):
    X, y = make_blobs(60, 3, centers=[[0, 0, 0], [1000, 0, 0]], random_state=0)
    fitted = LMNN(solver=solver, max_iter=500).fit(X, y)
    assert np.all(np.isfinite(fitted.components_))
    assert KNeighborsClassifier(1).fit(fitted.transform(X), y).score(fitted.transform(X), y) == 1.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_duplicates_constants_and_small_classes(solver):
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.normal(size=(30, 3)), np.full(30, 7.0)])
    X = np.vstack([X, X[:10], X[:3]])
    y = np.concatenate([np.arange(30) % 3, np.arange(10) % 3, [0, 0, 9]])  # a class of one, contradicting labels
    fitted = LMNN(solver=solver, n_neighbors=1, max_iter=500).fit(X, y)
    assert np.all(np.isfinite(fitted.components_))
    assert np.all(np.diff(fitted.objective_) <= 0.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_class_a_single_point_many_times(solver):
    X, y = np.repeat(np.eye(3) * 1e-3, 5, axis=0), np.repeat([0, 1, 2], 5)
    fitted = LMNN(solver=solver).fit(X, y)
    d = squared(fitted.transform(np.eye(3) * 1e-3))
    assert d[~np.eye(3, dtype=bool)].min() > 0.7  # little is left of the margin of 1


def test_all_points_alike():
    fitted = LMNN().fit(np.ones((6, 2)), [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(fitted.components_ / fitted.components_[0, 0], np.eye(2))


@pytest.mark.parametrize(("y", "message"), [([1, 1, 1, 1], "one class"), ([0, 1, 2, 3], "no class with two samples")])
def test_nothing_to_learn(y, message):
    X = np.random.default_rng(0).normal(size=(4, 2))
    with pytest.warns(UserWarning, match=message):
        fitted = LMNN(init="identity").fit(X, y)
    np.testing.assert_array_equal(fitted.components_, np.eye(2))
    assert fitted.n_iter_ == 0


def test_an_outlier_and_wild_units_stay_finite():
    X, y = make_blobs(60, 3, centers=3, random_state=0)
    X[0] *= 1e8
    X *= [1e-9, 1.0, 1e6]
    fitted = LMNN(max_iter=500).fit(X, y)
    assert np.all(np.isfinite(fitted.components_))
    assert np.all(np.diff(fitted.objective_) <= 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(bad):
    X = np.random.default_rng(0).normal(size=(10, 2))
    X[3, 1] = bad
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        LMNN().fit(X, np.arange(10) % 2)


NONSENSE = [{"n_neighbors": 0}, {"push_weight": 0.0}, {"push_weight": 1.5}, {"solver": "x"}, {"shrinkage": -1.0},
            {"init": "y"}, {"init": np.eye(3)}, {"max_iter": 0}, {"n_components": 3}]  # fmt: skip


@pytest.mark.parametrize("settings", NONSENSE)
def test_settings_that_make_no_sense_are_refused(settings):
    X = np.random.default_rng(0).normal(size=(10, 2))
    with pytest.raises(ValueError, match=next(iter(settings))):
        LMNN(**settings).fit(X, np.arange(10) % 2)


def test_starting_from_a_matrix():
    X, y = load_iris(return_X_y=True)
    fitted = LMNN(tol=1e-6).fit(X, y)
    again = LMNN(init=fitted.components_, shrinkage=0.0, max_iter=3, tol=0.0)
    with pytest.warns(ConvergenceWarning, match="max_iter=3"):
        again.fit(X, y)
    assert again.objective_[0] <= fitted.objective_[-1]


def test_callback_and_verbose_tell_every_iteration(capsys):
    X, y = load_iris(return_X_y=True)
    seen = []
    fitted = LMNN(callback=lambda L, i: seen.append((i, L)), verbose=1).fit(X, y)
    assert [i for i, _ in seen] == list(range(1, fitted.n_iter_ + 1))
    np.testing.assert_allclose(seen[-1][1], fitted.components_)
    assert len(capsys.readouterr().out.splitlines()) == fitted.n_iter_


def test_low_rank_finds_what_a_pca_leaves_out() -> None:
    """Two moons beside ten columns of nuisance, each larger than they: two components of a PCA hold no signal."""
    X, y = make_moons(300, noise=0.1, random_state=0)
    X = np.c_[X, np.random.default_rng(0).normal(0.0, 1.5, (300, 10))]
    learnt = make_pipeline(LMNN(2), KNeighborsClassifier(3))
    reduced = make_pipeline(PCA(2), KNeighborsClassifier(3))
    assert cross_val_score(learnt, X, y, cv=3).mean() > cross_val_score(reduced, X, y, cv=3).mean() + 0.15
