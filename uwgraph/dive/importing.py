"""From a recording in any known format to our dive folder, saying what was guessed and what was converted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from uwgraph.atomic import atomic_folder
from uwgraph.dive.checks.presence import missing_in_words
from uwgraph.dive.folder import HEADER, TableFormat, copy_images, fill_folder
from uwgraph.dive.logs.guess import Left, Taken
from uwgraph.dive.logs.log import LogReader
from uwgraph.dive.logs.mapping_file import NAME as MAPPING_FILE
from uwgraph.dive.logs.reading import LogOptions, Survey, opened, read_log, survey_log
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import AnyReader, guess_reader, native, reader_named
from uwgraph.dive.timing import align_clocks
from uwgraph.dive.validate import validate_dive
from uwgraph.errors import ConfigError
from uwgraph.time import isoformat
from uwgraph.types import Stream

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0 to 1."""


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
    taken: tuple[Taken, ...] = ()
    """Of a log: the topics that became streams ..."""
    left: tuple[Left, ...] = ()
    """... and those that did not."""
    missing: tuple[str, ...] = ()
    """What smoothing misses, in words."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as a dive."""

    dive: Dive
    reader: AnyReader
    reason: str
    """Why this reader."""
    survey: Survey | None = None
    """Of a log: what is in it and what was taken."""


def silent(doing: str, share: float) -> None:
    """Progress that nobody watches."""


def import_dive(
    src: str | Path,
    dest: str | Path,
    format: str | None = None,  # noqa: A002
    *,
    table_format: TableFormat = "parquet",
    overwrite: bool = False,
    options: LogOptions | None = None,
    align: bool | None = None,
    progress: Progress = silent,
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
    options : LogOptions, optional
        How to read a log of topics; other formats know themselves what their files mean.
    align : bool, optional
        Estimate clock offsets between the sensors; by default where the format's sensors kept clocks of their own.
    progress : callable
        Told what is being done.

    Raises
    ------
    DataError, ConfigError
        When the recording cannot be recognised or used; no dive is written then, but where nothing of a log is known,
        a mapping file to edit.
    """
    source, target = Path(src), Path(dest)
    template = target.with_name(f"{target.name}-{MAPPING_FILE}")
    options = replace(options or LogOptions(), template=template)
    with atomic_folder(target, replaces=HEADER if overwrite else None) as folder:
        found = read_recording(
            source, format, options=options, align=align, images_into=folder / "images", progress=progress
        )
        progress("writing", 0.95)
        fill_folder(folder, found.dive, table_format)
        if found.reader is native:
            copy_images(found.dive, source, folder)
        if found.survey is not None:
            (folder / MAPPING_FILE).write_text(found.survey.text, encoding="utf-8")
    return ImportReport(
        source=str(source),
        destination=str(dest),
        format=found.reader.NAME,
        reason=found.reason,
        streams=summarise(found.dive),
        conversions=_notes(found.dive.provenance, "conversions"),
        caveats=_notes(found.dive.provenance, "caveats"),
        taken=found.survey.taken if found.survey else (),
        left=found.survey.left if found.survey else (),
        missing=missing_in_words(found.dive),
    )


def read_recording(
    src: Path,
    format: str | None = None,  # noqa: A002
    *,
    options: LogOptions | None = None,
    align: bool | None = None,
    images_into: Path | None = None,
    progress: Progress = silent,
) -> Recording:
    """A recording in any known format as a valid dive on one clock; parameters as of :func:`import_dive`.

    ``images_into`` is the folder that image files of a log go to; without it they are not read.

    Raises
    ------
    DataError, ConfigError
        When the recording cannot be recognised or used.
    """
    reader, reason = _reader(src, format)
    options = options or LogOptions()
    if isinstance(reader, LogReader):
        dive, survey = read_log(src, reader, options, images_into, lambda share: progress("reading", 0.9 * share))
        found = Recording(dive, reader, reason, survey)
    elif options.says_nothing:
        found = Recording(reader.read(src), reader, reason)
    else:
        raise ConfigError(
            f"a recording of format {reader.NAME} has no topics to map",
            where=str(src),
            remedy="leave out --mapping, --mapping-out, --origin, --rig, --from and --to",
        )
    progress("checking", 0.92)
    validate_dive(found.dive, str(src))
    aligned = reader.CLOCKS_DIFFER if align is None else align
    return replace(found, dive=_aligned(found.dive)) if aligned else found


def survey_recording(src: Path, format: str | None = None, options: LogOptions | None = None) -> Survey:  # noqa: A002
    """What is in a log and what would become of it; only what the reader needs to tell its topics is read.

    Raises
    ------
    DataError, ConfigError
        When it cannot be recognised or read, or is a format without topics.
    """
    reader, _ = _reader(src, format)
    if not isinstance(reader, LogReader):
        raise ConfigError(f"format {reader.NAME} has no topics to list", where=str(src), remedy="import it as it is")
    with opened(src, reader) as log:
        return survey_log(log, reader, options or LogOptions())


def _reader(src: Path, format: str | None) -> tuple[AnyReader, str]:  # noqa: A002
    return (reader_named(format), "as asked") if format else guess_reader(src)


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
