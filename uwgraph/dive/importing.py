"""From a recording in any known format to our dive folder, saying what was guessed and what was converted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from uwgraph.dive.folder import TableFormat, write_dive
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import Reader, guess_reader, native, reader_named
from uwgraph.dive.timing import align_clocks
from uwgraph.dive.validate import validate_dive
from uwgraph.time import isoformat
from uwgraph.types import Stream


@dataclass(frozen=True)
class StreamSummary:
    """One stream in a few numbers."""

    name: str
    count: int
    rate_hz: float
    """From the median interval; NaN for a single sample."""
    start: str
    """ISO 8601, UTC."""
    span_s: float


@dataclass(frozen=True)
class ImportReport:
    """What :func:`import_dive` read, why it was read so, and what was done to it."""

    source: str
    destination: str
    format: str
    reason: str
    """Why this format: what was guessed from, or that it was asked for."""
    streams: tuple[StreamSummary, ...]
    conversions: tuple[str, ...]
    caveats: tuple[str, ...]


def import_dive(
    src: str | Path,
    dest: str | Path,
    format: str | None = None,  # noqa: A002
    *,
    table_format: TableFormat = "parquet",
    overwrite: bool = False,
) -> ImportReport:
    """Read a recording, validate it, put its sensors on one clock where the format needs it, and write a dive folder.

    Parameters
    ----------
    src, dest : path
        The recording, and the folder to make.
    format : str, optional
        Name of a reader; guessed from the files when not given.
    table_format : {"parquet", "csv"}
        How to write the streams.
    overwrite : bool
        Replace a dive folder that is already there.

    Raises
    ------
    DataError, ConfigError
        When the recording cannot be recognised or used; nothing is written then.
    """
    source = Path(src)
    dive, reader, reason = read_recording(source, format)
    images_from = source if reader is native else None
    write_dive(dive, dest, table_format=table_format, images_from=images_from, overwrite=overwrite)
    return ImportReport(
        source=str(source),
        destination=str(dest),
        format=reader.NAME,
        reason=reason,
        streams=summarise(dive),
        conversions=_notes(dive.provenance, "conversions"),
        caveats=_notes(dive.provenance, "caveats"),
    )


def read_recording(src: Path, format: str | None = None) -> tuple[Dive, Reader, str]:  # noqa: A002
    """A recording in any known format as a valid dive on one clock; its reader, and why that one.

    Raises
    ------
    DataError, ConfigError
        When the recording cannot be recognised or used.
    """
    reader, reason = (reader_named(format), "as asked") if format else guess_reader(src)
    dive = reader.read(src)
    validate_dive(dive, str(src))
    return _aligned(dive) if reader.CLOCKS_DIFFER else dive, reader, reason


def _aligned(dive: Dive) -> Dive:
    """The dive on one clock, with what was done in its provenance."""
    dive, clocks = align_clocks(dive)
    conversions = [*_notes(dive.provenance, "conversions"), *clocks.notes]
    return replace(dive, provenance={**dive.provenance, "conversions": conversions})


def summarise(dive: Dive) -> tuple[StreamSummary, ...]:
    """Count, rate and span of every stream, images included."""
    images = ((f"images/{camera}", stream) for camera, stream in dive.images.items())
    return tuple(_summary(name, stream) for name, stream in [*dive.streams(), *images])


def _summary(name: str, stream: Stream) -> StreamSummary:
    interval_s = float(np.median(np.diff(stream.t_ns))) * 1e-9 if len(stream) > 1 else np.nan
    return StreamSummary(
        name=name,
        count=len(stream),
        rate_hz=1.0 / interval_s if interval_s else np.nan,
        start=isoformat(int(stream.t_ns[0])),
        span_s=float(stream.t_s[-1]),
    )


def _notes(provenance: Mapping[str, Any], key: str) -> tuple[str, ...]:
    notes = provenance.get(key, ())
    return tuple(map(str, notes)) if isinstance(notes, list | tuple) else (str(notes),)
