"""One stream of a mapping against an open log: its topic, its fields found, the sink that they go into."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.dive.logs.fields import constant, resolve, topic_named
from uwgraph.dive.logs.images import ImageSink
from uwgraph.dive.logs.log import Topic
from uwgraph.dive.logs.mapping import ImagesMapping, StreamMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.quantity import Quantity
from uwgraph.dive.logs.samples import ROW, Samples, usable
from uwgraph.dive.logs.sinks import NumberSink
from uwgraph.dive.logs.stamps import in_order, stamps_of
from uwgraph.dive.validate import SHARED_STAMPS
from uwgraph.types import FloatArray

ABSURD: Final = 1e30
"""In SI: a number as large is a damaged one, and its square would overflow."""


class Plan:
    """What becomes of one topic.

    Parameters
    ----------
    stream : str
        ``imu``, ..., or ``images/CAMERA``.
    mapping : StreamMapping
        Its fields.
    topics : sequence of Topic
        What the log has.
    images_into : Path, optional
        Where images go.

    Raises
    ------
    ConfigError
        When the log has no such topic or field, with the nearest.
    """

    def __init__(
        self, stream: str, mapping: StreamMapping, topics: Sequence[Topic], images_into: Path | None = None
    ) -> None:
        self.stream, self.mapping = stream, mapping
        self.topic = topic_named(mapping.topic, topics, f"mapping: {stream}.topic")
        fields = {name: value for name, value in mapping.quantities().items() if name != "time"}
        self._columns = {name: tuple(self._column(name, q) for q in quantities) for name, quantities in fields.items()}
        paths = dict.fromkeys(c for columns in self._columns.values() for c, _ in columns if isinstance(c, str))
        self._index = {path: index for index, path in enumerate(paths)}
        self.sink = self._sink(images_into)

    def samples(self, notes: Notes) -> Samples:
        """The samples that came: stamped, in order, in SI, without those that say nothing."""
        poured = self.sink.poured()
        stamps = stamps_of(poured, self.mapping, self.stream, notes)
        rows = in_order(stamps, self.stream, notes, shared=self.stream in SHARED_STAMPS)
        if len(rows) == len(stamps) and (np.diff(rows) == 1).all():
            rows = slice(None)  # type: ignore[assignment]
        if isinstance(self.sink, ImageSink):
            return Samples(stamps[rows], {ROW: np.arange(len(stamps), dtype=np.float64)[rows]})
        values = {name: self._in_si(columns, poured.values[rows]) for name, columns in self._columns.items()}
        return usable(self.stream, Samples(stamps[rows], values), self.mapping, notes)

    def _column(self, name: str, quantity: Quantity) -> tuple[str | float, float]:
        """Path or constant, and scale."""
        number = constant(quantity, self.topic.fields)
        where = f"mapping: {self.stream}.{name}"
        return (resolve(quantity, self.topic, where) if number is None else number), quantity.scale

    def _sink(self, images_into: Path | None) -> NumberSink | ImageSink:
        if isinstance(self.mapping, ImagesMapping):
            if images_into is None:
                raise ValueError("images need a folder")
            return ImageSink(images_into / self.stream.partition("/")[2], self.mapping.max_rate_hz)
        time = self.mapping.time
        if isinstance(time, Quantity):
            return NumberSink(list(self._index), resolve(time, self.topic, f"mapping: {self.stream}.time"), time.scale)
        return NumberSink(list(self._index))

    def _in_si(self, columns: tuple[tuple[str | float, float], ...], values: FloatArray) -> FloatArray:
        si = np.empty((len(values), len(columns)))
        for index, (column, scale) in enumerate(columns):
            si[:, index] = values[:, self._index[column]] if isinstance(column, str) else column
            si[:, index] *= scale
        si[~(np.abs(si) < ABSURD)] = np.nan
        return si[:, 0] if len(columns) == 1 else si


def by_topic(plans: Sequence[Plan]) -> Mapping[str, tuple[NumberSink | ImageSink, ...]]:
    """The sinks of every topic, for pouring."""
    return {name: tuple(p.sink for p in plans if p.topic.name == name) for name in {p.topic.name for p in plans}}
