"""A metric that knows its neighbours: LMNN as a scikit-learn transformer, on handwritten digits.

    python examples/09_learned_metric.py

In a plain Euclidean space every pixel counts alike. Large-margin nearest neighbours learns which directions matter:
images of one digit come near each other, those of others are pushed out by a margin. The same transformer makes the
metric of places (`uwgraph places train`).
"""

from sklearn.datasets import load_digits
from sklearn.decomposition import PCA
from sklearn.model_selection import GridSearchCV, train_test_split
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline

from uwgraph.places.lmnn import LMNN


def main() -> None:
    X, y = load_digits(return_X_y=True)
    X_train, X_test, y_train, y_test = train_test_split(X, y, test_size=0.3, stratify=y, random_state=0)

    euclidean = KNeighborsClassifier(3).fit(X_train, y_train)
    learned = make_pipeline(PCA(40), LMNN(n_neighbors=3, max_iter=30), KNeighborsClassifier(3)).fit(X_train, y_train)
    for name, model in (("Euclidean", euclidean), ("LMNN", learned)):
        print(f"{name:>10}: {100 * (1 - model.score(X_test, y_test)):.1f} % of {len(y_test)} test digits are wrong")

    # it is a transformer like any other: grids, pipelines, clone and pickle work
    grid = GridSearchCV(learned, {"lmnn__n_components": [5, 20]}, cv=2)
    grid.fit(X_train[:400], y_train[:400])
    print(f"      grid: {grid.best_params_['lmnn__n_components']} dimensions do best")


if __name__ == "__main__":
    main()
