"""Large-margin nearest neighbours: a linear transformation under which k-NN finds the right class.

Points are pulled to their nearest neighbours of the same class, and points of other classes are pushed out of the
neighbourhood by a margin (Weinberger and Saul, JMLR 10, 2009, 207-244). All distances are squared, the margin is 1.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.decomposition import PCA
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import Tags, check_array
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from uwgraph.places import lmnn_solvers
from uwgraph.places.lmnn_impostors import IndexArray, class_starts, squared_distances, target_neighbours
from uwgraph.places.lmnn_objective import Objective
from uwgraph.types import FloatArray


class LMNN(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Large-margin nearest neighbours, a metric learned from labels.

    The data are centred and scaled inside; any unit will do. Features of unlike units are scaled before
    (StandardScaler), and many hundreds of features are better reduced before (PCA): with more features than samples
    the classes can be told apart by chance.

    Parameters
    ----------
    n_components : int, default=None
        Rows of L. None: all features (with ``init="pca"`` no more than there are samples).
    n_neighbors : int, default=5
        Target neighbours of each point: the nearest of its class at the start. Smaller classes have fewer.
    push_weight : float, default=0.3
        mu, in (0, 1]: pushing impostors away weighs mu, pulling target neighbours near 1 - mu.
    shrinkage : float, default=1.0
        Weight of |M - M_0|^2 / |M_0|^2 per sample, which holds the metric M = L^T L near that of the start; 0 is the
        published objective. Where most of the variance has nothing to do with the class, take less.
    init : {"pca", "identity"} or array of shape (n_components, n_features), default="pca"
        L at the start, up to a factor that is found.
    solver : {"lbfgs", "projected"}, default="lbfgs"
        L-BFGS on L, or projected gradient on M, which is convex but can end at a kink, a little higher; of M the
        n_components largest directions are kept.
    max_iter : int, default=100
    tol : float, default=1e-4
        Relative fall of the objective (in an iteration, or in five of the projected gradient) at which the solver ends.
    callback : callable, default=None
        Called as ``callback(L, iteration)`` after every iteration.
    verbose : int, default=0
        Above 0 the objective is printed at every iteration.
    random_state : int or RandomState, default=None
        For PCA, which is randomised on large data.

    Attributes
    ----------
    components_ : ndarray of shape (n_components, n_features)
        L; ``transform`` gives X L^T.
    objective_ : ndarray of shape (n_iter_ + 1,)
        The objective at the start and after each iteration; it never rises.
    n_iter_ : int
    classes_ : ndarray
        The labels seen.
    n_features_in_ : int

    Notes
    -----
    Target neighbours are not sought again: ``init=fitted.components_`` starts from what was learned, with new ones.

    With one class, or no class of two samples, there is nothing to learn: a warning is given, and the start returned.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "n_components": [Interval(Integral, 1, None, closed="left"), None],
        "n_neighbors": [Interval(Integral, 1, None, closed="left")],
        "push_weight": [Interval(Real, 0, 1, closed="right")],
        "shrinkage": [Interval(Real, 0, None, closed="left")],
        "init": [StrOptions({"pca", "identity"}), np.ndarray],
        "solver": [StrOptions({"lbfgs", "projected"})],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "tol": [Interval(Real, 0, None, closed="left")],
        "callback": [callable, None],
        "verbose": ["verbose"],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        n_components: int | None = None,
        *,
        n_neighbors: int = 5,
        push_weight: float = 0.3,
        shrinkage: float = 1.0,
        init: str | FloatArray = "pca",
        solver: str = "lbfgs",
        max_iter: int = 100,
        tol: float = 1e-4,
        callback: Callable[[FloatArray, int], None] | None = None,
        verbose: int = 0,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.n_components = n_components
        self.n_neighbors = n_neighbors
        self.push_weight = push_weight
        self.shrinkage = shrinkage
        self.init = init
        self.solver = solver
        self.max_iter = max_iter
        self.tol = tol
        self.callback = callback
        self.verbose = verbose
        self.random_state = random_state

    def fit(self, X: Any, y: Any) -> Self:
        """Learn L from samples X, shape (n_samples, n_features), and their labels y, shape (n_samples,)."""
        self._validate_params()
        X, y = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        check_classification_targets(y)
        self.classes_, labels = np.unique(y, return_inverse=True)
        order = np.argsort(labels, kind="stable")
        points, starts = (X - X.mean(axis=0))[order], class_starts(labels[order])
        L = self._start(points)
        given = isinstance(self.init, np.ndarray)  # a few components of a PCA would choose neighbours by them alone
        targets = target_neighbours(points @ L.T if given else points, starts, self.n_neighbors)
        if starts.size < 3 or np.all(targets < 0):
            return self._nothing_to_learn(L)
        unit = _unit(points @ L.T, targets)
        self._descend(points / unit, starts, targets, L, unit)
        return self

    def transform(self, X: Any) -> FloatArray:
        """X L^T, shape (n_samples, n_components)."""
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return np.asarray(X @ self.components_.T)

    def _start(self, points: FloatArray) -> FloatArray:
        """L at the start, of centred points."""
        n, d = points.shape
        if isinstance(self.init, np.ndarray):
            L = np.asarray(check_array(self.init, dtype=np.float64))
            if L.shape[1] != d or (self.n_components or len(L)) != len(L):
                raise ValueError(f"init has shape {L.shape}, expected ({self.n_components or 'n_components'}, {d})")
        else:
            most = min(n, d) if self.init == "pca" else d
            count = self.n_components or most
            if count > most:
                raise ValueError(f"n_components={count} is more than {most}, the most that init={self.init!r} can give")
            pca = self.init == "pca" and bool(np.any(points))
            L = PCA(count, random_state=self.random_state).fit(points).components_ if pca else np.eye(count, d)
        return L

    def _nothing_to_learn(self, L: FloatArray) -> Self:
        what = "one class" if len(self.classes_) < 2 else "no class with two samples"
        warnings.warn(f"LMNN: {what}, so there is nothing to learn; the start is returned", UserWarning, stacklevel=3)
        self.components_, self.objective_, self.n_iter_ = L, np.zeros(1), 0
        return self

    def _descend(self, points: FloatArray, starts: IndexArray, targets: IndexArray, L: FloatArray, unit: float) -> None:
        """Minimise from L; ``points`` are in a ``unit`` in which target neighbours are about 1 apart."""
        free = Objective(points, starts, targets, self.push_weight, 0.0, L)
        L = lmnn_solvers.best_multiple(free, L)
        objective = Objective(points, starts, targets, self.push_weight, self.shrinkage, L)
        history = [objective.of_components(L)[0]]

        def progress(L: FloatArray, value: float) -> None:
            history.append(value)
            if self.verbose:
                print(f"[LMNN] {len(history) - 1:4d} {value:.6e}", flush=True)
            if self.callback is not None:
                self.callback(L / unit, len(history) - 1)

        solver = lmnn_solvers.lbfgs if self.solver == "lbfgs" else lmnn_solvers.projected
        end = solver(objective, L, self.max_iter, self.tol, progress)
        if not end.converged:
            warnings.warn(f"LMNN: not converged after max_iter={self.max_iter}", ConvergenceWarning, stacklevel=3)
        self.components_, self.objective_, self.n_iter_ = end.L / unit, np.array(history), len(history) - 1

    @property
    def _n_features_out(self) -> int:
        return int(self.components_.shape[0])

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags


def _unit(Y: FloatArray, targets: IndexArray) -> float:
    """Median distance of target neighbours that do not coincide; where all do, the spread of the points."""
    i, slot = np.nonzero(targets >= 0)
    square = squared_distances(Y, i, targets[i, slot])
    square = square[square > 0.0] if np.any(square > 0.0) else np.array([np.sum(Y**2) / len(Y)])
    return float(np.sqrt(np.median(square))) or 1.0
