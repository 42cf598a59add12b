"""The metric of places: large-margin nearest neighbours over places that are well apart."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.distance import cdist
from sklearn.exceptions import ConvergenceWarning

from uwgraph.dive.rig import NonNegative, Positive, Settings
from uwgraph.errors import DataError
from uwgraph.places.labels import NO_PLACE, places_apart
from uwgraph.places.lmnn import LMNN
from uwgraph.places.metric import Metric, principal_components, symmetric_root
from uwgraph.types import FloatArray

MAX_IMAGES: Final = 4_000
"""Of more images every second, third, ... is used."""


class TrainSettings(Settings):
    """How the metric of places is learnt."""

    components: Annotated[int, Field(ge=2, le=1024)] = 128
    """Principal axes of the images along which the metric is learnt."""
    radius_m: Positive = 1.0
    """Images of one place are within this of its centre."""
    gap_m: Positive | None = None
    """Images of different places are further apart than this; None: as the radius."""
    draws: Annotated[int, Field(ge=1, le=1000)] = 8
    """Of places; the metric is the mean over them."""
    neighbours: Annotated[int, Field(ge=1, le=1000)] = 5
    """Target neighbours of LMNN."""
    shrinkage: NonNegative = 3.0
    """Of LMNN: what holds the metric near the Euclidean one, for there are few images and many directions."""
    strength: Annotated[float, Field(ge=0, le=1)] = 0.6
    """Share of the learnt metric; the rest is Euclidean. 0 learns nothing."""
    random_state: int = 0


def train(
    X: NDArray[np.float32], positions: FloatArray, settings: TrainSettings | None = None, *, or_plain: bool = False
) -> Metric:
    """The metric under which images of one place are near each other.

    Parameters
    ----------
    X : shape (N, D)
        Descriptors, as a describer makes them.
    positions : shape (N, 2) or (N, 3)
        Where they were taken, m.
    or_plain : bool
        Where there are too few images or no two places apart, the Euclidean metric is kept.

    Raises
    ------
    DataError
        When there are fewer than eight images, no two places apart, or numbers that are not finite.
    """
    settings = settings or TrainSettings()
    few = len(X) < 8
    if not len(X) or (few and not or_plain) or len(positions) != len(X) or not _finite(X) or not _finite(positions):
        raise DataError(
            f"{len(X)} descriptors with {len(positions)} positions are not enough, or not finite",
            where="training of places",
            remedy="give at least eight images that have a descriptor and a known position",
        )
    every = -(-len(X) // MAX_IMAGES)
    X, positions = X[::every], positions[::every]
    mean, components = principal_components(X, settings.components)
    if not len(components) and not or_plain:
        raise DataError("all descriptors are the same", where="training of places", remedy="give images of many places")
    U = ((X - mean) @ components.T).astype(np.float64)
    M = None if few or not len(components) else _mean_metric(U, positions, settings)
    if M is None and not or_plain:
        raise DataError(
            f"no two places of radius {settings.radius_m:g} m with two images each, well apart",
            where="training of places",
            remedy="give images of a longer way, or a smaller radius",
        )
    change = np.zeros(2 * [len(components)]) if M is None else _part_of(M, settings.strength)
    return _with_gate(Metric(mean, components, change.astype(np.float32), 1.0), X, positions, settings)


def _finite(x: NDArray[np.floating]) -> bool:
    return bool(np.all(np.isfinite(x)))


def _part_of(M: FloatArray, strength: float) -> FloatArray:
    """S - I for the mean of the Euclidean metric and M, which counts as ``strength``."""
    eye = np.eye(len(M))
    return symmetric_root((1.0 - strength) * eye + strength * M) - eye


def _mean_metric(U: FloatArray, positions: FloatArray, settings: TrainSettings) -> FloatArray | None:
    """Mean of the metrics M that draws of places teach, each of mean eigenvalue 1; (P, P); None without places."""
    rng = np.random.default_rng(settings.random_state)
    gap = settings.gap_m if settings.gap_m is not None else settings.radius_m
    learnt = []
    for _ in range(settings.draws):
        labels = places_apart(positions, settings.radius_m, gap, rng)
        if labels.max() > 0:
            learnt.append(_learnt(U[labels != NO_PLACE], labels[labels != NO_PLACE], settings))
    return np.asarray(np.mean(learnt, axis=0)) if learnt else None


def _learnt(U: FloatArray, labels: NDArray[np.intp], settings: TrainSettings) -> FloatArray:
    lmnn = LMNN(n_neighbors=settings.neighbours, shrinkage=settings.shrinkage, init="identity", max_iter=50)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # an iteration more or less does not matter to the mean
        L = lmnn.fit(U, labels).components_
    M = L.T @ L
    return np.asarray(M * (len(M) / np.trace(M)))


def _with_gate(metric: Metric, X: NDArray[np.float32], positions: FloatArray, settings: TrainSettings) -> Metric:
    """The metric in such a unit that one image of twenty has one of another place nearer than 1."""
    Z = metric.project(X)
    other = cdist(positions, positions) > 2.0 * settings.radius_m
    nearest = np.min(2.0 - 2.0 * (Z @ Z.T), axis=1, where=other, initial=np.inf)  # z has unit length
    nearest = nearest[np.isfinite(nearest)]
    gate = float(np.percentile(nearest, 5.0)) if len(nearest) else 1.0
    return replace(metric, scale=1.0 / np.sqrt(max(gate, 1e-6)))
