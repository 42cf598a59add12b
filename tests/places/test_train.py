"""Learning the metric: it finds what has nothing to do with the place, and leaves the rest alone."""

from __future__ import annotations

import numpy as np
import pytest

from uwgraph.errors import DataError
from uwgraph.places import train as training
from uwgraph.places.metric import Metric
from uwgraph.places.train import TrainSettings, train

D = 60
QUICK = TrainSettings(draws=4, components=24)


def survey(seed: int, nuisance: float, passes: int = 3, length: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along a way that is gone several times, an image a metre, and their positions.

    What they show varies along the way; in four directions they vary with the light, which is another every time.
    """
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.arange(length) + rng.uniform(-0.2, 0.2, length) for _ in range(passes)])
    frequency, phase = rng.normal(size=40), rng.uniform(0, 2 * np.pi, 40)
    scene = np.sin(x[:, None] * frequency + phase) @ rng.normal(size=(40, D)) / np.sqrt(40)
    light = rng.normal(size=(len(x), 4)) @ np.linalg.qr(rng.normal(size=(D, 4)))[0].T * np.sqrt(D / 4)
    X = 1.0 + scene + nuisance * light + 0.4 * rng.normal(size=(len(x), D))
    return (X / np.linalg.norm(X, axis=1, keepdims=True)).astype(np.float32), np.stack([x, 0.0 * x], axis=1)


def recall(z: np.ndarray, p: np.ndarray, queries: int) -> float:
    """Share of the last ``queries`` images whose nearest among the others is within half a metre."""
    database, asked = slice(0, -queries), slice(-queries, None)
    near = np.argmin(((z[asked, None] - z[None, database]) ** 2).sum(2), axis=1)
    return float(np.mean(np.linalg.norm(p[database][near] - p[asked], axis=1) < 0.5))


@pytest.fixture(scope="module")
def surveyed() -> tuple[np.ndarray, np.ndarray]:
    return survey(0, 0.5)


def recalls(nuisance: float) -> tuple[np.ndarray, np.ndarray]:
    """Euclidean and learnt, of the last pass, which nobody trained on; of five surveys."""
    made = []
    for seed in range(5):
        X, p = survey(seed, nuisance)
        metric = train(X[:-40], p[:-40], QUICK)
        made.append((recall(X, p, 40), recall(metric.project(X), p, 40)))
    plain, learnt = np.transpose(made)
    return plain, learnt


def test_it_is_clearly_better_where_the_light_dominates() -> None:
    plain, learnt = recalls(1.0)
    assert learnt.mean() > plain.mean() + 0.1
    assert np.all(learnt > plain)


@pytest.mark.parametrize("nuisance", [0.0, 0.3])
def test_it_is_no_worse_where_there_is_little_to_learn(nuisance: float) -> None:
    plain, learnt = recalls(nuisance)
    assert learnt.mean() >= plain.mean() - 0.02, "of 200 queries"


def test_places_that_nobody_trained_on_stay_apart() -> None:
    """Those of the second half of the way, whose scene the first does not have."""
    X, p = survey(1, 1.0, passes=4, length=80)
    taught = p[:, 0] < 38.0
    z, others = train(X[taught], p[taught], QUICK).project(X), p[:, 0] > 42.0
    assert recall(z[others], p[others], 30) >= recall(X[others], p[others], 30)


def test_the_light_is_what_the_metric_shortens() -> None:
    rng = np.random.default_rng(0)
    X, p = survey(3, 0.0)
    light = np.linalg.qr(rng.normal(size=(D, 1)))[0].T
    X += (0.3 * rng.normal(size=(len(X), 1)) @ light).astype(np.float32)
    metric = train(X, p, QUICK)
    along = metric.components @ light[0]
    changed = along @ metric.change @ along / (along @ along)
    assert changed < -0.15
    assert changed < np.trace(metric.change) / len(along) - 0.1


def test_it_is_the_same_again_and_euclidean_where_nothing_is_to_be_learnt(surveyed) -> None:
    once, twice = train(*surveyed, QUICK), train(*surveyed, QUICK)
    for name in ("mean", "components", "change", "scale"):
        np.testing.assert_array_equal(getattr(once, name), getattr(twice, name))
    plain = train(*surveyed, QUICK.model_copy(update={"strength": 0.0}))
    np.testing.assert_allclose(plain.change, 0.0, atol=1e-6)
    np.testing.assert_allclose(plain.project(surveyed[0]), plain.scale * surveyed[0], rtol=1e-4, atol=1e-5)


def test_of_twenty_images_one_has_another_place_nearer_than_one(surveyed) -> None:
    X, p = surveyed
    z = train(X, p, QUICK).project(X).astype(float)
    square = ((z[:, None] - z) ** 2).sum(axis=2)
    square[np.linalg.norm(p[:, None] - p, axis=2) <= 2.0 * QUICK.radius_m] = np.inf
    assert np.mean(square.min(axis=1) < 1.0) == pytest.approx(0.05, abs=1.0 / len(X))


def test_of_too_many_images_every_second_is_used(surveyed, monkeypatch: pytest.MonkeyPatch) -> None:
    X, p = surveyed
    monkeypatch.setattr(training, "MAX_IMAGES", 60)
    thinned = train(X, p, QUICK)
    np.testing.assert_array_equal(thinned.change, train(X[::2], p[::2], QUICK).change)


def test_few_images_are_enough() -> None:
    X, p = survey(0, 0.1, passes=2, length=4)
    assert isinstance(train(X, p), Metric)


def with_nan(x: np.ndarray) -> np.ndarray:
    bad = x.copy()
    bad[5, 1] = np.nan
    return bad


REFUSED = {
    "too few": (lambda X, p: (X[:7], p[:7]), "not enough"),
    "none": (lambda X, p: (X[:0], p[:0]), "not enough"),
    "unlike numbers": (lambda X, p: (X, p[:-1]), "not enough"),
    "X is NaN": (lambda X, p: (with_nan(X), p), "not finite"),
    "p is NaN": (lambda X, p: (X, with_nan(p)), "not finite"),
    "one place": (lambda X, p: (X, 0.01 * p), "no two places of radius 1 m"),
    "each once": (lambda X, p: (X[:40], 10.0 * p[:40]), "two images each"),
    "the same": (lambda X, p: (np.repeat(X[:1], len(X), axis=0), p), "all descriptors are the same"),
    "zeros": (lambda X, p: (0.0 * X, p), "all descriptors are the same"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_teaches_nothing_is_refused(surveyed, name: str) -> None:
    change, message = REFUSED[name]
    with pytest.raises(DataError, match=message) as refused:
        train(*change(*surveyed), QUICK)
    assert refused.value.remedy


@pytest.mark.parametrize(
    "positions",
    [np.arange(20.0)[:, None] * [30.0, 0.0], np.zeros((20, 2)), np.arange(3.0)[:, None] * [30.0, 0.0]],
    ids=["nothing seen twice", "one place", "three images"],
)
def test_without_places_the_euclidean_metric_is_kept_where_that_is_wanted(positions):
    X = np.random.default_rng(0).normal(size=(len(positions), 40)).astype(np.float32)
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    with pytest.raises(DataError):
        train(X, positions)
    Z = train(X, positions, or_plain=True).project(X)
    near, far = np.linalg.norm(X[0] - X, axis=1), np.linalg.norm(Z[0] - Z, axis=1)
    np.testing.assert_allclose(far, far[1] / near[1] * near, rtol=1e-5, atol=1e-5)


def test_images_all_alike_keep_the_euclidean_metric_where_that_is_wanted():
    X = np.tile(np.eye(1, 30, dtype=np.float32), (10, 1))
    metric = train(X, np.arange(20.0).reshape(10, 2), or_plain=True)
    assert np.all(np.isfinite(metric.project(X)))
