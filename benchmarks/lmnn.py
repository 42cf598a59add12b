"""3-NN error in the metric of LMNN, beside no metric, PCA, scikit-learn's NCA and metric-learn's LMNN.

Stratified splits, 30 % held out: five, and twenty (on the largest set without metric-learn), as five of the small sets
tell little: one sample of iris is 0.4 % of them. Everybody gets the same prepared data, in units in which NCA and
metric-learn do well (both depend on it, LMNN does not), and its own default settings, but metric-learn ends after 200
iterations and is also run with a larger first step. Its environment is made once:

    python -m venv peer && peer/bin/pip install "scikit-learn==1.6.*" "metric-learn==0.7.0"
    python benchmarks/lmnn.py --peer-python peer/bin/python

"spoken" is simulated after ISOLET: 26 classes in eight groups that sound alike, 617 features, 1500 samples, and
directions of strong variance that have nothing to do with the class. Default settings of LMNN were chosen on splits
within the training parts and on another draw of "spoken".
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import _bench
import numpy as np
from _bench import Figure, Row
from sklearn.base import TransformerMixin
from sklearn.datasets import load_digits, load_iris, load_wine
from sklearn.decomposition import PCA
from sklearn.model_selection import StratifiedShuffleSplit
from sklearn.neighbors import KNeighborsClassifier, NeighborhoodComponentsAnalysis
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from uwgraph.places.lmnn import LMNN
from uwgraph.types import FloatArray

SPLITS = 20
FIRST = 5
LONG = "spoken"
"""The set on which metric-learn takes so long that it gets the first splits only."""
NEIGHBOURS = 3
SPOKEN_UNIT = 20.0
"""In it NCA does best among a tenth to three standard deviations of the features, on another draw."""
PEER = {
    "metric-learn": {"max_iter": 200},
    "metric-learn, larger steps": {"max_iter": 200, "learn_rate": 1e-5},
}
"""At its default of 1000 iterations it takes five times as long, to no lower error on digits."""

Data = tuple[FloatArray, FloatArray]


def spoken(seed: int = 0, samples: int = 1500, features: int = 617, classes: int = 26) -> Data:
    """Gaussian classes around means in groups, nuisance directions and noise, mixed into all features."""
    rng = np.random.default_rng(seed)
    signal, nuisance, groups = 30, 40, 8
    y = np.arange(samples) % classes
    means = 1.5 * rng.normal(size=(groups, signal))[rng.integers(groups, size=classes)]
    means += 0.6 * rng.normal(size=(classes, signal))
    causes = np.hstack(
        [
            means[y] + 0.6 * rng.normal(size=(samples, signal)),
            rng.normal(size=(samples, nuisance)) * np.geomspace(3.0, 0.3, nuisance),
        ]
    )
    mixing = rng.normal(size=(signal + nuisance, features)) / np.sqrt(signal)
    return causes @ mixing + rng.normal(size=(samples, features)), y


def data_sets() -> dict[str, tuple[Data, TransformerMixin]]:
    """Name to data and preparation, which is fitted to training parts."""
    return {
        "digits": (load_digits(return_X_y=True), FunctionTransformer(lambda X: X / 16.0)),
        "wine": (load_wine(return_X_y=True), StandardScaler()),
        "iris": (load_iris(return_X_y=True), FunctionTransformer()),
        "spoken": (spoken(), make_pipeline(PCA(100, random_state=0), FunctionTransformer(lambda X: X / SPOKEN_UNIT))),
    }


def splits(X: FloatArray, y: FloatArray, preparation: TransformerMixin) -> Iterator[tuple[Data, Data]]:
    """Prepared training and test parts."""
    for train, test in StratifiedShuffleSplit(SPLITS, test_size=0.3, random_state=0).split(X, y):
        yield (preparation.fit_transform(X[train]), y[train]), (preparation.transform(X[test]), y[test])


def ours(make: Callable[[], TransformerMixin]) -> Callable[[Data], tuple[FloatArray, float]]:
    """From training data to L and seconds, by an estimator of this environment."""

    def fit(data: Data) -> tuple[FloatArray, float]:
        seconds, fitted = _bench.timed(lambda: make().fit(*data))
        return fitted.components_, seconds

    return fit


def peer(python: Path, settings: dict[str, float]) -> Callable[[Data], tuple[FloatArray, float]]:
    """The same by metric-learn under another interpreter; seconds are those of the fit alone."""

    def fit(data: Data) -> tuple[FloatArray, float]:
        with tempfile.TemporaryDirectory() as folder:
            train, result = Path(folder) / "train.npz", Path(folder) / "result.npz"
            np.savez(train, X=data[0], y=data[1])
            script = Path(__file__).with_name("lmnn_peer.py")
            subprocess.run([python, script, train, result, json.dumps(settings)], check=True)
            with np.load(result) as made:
                return made["L"], float(made["seconds"])

    return fit


def methods(peer_python: Path | None) -> dict[str, Callable[[Data], tuple[FloatArray, float]]]:
    fits: dict[str, Callable[[Data], tuple[FloatArray, float]]] = {
        "Euclidean": lambda data: (np.eye(data[0].shape[1]), 0.0),
        "PCA, 95 % of variance": ours(lambda: PCA(0.95)),
        "NCA": ours(lambda: NeighborhoodComponentsAnalysis(random_state=0)),
        "LMNN": ours(LMNN),
    }
    if peer_python:
        fits |= {name: peer(peer_python, settings) for name, settings in PEER.items()}
    return fits


def error(L: FloatArray, train: Data, test: Data) -> float:
    """Share of the test part that k-NN gets wrong, in per cent."""
    classifier = KNeighborsClassifier(NEIGHBOURS).fit(train[0] @ L.T, train[1])
    return 100.0 * (1.0 - float(classifier.score(test[0] @ L.T, test[1])))


def runs(peer_python: Path | None) -> list[Row]:
    """One row for each data set, method and split."""
    out = []
    for name, (data, preparation) in data_sets().items():
        for number, (train, test) in enumerate(splits(*data, preparation)):
            for method, fit in methods(peer_python if number < FIRST or name != LONG else None).items():
                L, seconds = fit(train)
                run = {"data": name, "method": method, "split": number, "error": error(L, train, test), "s": seconds}
                print(*run.values(), file=sys.stderr, flush=True)
                out.append(run)
    return out


def summary(table: list[Row], count: int) -> list[Row]:
    """Errors and times over the first ``count`` splits, and LMNN's error less each other's on the same splits."""
    out = []
    for data, method in dict.fromkeys((r["data"], r["method"]) for r in table):
        errors = [r["error"] for r in table if (r["data"], r["method"]) == (data, method)][:count]
        seconds = [r["s"] for r in table if (r["data"], r["method"]) == (data, method)][:count]
        own = [r["error"] for r in table if (r["data"], r["method"]) == (data, "LMNN")][:count]
        if len(errors) < count:
            continue
        difference = np.subtract(own, errors)
        out.append(
            {
                "data": data,
                "method": method,
                "error %": round(statistics.mean(errors), 6),
                "sd": statistics.stdev(errors),
                "fit s": statistics.median(seconds),
                "LMNN less this": round(float(difference.mean()), 6),
                "its standard error": float(difference.std(ddof=1) / np.sqrt(count)),
            }
        )
    return out


def figures(table: list[Row], splits: int) -> list[Figure]:
    """LMNN against the others, set by set and over all of them; of metric-learn's two the better, and the faster."""

    def mean(method: str, column: str, sets: Sequence[str]) -> float:
        found = [r[column] for r in table if r["method"] == method and r["data"] in sets]
        return statistics.mean(found) if len(found) == len(sets) else float("nan")

    held = []
    names = list(dict.fromkeys(row["data"] for row in table))
    for title, sets in {"mean of all sets": names, **{name: [name] for name in names}}.items():
        title = f"{title}, {splits} splits"
        own = mean("LMNN", "error %", sets)
        rivals = {peer: mean(peer, "error %", sets) for peer in ("Euclidean", "NCA")}
        rivals["metric-learn"] = min(mean(peer, "error %", sets) for peer in PEER)
        held += [Figure(f"{title}: error %, against {name}", own, limit) for name, limit in rivals.items()]
        fastest = min(mean(peer, "fit s", sets) for peer in PEER)
        held.append(Figure(f"{title}: fit s, against metric-learn", mean("LMNN", "fit s", sets), fastest))
    return [figure for figure in held if figure.limit == figure.limit]


def main() -> None:
    parser = _bench.parser(__doc__)
    parser.add_argument("--peer-python", type=Path, help="interpreter that has metric-learn; without it, not compared")
    args: argparse.Namespace = parser.parse_args()
    table = runs(args.peer_python)
    note = {} if args.peer_python else {"note": "metric-learn was not run: no --peer-python"}
    print(*note.values(), file=sys.stderr)
    counted = {count: summary(table, count) for count in (FIRST, SPLITS)}
    held = [figure for count, rows in counted.items() for figure in figures(rows, count)]
    _bench.finish(args, "lmnn", {f"{count} splits": rows for count, rows in counted.items()}, held, note)


if __name__ == "__main__":
    main()
