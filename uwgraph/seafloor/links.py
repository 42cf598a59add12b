"""The topological graph of a map: its keyframes, and which of them show the same place."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.model import Dive
from uwgraph.dive.tables import Column, read_table
from uwgraph.frames import geodetic_from_ned
from uwgraph.graph.keyframes import inside, nearest_keyframe
from uwgraph.seafloor.render import SeafloorMap
from uwgraph.time import isoformat
from uwgraph.types import ClosureVerdicts, RelativePoses, Solution, TimeArray

Pairs = NDArray[np.int64]
"""Two indices of keyframes, or two moments, shape (L, 2)."""
VERDICTS: Final = "closures.parquet"
"""What smoothing decided about closures, in its output folder."""


def verified_closures(dive: Dive) -> Pairs:
    """Both moments, on the dive's clock, of the dive's closures whose geometry was verified."""
    if dive.closures is None:
        return np.zeros((0, 2), dtype=np.int64)
    return _ends(dive.closures) + dive.rig.visual.time_offset_ns


def closures_of_result(folder: Path) -> Pairs | None:
    """Both moments of the closures that a smoothed result rests on; None where it does not tell.

    Raises
    ------
    DataError
        When its table cannot be read.
    """
    file = folder / VERDICTS
    if not file.is_file():
        return None
    columns = {"t_ns": Column("int"), "from_ns": Column("int"), "accepted": Column("bool")}
    table = read_table(file, columns, ignore_others=True)
    return np.column_stack([table["from_ns"], table["t_ns"]])[table["accepted"]]


def closures_of_solution(solution: Solution) -> Pairs | None:
    """The same of a solution in memory."""
    return None if solution.closures is None else _ends(solution.closures)


def _ends(closures: RelativePoses | ClosureVerdicts) -> Pairs:
    return np.column_stack([closures.from_ns, closures.t_ns])[closures.accepted]


def closure_links(ends_ns: Pairs, t_ns: TimeArray) -> Pairs:
    """The keyframes nearest the two moments of each closure."""
    if not len(ends_ns) or len(t_ns) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    ends = ends_ns[inside(t_ns, ends_ns).all(axis=1)]
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
