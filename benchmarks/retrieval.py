"""Places recognised: VLAD as it is and under the metric learnt by LMNN, whole and after a PCA of the images.

    python benchmarks/retrieval.py --frames ../shared/data/subvo --dive SIMULATED [--dive SIMULATED2] --save

``--frames``: the SUBVO pool recording (one U-shaped pass, 220 frames, planar reference). ``--dive``: a dive with
pictures of a simulated floor that is passed several times. The saved results are of these::

    echo '{leg_length_m: 40, line_spacing_m: 20, surface_time_s: 30}' > block.yaml
    echo '{leg_length_m: 22, line_spacing_m: 10}' > small.yaml
    echo '{altitude: 4, water: {turbidity: 2, snow: 30, daylight: 2}}' > murk.yaml
    PATROL="--pattern patrol --floor --floor-photos PHOTOS"
    uwgraph simulate floor_clear $PATROL --settings block.yaml --duration 720 --speed 0.7 --depth 15 --seed 5
    uwgraph simulate floor_fast $PATROL --settings block.yaml --duration 420 --speed 1 --depth 20 --seed 1
    uwgraph simulate floor_murky $PATROL --settings small.yaml --duration 330 --speed 1 --seed 1 \\
        --floor-settings murk.yaml

A place is what lies within 0.5 m. Vocabulary, PCA and metric are learnt on training frames alone (what stands still
in all images is masked by the whole recording); queries are at least 10 s away in time from training frames and from
every frame that they are compared with.
``in the map``: queries of short blocks (a third of a dive, each in turn) are sought among the training frames.
``elsewhere``: queries are sought among the other frames of a part that nobody trained on.

Recalls are of the queries that have a counterpart; ``first within 1 m`` tells how many wrong answers are the frame next
to the right one, which overlaps too. Precision at full recall: of all queries, those without a
counterpart included, accepted by the loosest threshold that a right answer needs, the share that is right.
Differences of recall@1 are paired, in points; 95 % intervals by resampling blocks of 10 s of queries. Each LMNN is
held against the Euclidean distance of the same descriptors, and everything against whole VLAD.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import _bench
import numpy as np
import pandas as pd
from _bench import Figure, Row
from numpy.typing import NDArray

from uwgraph.camera.images import read_image
from uwgraph.dive.folder import read_dive
from uwgraph.frames import ned_from_geodetic
from uwgraph.places.describe import DescriberSettings, VladDescriber
from uwgraph.places.enhance import Grey, enhance, scene_mask
from uwgraph.places.local import LocalFeatures, features_of
from uwgraph.places.metric import principal_components
from uwgraph.places.model_file import PlaceModel
from uwgraph.places.retrieval import Index
from uwgraph.places.train import TrainSettings, train
from uwgraph.places.vlad import Vocabulary

RADIUS_M = 0.5
APART_S = 10.0
SETTINGS = DescriberSettings()
EUCLIDEAN = {"VLAD": "VLAD", "VLAD + LMNN": "VLAD", "VLAD + PCA": "VLAD + PCA", "VLAD + PCA + LMNN": "VLAD + PCA"}
"""Methods, and the Euclidean distance that each is held against."""
Split = tuple[NDArray[np.bool_], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Recording:
    name: str
    t_s: NDArray[np.float64]
    p: NDArray[np.float64]
    files: list[Path]
    mask: Grey | None
    features: list[LocalFeatures]


def frames_of(folder: Path) -> Recording:
    files = sorted((folder / "images").glob("frame_*.jpg"))
    clock = [re.fullmatch(r"frame_(\d+)_(\d+)_([\d.]+)", file.stem).groups() for file in files]  # type: ignore[union-attr]
    t_s = np.array([3600.0 * int(h) + 60.0 * int(m) + float(s) for h, m, s in clock])
    p = pd.read_csv(folder / "gt1.csv").to_numpy() / 100.0
    return _recording(f"{folder.name} (real)", files, t_s, p[: len(files)])


def dive_of(folder: Path) -> Recording:
    dive = read_dive(folder)
    name, images = next(iter(dive.images.items()))
    r = dive.reference
    assert r is not None
    p_n = ned_from_geodetic(dive.origin, r.lat, r.lon, r.height)
    p = np.stack([np.interp(images.t_ns, r.t_ns, column) for column in p_n.T[:2]], axis=1)
    files = [folder / "images" / name / file for file in images.file]
    return _recording(f"{folder.name} (simulated)", files, images.t_s, p)


def _recording(name: str, files: list[Path], t_s: NDArray[np.float64], p: NDArray[np.float64]) -> Recording:
    images = [read_image(file) for file in files]
    mask = scene_mask(enhance(images[i], "none") for i in np.linspace(0, len(images) - 1, 40).astype(int))
    features = [features_of(image, SETTINGS.enhancement, SETTINGS.local, mask) for image in images]
    return Recording(name, t_s, p, files, mask, features)


def in_the_map(r: Recording) -> Iterator[Split]:
    """Blocks of 16 s every 80 s of a single pass; each third of a dive that repeats its way."""
    t = r.t_s - r.t_s[0]
    if "real" in r.name:
        for shift in range(0, 80, 16):
            phase = (t + shift) % 80.0
            yield (phase >= 16 + APART_S) & (phase < 80 - APART_S), phase < 16
    else:
        for a, b in zip(*(np.linspace(0, t[-1] + 1, 4)[s] for s in (slice(3), slice(1, 4))), strict=True):
            yield (t <= a - APART_S) | (t >= b + APART_S), (t >= a) & (t < b)


def elsewhere(r: Recording) -> Iterator[Split]:
    """Each quarter in time of a single pass; each half of the area of a dive that repeats its way."""
    t = r.t_s - r.t_s[0]
    if "real" in r.name:
        for a, b in zip(*(np.linspace(0, t[-1] + 1, 5)[s] for s in (slice(4), slice(1, 5))), strict=True):
            yield (t <= a - APART_S) | (t >= b + APART_S), (t >= a) & (t < b)
    else:
        long = np.linalg.svd(r.p - r.p.mean(axis=0), full_matrices=False)[2][0]
        north = (r.p - r.p.mean(axis=0)) @ long > 0.0
        for query in (north, ~north):
            near = np.min(np.abs(t[:, None] - t[query]), axis=1) < APART_S
            yield ~query & ~near, query


def described(r: Recording, training: NDArray[np.bool_]) -> dict[str, NDArray[np.float32]]:
    """Descriptors of all frames by each method, learnt on the training frames; frames without one are far away."""
    words = Vocabulary.learn([r.features[i] for i in np.flatnonzero(training)], SETTINGS.words, SETTINGS.components)
    describer = VladDescriber(words, SETTINGS)
    found = [describer.of_features(features) for features in r.features]
    has = np.array([x is not None for x in found])
    X = np.array([x if x is not None else np.zeros(words.size, np.float32) for x in found])
    taught = training & has
    mean, axes = principal_components(X[taught], min(64, int(taught.sum()) // 2))
    Y = _unit((X - mean) @ axes.T)
    learnt = [train(x[taught], r.p[taught]).project(x) for x in (X, Y)]
    made = dict(zip(EUCLIDEAN, (X, learnt[0], Y, learnt[1]), strict=True))
    return {name: np.where(has[:, None], z, np.float32(1e6)) for name, z in made.items()}


def _unit(x: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), np.float32(1e-12)))


def answers(
    r: Recording, z: NDArray[np.float32], database: NDArray[np.bool_], query: NDArray[np.bool_]
) -> pd.DataFrame:
    """One row a query: answerable; the first right, near, one of five right; d^2 of the first; its block of time."""
    index, members = Index(z.shape[1]), np.flatnonzero(database)
    t_ns = np.round(r.t_s * 1e9).astype(np.int64)
    index.extend(z[members], t_ns[members])
    rows = []
    for i in np.flatnonzero(query):
        apart = np.abs(r.t_s[members] - r.t_s[i]) >= APART_S
        distance = np.linalg.norm(r.p[members] - r.p[i], axis=1)
        same = distance < RADIUS_M
        found = index.search(z[i], 5, among=apart)
        if len(found.sample):
            right, block = same[found.sample], f"{r.name} {int(r.t_s[i] // APART_S)}"
            near = distance[found.sample[0]] < 2.0 * RADIUS_M
            rows.append((np.any(same & apart), right[0], near, right.any(), found.distance[0], block))
    return pd.DataFrame(rows, columns=["answerable", "first", "near", "five", "distance", "block"])


def asked(r: Recording, protocol: str) -> dict[str, pd.DataFrame]:
    """The answers to all queries by each method, in the same order."""
    made: dict[str, list[pd.DataFrame]] = {name: [] for name in EUCLIDEAN}
    for training, query in in_the_map(r) if protocol == "in the map" else elsewhere(r):
        for name, z in described(r, training).items():
            made[name].append(answers(r, z, training if protocol == "in the map" else query, query))
    return {name: pd.concat(parts, ignore_index=True) for name, parts in made.items()}


def precision_at_full_recall(a: pd.DataFrame) -> float:
    """Right answers over answers at the threshold that the last right one needs."""
    accepted = a["distance"] <= a.loc[a["first"], "distance"].max()
    return float((a["first"] & accepted).sum() / max(int(accepted.sum()), 1))


def gain(a: pd.DataFrame, b: pd.DataFrame, draws: int = 4000) -> str:
    """Recall@1 of a less that of b, points, with its 95 % interval: the same queries, blocks of time resampled."""
    can = a["answerable"]
    difference = a.loc[can, "first"].astype(float) - b.loc[can, "first"].astype(float)
    blocks = difference.groupby(a.loc[can, "block"]).agg(["sum", "count"]).to_numpy()
    drawn = blocks[np.random.default_rng(0).integers(len(blocks), size=(draws, len(blocks)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], (2.5, 97.5))
    return f"{100 * difference.mean():+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"


def rows_of(name: str, protocol: str, by_method: dict[str, pd.DataFrame]) -> list[Row]:
    rows: list[Row] = []
    for method, a in by_method.items():
        can = a[a["answerable"]]
        row: Row = {"recording": name, "protocol": protocol, "method": method, "queries": len(can)}
        row |= {"recall@1": float(can["first"].mean()), "first within 1 m": float(can["near"].mean())}
        row |= {"recall@5": float(can["five"].mean())}
        row |= {"precision at full recall": precision_at_full_recall(a)}
        row |= {"over Euclidean": gain(a, by_method[EUCLIDEAN[method]]), "over VLAD": gain(a, by_method["VLAD"])}
        rows.append(row)
    return rows


def compared(recordings: list[Recording]) -> list[Row]:
    """Every recording, then the queries of all of them and of the simulated ones."""
    rows: list[Row] = []
    for protocol in ("in the map", "elsewhere"):
        made = {r.name: asked(r, protocol) for r in recordings}
        groups = {name: [name] for name in made} | {"all": list(made)}
        groups["all simulated"] = [name for name in made if "simulated" in name]
        for group, names in groups.items():
            if len(names) > 1 or group in made:
                whole = {m: pd.concat([made[name][m] for name in names], ignore_index=True) for m in EUCLIDEAN}
                rows += rows_of(group, protocol, whole)
    return rows


def describing(r: Recording, images: int = 50) -> Row:
    """Time of one image, from pixels to z."""
    X = VladDescriber(Vocabulary.learn(r.features, SETTINGS.words, SETTINGS.components), SETTINGS)
    found = [(x, p) for f, p in zip(r.features, r.p, strict=True) if (x := X.of_features(f)) is not None]
    seconds, metric = _bench.timed(lambda: train(np.array([x for x, _ in found]), np.array([p for _, p in found])))
    model = PlaceModel(X, metric)
    read = [read_image(r.files[i]) for i in np.linspace(0, len(r.files) - 1, images).astype(int)]
    ms = [1e3 * _bench.timed(lambda image=image: model.describe(image, r.mask))[0] for image in read]  # type: ignore[misc]
    row: Row = {"recording": r.name, "frames": len(r.files), "pixels": f"{read[0].shape[1]} x {read[0].shape[0]}"}
    return row | {"p50 ms to describe": float(np.median(ms)), "s to learn the metric": seconds}


def latency(size: int, images: int = 10_000, queries: int = 1000) -> Row:
    rng = np.random.default_rng(0)
    index = Index(size)
    for start in range(0, images, 1000):
        z = _unit(rng.normal(size=(1000, size)).astype(np.float32))
        index.extend(z, np.arange(start, start + 1000) * 1_000_000_000)
    ms = []
    for i in rng.integers(images, size=queries):
        z = index.descriptors[i] + 0.01
        ms.append(1e3 * _bench.timed(lambda z=z, i=i: index.search(z, 5, t_ns=int(index.t_ns[i]), apart_s=APART_S))[0])  # type: ignore[misc]
    p50, p99 = np.percentile(ms, (50, 99))
    return {"images": images, "numbers": size, "p50 ms": p50, "p99 ms": p99, "memory MB": index.nbytes / 1e6}


def main() -> None:
    made = _bench.parser(__doc__)
    made.add_argument("--frames", type=Path, help="folder of the SUBVO recording")
    made.add_argument("--dive", type=Path, action="append", default=[], help="dive with a simulated floor")
    args: argparse.Namespace = made.parse_args()
    import cv2

    cv2.setNumThreads(1)
    size = SETTINGS.words * SETTINGS.components
    search = [latency(size), latency(256)]
    recordings = ([frames_of(args.frames)] if args.frames else []) + [dive_of(folder) for folder in args.dive]
    tables: dict[str, list[Row]] = {"search": search}
    if recordings:
        tables["describing"] = [describing(r) for r in recordings]
        tables["recall"] = compared(recordings)
    figures = [Figure("p99 ms of a search among 10 000", float(search[0]["p99 ms"]), 20.0)]
    details = {"settings": {"describe": SETTINGS.model_dump(), "train": TrainSettings().model_dump()}}
    _bench.finish(args, "retrieval", tables, figures, details)


if __name__ == "__main__":
    main()
