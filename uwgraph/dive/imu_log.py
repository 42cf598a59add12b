"""The IMU of a recording and nothing else: what a calibration at rest needs of it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from uwgraph.dive.folder import read_dive
from uwgraph.dive.logs.assemble import Wishes, assemble
from uwgraph.dive.logs.log import LogReader
from uwgraph.dive.logs.mapping import LogMapping, Streams
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.reading import LogOptions, opened, survey_log
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.logs.window import Window
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import guess_reader, native
from uwgraph.dive.rig import Rig
from uwgraph.errors import DataError
from uwgraph.types import Imu, Origin

EVERYTHING: Final = Window()
NOWHERE: Final = Origin(0.0, 0.0)
"""The origin of a log that has none: an IMU on a bench does not need one."""


def read_imu(path: Path, mapping: LogMapping | None = None, window: Window = EVERYTHING) -> tuple[Imu, Rig]:
    """The IMU of any recording within a window, and the rig as far as the recording tells it.

    ``mapping`` names the topics of a log; without it they are guessed from their types.

    Raises
    ------
    ConfigError, DataError
        When the recording cannot be read, or has no IMU.
    """
    reader, _ = guess_reader(path)
    if isinstance(reader, LogReader):
        dive = _only_imu(path, reader, mapping, window)
    else:
        dive = read_dive(path, validate=False) if reader is native else reader.read(path)
    if dive.imu is None:
        raise _no_imu(path)
    imu = dive.imu if isinstance(reader, LogReader) else _within(dive.imu, window)
    return imu, dive.rig


def _only_imu(path: Path, reader: LogReader, mapping: LogMapping | None, window: Window) -> Dive:
    with opened(path, reader) as log:
        found = survey_log(log, reader, LogOptions(mapping=mapping)).mapping
        if found.streams.imu is None:
            raise _no_imu(path)
        # samples as they are: means of neighbours would have less noise at the shortest averaging times
        imu = found.streams.imu.model_copy(update={"sampling": "mean"})
        only = found.model_copy(update={"streams": Streams(imu=imu), "images": {}})
        dive, _ = assemble(log, only, Wishes(origin=NOWHERE, window=window), None, lambda share: None)
    return dive


def _within(imu: Imu, window: Window) -> Imu:
    part = window.cut({"imu": Samples(imu.t_ns, {"f": imu.f_s, "w": imu.w_s})}, Notes())["imu"]
    return Imu(part.t_ns, f_s=part["f"], w_s=part["w"])


def _no_imu(path: Path) -> DataError:
    return DataError("has no IMU", where=str(path), remedy="record it, or say with --mapping which topic it is")
