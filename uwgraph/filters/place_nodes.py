"""Places as a part of a filter's state: nodes that sightings are told apart by, appended, fused and dropped.

A sighting is of a known node where descriptor *and* position fit: d_M^2 within its gate, and v^T S^-1 v < chi2(m).
Of several the nearest in v^T S^-1 v is taken, unless another is nearly as likely. Where only the position fits it is
another place close by, and a new node. Where only the descriptor fits, either two places look alike or the filter is
wrong: no new node, for it would be a duplicate in the second case, and no update, for it would ruin the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from uwgraph.chi_square import chi2_quantile
from uwgraph.dive.rig import Positive, Settings
from uwgraph.errors import DataError
from uwgraph.filters import part
from uwgraph.filters.augment import augmented, without
from uwgraph.filters.kinematic import POSITION, PSI, VEHICLE, turned, unwrapped, whitener
from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief, Index, State
from uwgraph.filters.unscented import Residual, Seen, Spread, moved_by
from uwgraph.types import FloatArray

SAME = 1e-3
"""m and rad: how well two nodes that are one place agree."""


class PlaceSettings(Settings):
    """When a sighting is of a known place, and which nodes are kept."""

    gate: Annotated[float, Field(gt=0.5, le=1.0)] = 0.99
    """Share of good sightings whose position fits; 1 looks at descriptors alone."""
    descriptor_gate: Annotated[float, Field(gt=0.0)] = 1.0
    """Largest d_M^2 with which two descriptors are of one place; infinite looks at positions alone."""
    odds: Annotated[float, Field(ge=1.0)] = 10.0
    """How many times likelier than any other node the nearest has to be."""
    radius_m: Positive = 1.0
    """What counts as one position, 1-sigma: nodes are fused if their distance is known so well, and is no larger than
    its triple; and a filter is lost where three places put it within its triple of each other."""
    most: Annotated[int, Field(ge=1, le=1000)] = 100
    """Most nodes; beyond them the one with the fewest sightings goes, of several the longest unseen."""


Verdict = Literal["known", "new", "doubtful", "ambiguous"]


@dataclass(frozen=True, eq=False)
class Sighting:
    """A place as seen from the vehicle."""

    t_ns: int
    relative: FloatArray
    """Where it is in levelled axes of the vehicle (forward, starboard, down) [m], and where it is a pose its heading
    less that of the vehicle [rad]: shape (3,) or (4,)."""
    cov: FloatArray
    """Shape (3, 3) or (4, 4)."""
    descriptor: FloatArray
    """z, after :meth:`uwgraph.places.metric.Metric.project`: squared distances are d_M^2. Shape (D,)."""
    kind: str = "place"

    def __post_init__(self) -> None:
        shapes_fit = self.relative.shape in ((3,), (4,)) and self.descriptor.ndim == 1
        if not (shapes_fit and np.all(np.isfinite(self.relative)) and np.all(np.isfinite(self.descriptor))):
            raise DataError(
                "a place is 3 or 4 finite numbers with a finite descriptor",
                where=f"sighting at {self.t_ns}",
                remedy="leave out images without a descriptor or a distance",
            )
        _ = self.whitener

    @cached_property
    def whitener(self) -> FloatArray:
        """Shape (m, m)."""
        return whitener(self.cov, len(self.relative), f"sighting at {self.t_ns}")

    def residual(self, x: State, node: Index) -> FloatArray:
        """Whitened residuals of M states, shape (M, m), if it is the node that stands at ``node``."""
        off = relative(x.y, node) - self.relative
        off[:, PSI:] = unwrapped(off[:, PSI:])
        return np.asarray(off @ self.whitener.T)


def relative(y: FloatArray, node: Index) -> FloatArray:
    """A node as seen from the vehicle, of M states, shape (M, 3) or (M, 4)."""
    seen = y[:, node] - y[:, : len(node)]
    seen[:, 0], seen[:, 1] = turned(-y[:, PSI], seen[:, 0], seen[:, 1])
    return seen


@dataclass(frozen=True, eq=False)
class Node:
    """A place of the state."""

    label: int
    descriptor: FloatArray
    """Mean of its sightings', shape (D,)."""
    count: int
    """Sightings."""
    seen_ns: int
    """The last of them."""

    def seen_again(self, sighting: Sighting) -> Node:
        """With one more sighting."""
        count = self.count + 1
        mean = self.descriptor + (sighting.descriptor - self.descriptor) / count
        return replace(self, descriptor=mean, count=count, seen_ns=sighting.t_ns)

    def joined(self, other: Node) -> Node:
        """Both as one, with the older label."""
        count = self.count + other.count
        mean = (self.count * self.descriptor + other.count * other.descriptor) / count
        return Node(min(self.label, other.label), mean, count, max(self.seen_ns, other.seen_ns))


@dataclass(frozen=True, eq=False)
class Places:
    """A belief and the nodes at its end."""

    belief: Belief
    nodes: tuple[Node, ...] = ()
    size: int = 0
    """Numbers of a node, 3 or 4; 0 before the first."""

    def check(self, sighting: Sighting) -> None:
        """Raise :class:`DataError` for a sighting that cannot be compared with the nodes."""
        if not self.nodes:
            return
        known, found = (self.size, len(self.nodes[0].descriptor)), (len(sighting.relative), len(sighting.descriptor))
        if known != found:
            raise DataError(
                f"{found[0]} numbers and a descriptor of {found[1]}, where other places have {known[0]} and {known[1]}",
                where=f"sighting at {sighting.t_ns}",
                remedy="give all places a heading or none, and descriptors of one model",
            )

    def at(self, k: int) -> Index:
        """Where the k-th node stands in the tangent."""
        first = self.belief.x.size - self.size * (len(self.nodes) - k)
        return np.arange(first, first + self.size)

    def find(self, label: int) -> int:
        """Number of the node of a label."""
        return [node.label for node in self.nodes].index(label)

    def vehicle_and(self, k: int) -> Index:
        """Position and heading of the vehicle, and the k-th node: what a sighting of it depends on."""
        return np.concatenate([np.arange(VEHICLE), self.at(k)])

    def residual(self, sighting: Sighting, k: int) -> Residual:
        """A sighting's residual if it is of the k-th node."""
        return partial(sighting.residual, node=self.at(k))

    def seen(self, sighting: Sighting, k: int, spread: Spread) -> Seen:
        """A sighting's residual over the belief, if it is of the k-th node."""
        at = self.vehicle_and(k)
        return part.sight(self.residual(sighting, k), len(at), spread)(part.facing(self.belief, at))

    def off(self, sighting: Sighting, k: int) -> FloatArray:
        """How far the vehicle is from where a sighting of the k-th node puts it, in n, shape (3,)."""
        seen = sighting.relative.copy()
        seen[:2] = turned(self.belief.x.y[PSI], *seen[:2])
        return np.asarray((self.belief.x.y[: self.size] + seen - self.belief.x.y[self.at(k)])[POSITION])

    def widened(self, off: FloatArray) -> Places:
        """The vehicle, and nothing else, by so much less certain of its position: it is not where it was believed."""
        rows = np.zeros((3, self.belief.x.size))
        rows[:, POSITION] = np.diag(off)
        return replace(self, belief=replace(self.belief, S=lower_root(np.vstack([self.belief.S.T, rows]))))

    def with_node(self, sighting: Sighting, label: int) -> Places:
        """The sighting as a node of its own."""
        y, psi = self.belief.x.y, self.belief.x.y[PSI]
        m = len(sighting.relative)
        north, east = turned(psi, *sighting.relative[:2])
        G_z = np.eye(m)
        G_z[:2, :2] = np.column_stack([turned(psi, 1.0, 0.0), turned(psi, 0.0, 1.0)])
        G_x = np.eye(m, len(y))
        G_x[:2, PSI] = -east, north
        place = y[:m] + np.concatenate([[north, east], sighting.relative[2:]])
        rows = (G_z @ np.linalg.cholesky(sighting.cov)).T
        node = Node(label, sighting.descriptor, 1, sighting.t_ns)
        return Places(augmented(self.belief, place, G_x, rows), (*self.nodes, node), m)

    def dropped(self, k: int) -> Places:
        """Without the k-th node."""
        belief = without(self.belief, int(self.at(k)[0]), self.size)
        return replace(self, belief=belief, nodes=self.nodes[:k] + self.nodes[k + 1 :])

    def least_useful(self) -> int:
        """The node with the fewest sightings, of several the longest unseen."""
        return min(range(len(self.nodes)), key=lambda k: (self.nodes[k].count, self.nodes[k].seen_ns))

    def renewed(self, k: int, node: Node) -> Places:
        """With the k-th node's record replaced."""
        return replace(self, nodes=(*self.nodes[:k], node, *self.nodes[k + 1 :]))

    def alike(self, descriptor: FloatArray, gate: float) -> list[int]:
        """Nodes whose descriptors are of one place with this one."""
        if not self.nodes:
            return []
        off = np.array([node.descriptor for node in self.nodes]) - descriptor
        return [int(k) for k in np.flatnonzero(np.sum(off**2, axis=1) <= gate)]


@dataclass(frozen=True)
class Association:
    """What a sighting was taken for."""

    verdict: Verdict
    nodes: tuple[int, ...] = ()
    """Numbers of the nodes that fit, the nearest first; of a doubtful sighting those that look alike."""
    d2: float = 0.0
    """v^T S^-1 v of the nearest."""


def associate(
    places: Places, sighting: Sighting, R: FloatArray, settings: PlaceSettings, spread: Spread
) -> Association:
    """Tell which node was sighted.

    Parameters
    ----------
    R
        Covariance of the sighting's noise as the filter believes it, in units of the stated, shape (m, m).
    """
    alike = places.alike(sighting.descriptor, settings.descriptor_gate)
    if not alike:
        return Association("new")
    d2 = np.array([_mahalanobis2(places, sighting, k, R, spread) for k in alike])
    order = np.argsort(d2)
    fits = d2[order] <= _limit(settings.gate, len(sighting.relative))
    near = tuple(alike[k] for k in order)
    if not fits.any():
        blind = np.isinf(settings.descriptor_gate)
        return Association("new") if blind else Association("doubtful", near, float(d2[order[0]]))
    fitting = near[: int(fits.sum())]
    if len(fitting) > 1 and d2[order[1]] - d2[order[0]] < 2.0 * np.log(settings.odds):
        return Association("ambiguous", fitting, float(d2[order[0]]))
    return Association("known", fitting, float(d2[order[0]]))


@cache
def _limit(share: float, m: int) -> float:
    """Quantile of chi-square with m degrees of freedom."""
    return float(chi2_quantile(share, m))


def _mahalanobis2(places: Places, sighting: Sighting, k: int, R: FloatArray, spread: Spread) -> float:
    """v^T S^-1 v."""
    seen = places.seen(sighting, k, spread)
    return float(seen.mean @ np.linalg.solve(seen.spread + R, seen.mean))


def fused(places: Places, j: int, k: int, settings: PlaceSettings, spread: Spread) -> Places | None:
    """The places with the j-th and k-th node as one, if they are: known close together, and alike.

    That they are the same place is a measurement like any other: their difference is zero.
    """
    unlike = places.nodes[j].descriptor - places.nodes[k].descriptor
    if float(unlike @ unlike) > settings.descriptor_gate:
        return None
    a, b, m = places.at(j), places.at(k), places.size
    belief = part.facing(places.belief, np.concatenate([a, b]))
    seen = part.sight(partial(_apart, a=a, b=b), 2 * m, spread)(belief)
    same = seen.with_noise(SAME * np.eye(m))
    white = same.whiten(seen.mean)
    sigma = float(np.sqrt(np.linalg.eigvalsh(seen.spread[:3, :3])[-1]))
    known_close = sigma <= settings.radius_m and np.linalg.norm(seen.mean[POSITION]) <= 3.0 * settings.radius_m
    if not known_close or white @ white > _limit(settings.gate, m):
        return None
    both = replace(places, belief=part.lowered(moved_by(belief, seen, same)))
    joined = places.nodes[j].joined(places.nodes[k])
    return both.renewed(min(j, k), joined).dropped(max(j, k))


def _apart(x: State, a: Index, b: Index) -> FloatArray:
    """Difference of two nodes of M states, shape (M, m)."""
    off = x.y[:, a] - x.y[:, b]
    off[:, PSI:] = unwrapped(off[:, PSI:])
    return np.asarray(off)
