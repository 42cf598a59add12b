"""The metric of places: PCA, then large-margin nearest neighbours over places that are well apart."""

from __future__ import annotations

import warnings
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sklearn.decomposition import PCA
from sklearn.exceptions import ConvergenceWarning

from uwgraph.dive.rig import NonNegative, Positive, Settings
from uwgraph.errors import DataError
from uwgraph.places.labels import NO_PLACE, places_apart
from uwgraph.places.lmnn import LMNN
from uwgraph.places.lmnn_objective import factor
from uwgraph.places.metric import Metric
from uwgraph.types import FloatArray


class TrainSettings(Settings):
    """How the metric of places is learnt."""

    components: Annotated[int, Field(ge=2, le=4096)] = 64
    """Of the PCA, and length of the final descriptor; never more than half the number of images."""
    whitening: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Components are divided by the standard deviation to this power: 0 is plain PCA, 1 full whitening."""
    radius_m: Positive = 0.5
    """Images of one place are within this of its centre."""
    gap_m: Positive | None = None
    """Images of different places are further apart than this; None: half the radius."""
    draws: Annotated[int, Field(ge=0, le=1000)] = 16
    """Of places; the metric is the mean over them. 0 leaves the metric Euclidean after the PCA."""
    neighbours: Annotated[int, Field(ge=1, le=1000)] = 5
    """Target neighbours of LMNN."""
    shrinkage: NonNegative = 3.0
    """Of LMNN: what holds the metric near the PCA's, for there are few images and many directions."""
    random_state: int = 0


def train(X: NDArray[np.float32], positions: FloatArray, settings: TrainSettings | None = None) -> Metric:
    """The metric under which images of one place are near each other.

    Parameters
    ----------
    X : shape (N, D)
        Descriptors, as a describer makes them.
    positions : shape (N, 2) or (N, 3)
        Where they were taken, m.

    Raises
    ------
    DataError
        When there are fewer than eight images, fewer than two places, or positions that are not finite.
    """
    settings = settings or TrainSettings()
    if len(X) < 8 or len(positions) != len(X) or not np.all(np.isfinite(positions)) or not np.all(np.isfinite(X)):
        raise DataError(
            f"{len(X)} descriptors with {len(positions)} positions are not enough, or not finite",
            where="training of places",
            remedy="give eight images with descriptors and known positions, or many more",
        )
    reduced = _reduction(X, settings)
    Y = reduced.project(X)
    L = _mean_metric(Y, positions, settings) if settings.draws else np.eye(reduced.size)
    return _in_margins(Metric(reduced.mean, reduced.components, L), X, positions, settings)


def _reduction(X: NDArray[np.float32], settings: TrainSettings) -> Metric:
    """PCA, partly whitened."""
    count = min(settings.components, len(X) // 2, X.shape[1])
    pca = PCA(count, svd_solver="full").fit(X)
    variance = np.maximum(pca.explained_variance_, 1e-6 * pca.explained_variance_[0])
    if not variance[0] > 0.0:
        raise DataError("all descriptors are the same", where="training of places", remedy="give images of many places")
    scale = variance ** (-0.5 * settings.whitening)
    return Metric(pca.mean_.astype(np.float32), (pca.components_ * scale[:, None]).astype(np.float32), np.eye(count))


def _mean_metric(Y: FloatArray, positions: FloatArray, settings: TrainSettings) -> FloatArray:
    """L of the mean of the metrics M = L^T L that draws of places teach, each of trace 1."""
    rng = np.random.default_rng(settings.random_state)
    gap = settings.gap_m if settings.gap_m is not None else 0.5 * settings.radius_m
    total, learnt = np.zeros((Y.shape[1], Y.shape[1])), 0
    for _ in range(settings.draws):
        labels = places_apart(positions, settings.radius_m, gap, rng)
        if labels.max() < 1:
            continue
        M = _learnt(Y[labels != NO_PLACE], labels[labels != NO_PLACE], settings)
        total += M / np.trace(M)
        learnt += 1
    if not learnt:
        raise DataError(
            f"there are no two places of {settings.radius_m:g} m with two images each and a gap between them",
            where="training of places",
            remedy="give images of a longer way, or a smaller radius",
        )
    return factor(total / learnt)


def _learnt(Y: FloatArray, labels: NDArray[np.intp], settings: TrainSettings) -> FloatArray:
    lmnn = LMNN(n_neighbors=settings.neighbours, shrinkage=settings.shrinkage, init="identity", random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a step more or less does not matter to the mean
        L = lmnn.fit(Y, labels).components_
    return np.asarray(L.T @ L)


def _in_margins(metric: Metric, X: NDArray[np.float32], positions: FloatArray, settings: TrainSettings) -> Metric:
    """The metric in such a unit that of 20 images one has an image of another place nearer than 1."""
    Z = metric.project(X)
    nearest = np.full(len(Z), np.inf)
    for i in range(len(Z)):
        other = np.linalg.norm(positions - positions[i], axis=1) > 2.0 * settings.radius_m
        if other.any():
            nearest[i] = np.min(np.sum((Z[other] - Z[i]) ** 2, axis=1))
    finite = nearest[np.isfinite(nearest) & (nearest > 0.0)]
    if not len(finite):
        return metric
    return Metric(metric.mean, metric.components, metric.L / np.sqrt(np.percentile(finite, 5.0)))
