"""Another time of day for a dive: recordings without one, or at night, still serve to try the sun on real motion."""

from __future__ import annotations

from dataclasses import replace

from uwgraph.dive import Dive
from uwgraph.time import isoformat


def begin_at(dive: Dive, start_ns: int) -> Dive:
    """The dive with every stamp moved by the same amount, so that its first sample is at ``start_ns`` UTC."""
    streams = [*dive.streams(), *dive.images.items()]
    by = start_ns - min(int(stream.t_ns[0]) for _, stream in streams)
    moved = {name: replace(stream, t_ns=stream.t_ns + by) for name, stream in dive.streams()}
    images = {name: replace(stream, t_ns=stream.t_ns + by) for name, stream in dive.images.items()}
    simulated = {**dive.provenance.get("simulated", {}), "clock": f"simulated: begins at {isoformat(start_ns)}"}
    return replace(dive, **moved, images=images, provenance={**dive.provenance, "simulated": simulated})  # type: ignore[arg-type]
