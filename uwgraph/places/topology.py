"""The topological map: places as nodes with image samples, neighbours in time as edges."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from uwgraph.dive.rig import Positive, Settings
from uwgraph.dive.yamlfile import parse_settings
from uwgraph.errors import DataError
from uwgraph.places.npz import checked, json_value, read_npz, write_npz
from uwgraph.places.retrieval import Index, Nearest
from uwgraph.types import BoolArray, FloatArray, TimeArray

KIND: Final = "uwgraph topological map"
_UNKNOWN: Final = np.full(4, np.nan)


class TopologySettings(Settings):
    """When an image makes a place of its own."""

    gate: Positive = 1.0
    """Largest d_M^2 to a node's first sample with which an image belongs to the node."""
    radius_m: Positive = 0.5
    """Largest distance from it, where both positions are known."""
    samples: Annotated[int, Field(ge=1, le=100_000)] = 32
    """Most samples kept of a node."""
    apart_s: Positive = 10.0
    """What lies nearer in time than this is not a place seen again."""


@dataclass(frozen=True)
class Association:
    """The node that an image resembles most, for a filter or a graph to believe or not."""

    node: int
    distance: float
    """d_M^2 to the nearest sample of the node."""
    ratio: float
    """The same over that of the nearest sample of a node that is neither this nor its neighbour; 1 for ambiguous."""
    sample: int
    """The nearest sample."""


@dataclass
class _Node:
    key: int
    """The first sample, which stands for the node."""
    samples: list[int]
    neighbours: set[int] = field(default_factory=set)


class TopologicalMap:
    """Nodes, each with image samples (descriptor z, stamp, pose), and which nodes follow each other.

    A pose is north, east, down [m] and heading [rad], NaN where unknown.
    """

    def __init__(self, size: int, settings: TopologySettings | None = None) -> None:
        self.settings = settings or TopologySettings()
        self._index = Index(size)
        self._poses: list[FloatArray] = []
        self._label: list[int] = []
        self._nodes: dict[int, _Node] = {}
        self._current: int | None = None
        self._next = 0

    def __len__(self) -> int:
        return len(self._label)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Labels of the nodes, the oldest first."""
        return tuple(self._nodes)

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Pairs of neighbouring nodes, the smaller label first."""
        return tuple(sorted((a, b) for a, node in self._nodes.items() for b in node.neighbours if a < b))

    @property
    def labels(self) -> NDArray[np.intp]:
        """The node of each sample, shape (N,)."""
        return np.array(self._label, dtype=np.intp)

    @property
    def descriptors(self) -> NDArray[np.float32]:
        """z of each sample, shape (N, size)."""
        return self._index.descriptors

    @property
    def t_ns(self) -> TimeArray:
        """Stamps of the samples, shape (N,)."""
        return self._index.t_ns

    @property
    def poses(self) -> FloatArray:
        """Of the samples, shape (N, 4)."""
        return np.array(self._poses, dtype=np.float64).reshape(-1, 4)

    @property
    def nbytes(self) -> int:
        """Memory of the samples, bytes."""
        return self._index.nbytes + 32 * len(self._poses)

    def samples(self, node: int) -> tuple[int, ...]:
        """Numbers of a node's samples."""
        return tuple(self._nodes[node].samples)

    def neighbours(self, node: int) -> tuple[int, ...]:
        """Nodes with an edge to this one."""
        return tuple(sorted(self._nodes[node].neighbours))

    def pose(self, node: int) -> FloatArray:
        """Of the node's first sample, shape (4,)."""
        return self._poses[self._nodes[node].key]

    def add(self, z: ArrayLike, t_ns: int, pose: ArrayLike | None = None) -> int:
        """The node of the newest image: the current one or a neighbour that it is too similar to, or a new one.

        A place seen again gets a new node too: :meth:`associate` proposes, geometry verifies, :meth:`merge` joins.

        Raises
        ------
        DataError
            When the descriptor has another size or is not finite.
        """
        z, pose = self._index.checked(z), _UNKNOWN if pose is None else np.asarray(pose, dtype=np.float64).reshape(4)
        node = self._alike(z, pose)
        if node is None:
            node, self._next = self._next, self._next + 1
            self._nodes[node] = _Node(len(self), [])
        if len(self._nodes[node].samples) < self.settings.samples:
            self._nodes[node].samples.append(self._index.add(z, t_ns))
            self._poses.append(pose)
            self._label.append(node)
        if self._current is not None:
            self.link(self._current, node)
        self._current = node
        return node

    def associate(self, z: ArrayLike, t_ns: int | None = None) -> Association | None:
        """The node whose samples are nearest to an image; None where there is none ``apart_s`` away in time."""
        best = self.search(z, 1, t_ns)
        if not len(best.sample):
            return None
        sample, distance = int(best.sample[0]), float(best.distance[0])
        node = self._label[sample]
        near = [node, *self._nodes[node].neighbours]
        other = self.search(z, 1, t_ns, among=~np.isin(self.labels, near))
        ratio = distance / max(float(other.distance[0]), 1e-12) if len(other.sample) else 0.0
        return Association(node, distance, min(ratio, 1.0), sample)

    def search(self, z: ArrayLike, k: int = 5, t_ns: int | None = None, among: BoolArray | None = None) -> Nearest:
        """The ``k`` nearest samples that are at least ``apart_s`` away in time."""
        return self._index.search(z, k, t_ns=t_ns, apart_s=self.settings.apart_s, among=among)

    def link(self, a: int, b: int) -> None:
        """Make two nodes neighbours."""
        if a != b:
            self._nodes[a].neighbours.add(b)
            self._nodes[b].neighbours.add(a)

    def merge(self, a: int, b: int) -> int:
        """Make one node of two, as where a place was seen again and verified; the older label stays."""
        keep, gone = min(a, b), max(a, b)
        if keep == gone:
            return keep
        node = self._nodes.pop(gone)
        for sample in node.samples:
            self._label[sample] = keep
        self._nodes[keep].samples += node.samples
        for neighbour in node.neighbours:
            self._nodes[neighbour].neighbours.discard(gone)
            self.link(keep, neighbour)
        if self._current == gone:
            self._current = keep
        return keep

    def merge_similar(self) -> int:
        """Merge neighbours whose first samples pass both gates, as after poses were corrected; how many went."""
        before = len(self._nodes)
        while pairs := [edge for edge in self.edges if self._similar(*edge)]:
            for a, b in pairs:
                if a in self._nodes and b in self._nodes:
                    self.merge(a, b)
        return before - len(self._nodes)

    def move(self, poses: FloatArray) -> None:
        """Give all samples new poses, shape (N, 4), as after a closure."""
        if np.shape(poses) != (len(self._poses), 4):
            raise DataError(
                f"{np.shape(poses)} poses for {len(self._poses)} samples", where="topological map", remedy="give N, 4"
            )
        self._poses = list(np.asarray(poses, dtype=np.float64))

    def save(self, path: str | Path) -> None:
        """Write the map as ``.npz``."""
        arrays = {
            "settings": np.array(self.settings.model_dump_json()),
            "descriptors": self.descriptors,
            "t_ns": self.t_ns,
            "poses": self.poses,
            "labels": self.labels,
            "nodes": np.array([(label, node.key) for label, node in self._nodes.items()], np.int64).reshape(-1, 2),
            "edges": np.array(self.edges, np.int64).reshape(-1, 2),
            "current": np.array([-1 if self._current is None else self._current]),
        }
        write_npz(path, KIND, arrays)

    @classmethod
    def load(cls, path: str | Path) -> TopologicalMap:
        """Read what :meth:`save` wrote; raises :class:`DataError` for any other file."""
        where, arrays = str(path), read_npz(path, KIND)
        Z = checked(arrays, "descriptors", (None, None), where, "f")
        t_ns = checked(arrays, "t_ns", (len(Z),), where, "i")
        poses = checked(arrays, "poses", (len(Z), 4), where, "f", finite=False)
        labels = checked(arrays, "labels", (len(Z),), where, "i")
        nodes = checked(arrays, "nodes", (None, 2), where, "i")
        edges = checked(arrays, "edges", (None, 2), where, "i")
        current = int(checked(arrays, "current", (1,), where, "i")[0])
        made = cls(Z.shape[1], parse_settings(TopologySettings, json_value(arrays, "settings", where), where))
        _check_nodes(labels, nodes, edges, current, where)
        made._index.extend(Z, t_ns)
        made._poses, made._label = list(poses.astype(np.float64)), [int(label) for label in labels]
        made._nodes = {int(n): _Node(int(key), [int(i) for i in np.flatnonzero(labels == n)]) for n, key in nodes}
        for a, b in edges:
            made.link(int(a), int(b))
        made._current, made._next = None if current < 0 else current, int(nodes[:, 0].max(initial=-1)) + 1
        return made

    def _alike(self, z: NDArray[np.float32], pose: FloatArray) -> int | None:
        """Of the current node and its neighbours the most similar one that passes the gates."""
        if self._current is None:
            return None
        near = [self._current, *self.neighbours(self._current)]
        distance = [self._gated(z, pose, self._nodes[node].key) for node in near]
        best = int(np.argmin(distance))
        return near[best] if distance[best] <= self.settings.gate else None

    def _similar(self, a: int, b: int) -> bool:
        first, second = self._nodes[a].key, self._nodes[b].key
        return self._gated(self.descriptors[first], self._poses[first], second) <= self.settings.gate

    def _gated(self, z: NDArray[np.float32], pose: FloatArray, sample: int) -> float:
        """d_M^2 to a sample, infinite where the positions are too far apart."""
        if np.linalg.norm(pose[:3] - self._poses[sample][:3]) > self.settings.radius_m:  # NaN: not known
            return np.inf
        return float(np.sum((z.astype(np.float64) - self.descriptors[sample]) ** 2))


def _check_nodes(labels: NDArray[Any], nodes: NDArray[Any], edges: NDArray[Any], current: int, where: str) -> None:
    known = nodes[:, 0]
    keys_fit = bool(np.all((nodes[:, 1] >= 0) & (nodes[:, 1] < len(labels))))
    if (
        not keys_fit
        or len(set(known.tolist())) != len(known)
        or np.any(known < 0)
        or not np.array_equal(labels[nodes[:, 1]], known)
        or not np.all(np.isin(labels, known))
        or not np.all(np.isin(edges, known))
        or (current >= 0 and current not in known)
    ):
        raise DataError("nodes, samples and edges contradict each other", where=where, remedy="make the map again")
