"""The samples of one stream as the mapping names them: in SI, in order, without those that say nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from uwgraph.dive.logs.mapping import AltitudeMapping, FixesMapping, TopicMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.types import BoolArray, FloatArray, TimeArray

ROW: Final = "row"
"""The column that tells which image a sample is."""

DEEPEST_PA: Final = 1.3e8
"""At the bottom of the deepest trench, nearly."""
MAX_DAMAGED: Final = 0.05
"""Share of the pressures that may be impossible."""

MANDATORY: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("f", "w"),
    "depth": ("depth", "height", "pressure"),
    "altitude": ("altitude",),
    "fixes": ("lat", "lon", "position"),
    "heading": ("heading", "orientation", "magnetic_field"),
    "gravity": ("gravity", "anomaly", "sigma"),
}
"""Fields without which a sample says nothing."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Columns of one stream."""

    t_ns: TimeArray
    """Shape (N,)."""
    values: Mapping[str, FloatArray]
    """By the mapping's key, in SI: shape (N,) for one field, (N, k) for several."""

    def __len__(self) -> int:
        return len(self.t_ns)

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[name]

    def get(self, name: str) -> FloatArray:
        """The column, or NaN where the mapping has none."""
        return self.values.get(name, np.full(len(self), np.nan))

    def take(self, rows: Any) -> Samples:
        """Those rows: indices, a mask or a slice."""
        return Samples(self.t_ns[rows], {name: column[rows] for name, column in self.values.items()})


def usable(stream: str, samples: Samples, mapping: TopicMapping, notes: Notes) -> Samples:
    """Without samples that lack what makes them one, or that say themselves that they are none; thinned as asked."""
    good = np.ones(len(samples), dtype=np.bool_)
    for name in MANDATORY.get(stream, ()):
        if name in samples:
            finite = np.isfinite(samples[name])
            good &= finite if finite.ndim == 1 else finite.all(axis=1)
    if stream == "imu":
        good &= samples["f"].any(axis=1) if len(samples) else good
    if "pressure" in samples:
        good &= _can_be(samples["pressure"])
    if isinstance(mapping, FixesMapping | AltitudeMapping) and "valid" in samples:
        good &= samples["valid"] > mapping.valid_above
    if "altitude" in samples:
        good &= samples["altitude"] > 0.0
    if "lat" in samples:
        # receivers without a fix say (0, 0)
        good &= (samples["lat"] != 0.0) | (samples["lon"] != 0.0)
    if "orientation" in samples and stream == "heading":
        good &= np.linalg.norm(samples["orientation"], axis=1) > 0.5
    if not good.all():
        notes.conversions.append(f"{stream}: {np.count_nonzero(~good)} of {len(good)} messages say nothing: dropped")
        samples = samples.take(good)
    if isinstance(mapping, FixesMapping):
        samples = _without_repeats(samples, notes)
    return _thinned(stream, samples, mapping.max_rate_hz, notes)


def _can_be(pressure: FloatArray) -> BoolArray:
    """Pressures of this planet, where nearly all are: a number that was hit is dropped, a wrong unit refused later."""
    possible: BoolArray = (pressure >= 0.0) & (pressure <= DEEPEST_PA)
    return possible if len(possible) and possible.mean() > 1.0 - MAX_DAMAGED else np.ones(len(pressure), dtype=np.bool_)


def _without_repeats(samples: Samples, notes: Notes) -> Samples:
    """Without fixes that repeat the place of the one before to the last digit: what a receiver under water does."""
    places = np.column_stack([samples[name] for name in ("lat", "lon", "position") if name in samples])
    new = np.append(True, np.any(np.diff(places, axis=0) != 0.0, axis=1))[: len(samples)]
    if not new.all():
        repeats = f"{np.count_nonzero(~new)} of {len(new)} repeat the place of the one before to the last digit"
        told = notes.conversions if new.mean() > 0.5 else notes.caveats
        told.append(f"fixes: {repeats}: dropped, since a receiver without signal does that")
    return samples.take(new)


def _thinned(stream: str, samples: Samples, rate_hz: float | None, notes: Notes) -> Samples:
    """The first sample of every interval of a grid."""
    if rate_hz is None or len(samples) < 2:
        return samples
    cell = np.floor((samples.t_ns - samples.t_ns[0]) * (1e-9 * rate_hz) + 1e-6)
    first = np.flatnonzero(np.diff(cell, prepend=-1.0))
    if len(first) < len(samples):
        notes.conversions.append(f"{stream}: thinned from {len(samples)} to {len(first)} samples ({rate_hz:g} Hz)")
    return samples.take(first)
