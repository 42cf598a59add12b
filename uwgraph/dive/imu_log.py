"""The IMU of a recording and nothing else: what a calibration at rest needs of it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from uwgraph.dive.folder import read_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.log import LogReader
from uwgraph.dive.logs.mapping import LogMapping, Streams
from uwgraph.dive.logs.reading import LogOptions, read_log, survey_log
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import guess_reader, native
from uwgraph.dive.rig import Rig
from uwgraph.errors import DataError
from uwgraph.types import Imu, Origin

NOWHERE: Final = Origin(0.0, 0.0)
"""The origin of a log that has none: an IMU on a bench does not need one."""


def read_imu(path: Path, mapping: LogMapping | None = None) -> tuple[Imu, Rig]:
    """The IMU of any recording, gaps and all, and the rig as far as the recording tells it.

    ``mapping`` names the topics of a log; without it they are guessed from their types.

    Raises
    ------
    ConfigError, DataError
        When the recording cannot be read, or has no IMU.
    """
    reader, _ = guess_reader(path)
    if isinstance(reader, LogReader):
        dive = _only_imu(path, reader, mapping)
    elif reader is native:
        dive = read_dive(path, validate=False)
    else:
        dive = reader.read(path)
    if dive.imu is None:
        raise _no_imu(path)
    return dive.imu, dive.rig


def _only_imu(path: Path, reader: LogReader, mapping: LogMapping | None) -> Dive:
    with reader.open_log(path) as log:
        found = survey_log(log, reader, LogOptions(mapping=mapping)).mapping
    if found.streams.imu is None:
        raise _no_imu(path)
    only = found.model_copy(update={"streams": Streams(imu=found.streams.imu), "images": {}})
    options = LogOptions(mapping=only, wishes=Wishes(origin=NOWHERE))
    dive, _ = read_log(path, reader, options, None, lambda _: None)
    return dive


def _no_imu(path: Path) -> DataError:
    return DataError("has no IMU", where=str(path), remedy="record it, or say with --mapping which topic it is")
