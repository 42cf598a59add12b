"""The topological graph of a map: its keyframes, and which of them show the same place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.model import Dive
from uwgraph.frames import geodetic_from_ned
from uwgraph.graph.keyframes import inside, nearest_keyframe
from uwgraph.seafloor.render import SeafloorMap
from uwgraph.time import isoformat
from uwgraph.types import TimeArray

Pairs = NDArray[np.int64]
"""Indices of keyframes, shape (L, 2)."""


def closure_links(dive: Dive, t_ns: TimeArray) -> Pairs:
    """The keyframes nearest the ends of each accepted closure of the dive."""
    closures = dive.closures
    if closures is None or len(t_ns) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    ends = np.column_stack([closures.from_ns, closures.t_ns])[closures.accepted] + dive.rig.visual.time_offset_ns
    ends = ends[inside(t_ns, ends).all(axis=1)]
    links = np.column_stack([nearest_keyframe(t_ns, end) for end in ends.T])
    return np.unique(links[links[:, 0] != links[:, 1]], axis=0)


def graph_json(found: SeafloorMap, links: Pairs) -> dict[str, Any]:
    """Nodes and links as node-link JSON: a way from each keyframe to the next, and the closures."""
    lat, lon, height = geodetic_from_ned(found.origin, found.poses.p_n)
    nodes = [
        {
            "id": k,
            "t_ns": int(t),
            "utc": isoformat(int(t)),
            "north": p[0],
            "east": p[1],
            "down": p[2],
            "lat_deg": np.degrees(lat[k]),
            "lon_deg": np.degrees(lon[k]),
            "height": height[k],
        }
        for k, (t, p) in enumerate(zip(found.t_ns, found.poses.p_n, strict=True))
    ]
    ways = [{"source": k, "target": k + 1, "kind": "way"} for k in range(len(nodes) - 1)]
    closures = [{"source": int(a), "target": int(b), "kind": "closure"} for a, b in links]
    return {"directed": False, "multigraph": False, "graph": {}, "nodes": nodes, "links": [*ways, *closures]}
