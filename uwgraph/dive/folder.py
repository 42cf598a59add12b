"""The dive folder: ``dive.yaml`` and one table per stream, as Parquet or CSV.

``dive.yaml`` holds ``origin`` (``lat_deg, lon_deg``), ``rig``, ``streams`` (names, and ``images/CAMERA``) and
``provenance``. The list of streams and the files must agree: a listed stream without a file, a file whose stream is not
listed, and a stream in both formats are errors. Other files in the folder are left alone. Depth may be given as
``pressure``: pascals above that at the sea surface (gauge, not absolute).
"""

from __future__ import annotations

import shutil
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, field_validator

from uwgraph.atomic import atomic_file, atomic_folder
from uwgraph.dive.layout import stream_columns, stream_from_table, table_from_stream
from uwgraph.dive.model import STREAM_TYPES, Dive
from uwgraph.dive.rig import Rig, Settings
from uwgraph.dive.tables import read_table, write_table
from uwgraph.dive.validate import validate_dive, validate_stream
from uwgraph.dive.yamlfile import read_settings, read_yaml
from uwgraph.errors import DataError
from uwgraph.types import Images, Origin, Stream

HEADER = "dive.yaml"
CAMERA_FILE = "camera.yaml"
"""The calibration beside the images of a camera."""
FORMATS = (".parquet", ".csv")
TableFormat = Literal["parquet", "csv"]

StreamName = Annotated[str, Field(pattern=rf"^({'|'.join(STREAM_TYPES)}|images/[A-Za-z0-9][\w.-]*)$")]


class OriginSettings(Settings):
    """The origin in the file."""

    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    lon_deg: Annotated[float, Field(ge=-180, le=360)]


class Header(Settings):
    """What ``dive.yaml`` holds."""

    origin: OriginSettings
    rig: Rig = Rig()
    streams: tuple[StreamName, ...]
    provenance: Annotated[dict[str, Any], Field(default_factory=dict)]

    @field_validator("streams")
    @classmethod
    def _once(cls, streams: tuple[str, ...]) -> tuple[str, ...]:
        for name in streams:
            if streams.count(name) > 1:
                raise ValueError(f"{name!r} is listed twice")
        return streams


def read_dive(path: str | Path, *, validate: bool = True) -> Dive:
    """Read a dive folder.

    Parameters
    ----------
    path : path
        The folder.
    validate : bool
        Also refuse what :func:`uwgraph.dive.validate.validate_dive` refuses; False is for looking at a bad dive.

    Raises
    ------
    DataError, ConfigError
        Naming the file, the field, and what to do.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise DataError("there is no such folder", where=str(folder), remedy="name the folder that holds dive.yaml")
    header = read_settings(Header, folder / HEADER)
    origin = Origin(lat=float(np.radians(header.origin.lat_deg)), lon=float(np.radians(header.origin.lon_deg)))
    files = {name: _table_file(folder, name) for name in header.streams}
    _refuse_unlisted(folder, header.streams)
    found = {name: _read_stream(name, file, origin) for name, file in files.items()}
    images = {name.partition("/")[2]: stream for name, stream in found.items() if isinstance(stream, Images)}
    streams: dict[str, Any] = {name: stream for name, stream in found.items() if not isinstance(stream, Images)}
    dive = Dive(origin, header.rig, **streams, images=images, provenance=header.provenance)
    if validate:
        validate_dive(dive, {name: str(file) for name, file in files.items()})
    return dive


def write_dive(
    dive: Dive,
    path: str | Path,
    *,
    table_format: TableFormat = "parquet",
    images_from: str | Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write a dive folder: whole, or not at all.

    Parameters
    ----------
    dive : Dive
        The dive.
    path : path
        The folder to make.
    table_format : {"parquet", "csv"}
        How to write the streams. Either reads back exactly, but for the rounding of degrees.
    images_from : path, optional
        The dive folder whose image files and calibrations are copied along; without it only the index is written.
    overwrite : bool
        Replace a dive folder that is already there, as a whole.

    Raises
    ------
    DataError
        When the folder is taken, cannot be written or the disk is full; nothing half-written is left.
    """
    with atomic_folder(path, replaces=HEADER if overwrite else None) as folder:
        fill_folder(folder, dive, table_format)
        if images_from is not None:
            copy_images(dive, Path(images_from), folder)


def fill_folder(folder: Path, dive: Dive, table_format: TableFormat = "parquet") -> None:
    """Write header and tables into a folder that is there, beside image files that may be in it already."""
    (folder / HEADER).write_text(_header_text(dive, folder), encoding="utf-8")
    for name, stream in dive.streams():
        write_table(folder / f"{name}.{table_format}", table_from_stream(name, stream))
    for camera, images in dive.images.items():
        place = folder / "images" / camera
        place.mkdir(parents=True, exist_ok=True)
        write_table(place / f"index.{table_format}", table_from_stream("images", images))


def add_stream(path: str | Path, name: str, stream: Stream, *, replace: bool = False) -> None:
    """Put one stream into a dive folder that is there.

    The table is written first and then listed, each whole or not at all: interrupted in between, the folder names an
    unlisted file when it is read, and nothing is lost.

    Raises
    ------
    DataError
        When the stream is there and ``replace`` is false, is not valid, or cannot be written.
    """
    folder = Path(path)
    header = read_settings(Header, folder / HEADER)
    validate_stream(name, stream, str(folder / name))
    if name in header.streams and not replace:
        raise DataError(f"the dive has a stream {name!r}", where=str(folder), remedy="ask for it to be replaced")
    file = _table_file(folder, name) if name in header.streams else folder / f"{name}.parquet"
    with atomic_file(file) as partial:
        write_table(partial, table_from_stream(name, stream))
    if name not in header.streams:
        values = read_yaml(folder / HEADER)
        values["streams"] = [*values["streams"], name]
        with atomic_file(folder / HEADER) as partial:
            partial.write_text(_yaml_text(values, folder / HEADER), encoding="utf-8")


def _header_text(dive: Dive, path: str | Path) -> str:
    header = {
        "origin": {"lat_deg": float(np.degrees(dive.origin.lat)), "lon_deg": float(np.degrees(dive.origin.lon))},
        "rig": dive.rig.model_dump(mode="json"),
        "streams": [*(name for name, _ in dive.streams()), *(f"images/{camera}" for camera in dive.images)],
        "provenance": dict(dive.provenance),
    }
    return _yaml_text(header, Path(path) / HEADER)


def _yaml_text(header: dict[str, Any], where: Path) -> str:
    try:
        return yaml.safe_dump(header, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    except yaml.YAMLError as error:
        raise DataError(
            f"the provenance holds what YAML cannot ({str(error)[:100]})",
            where=str(where),
            remedy="use plain numbers, texts, lists and dicts",
        ) from error


def _stem(folder: Path, name: str) -> Path:
    return folder / name / "index" if name.startswith("images/") else folder / name


def _table_file(folder: Path, name: str) -> Path:
    """The one file of a listed stream."""
    stem = _stem(folder, name)
    there = [file for suffix in FORMATS if (file := stem.with_name(stem.name + suffix)).exists()]
    if len(there) == 1:
        return there[0]
    if there:
        raise DataError(
            f"{there[0].name} and {there[1].name} are both there",
            where=str(folder),
            remedy="remove one of them: which holds the data cannot be guessed",
        )
    raise DataError(
        f"{stem.name}.parquet (or .csv) is missing, but {HEADER} lists {name!r}",
        where=str(stem.parent),
        remedy=f"copy the file there, or take {name!r} off the list of streams",
    )


def _refuse_unlisted(folder: Path, listed: tuple[str, ...]) -> None:
    cameras = [f"images/{camera.name}" for camera in sorted((folder / "images").glob("*")) if camera.is_dir()]
    for name in [*STREAM_TYPES, *cameras]:
        stem = _stem(folder, name)
        there = [stem.name + suffix for suffix in FORMATS if stem.with_name(stem.name + suffix).exists()]
        if there and name not in listed:
            raise DataError(
                f"{there[0]} is there, but {HEADER} does not list {name!r}",
                where=str(stem.parent),
                remedy=f"add {name!r} to the list of streams, or move the file away",
            )


def _read_stream(name: str, file: Path, origin: Origin) -> Stream:
    kind, _, camera = name.partition("/")
    table = read_table(file, stream_columns(kind))
    stream = stream_from_table(kind, table, origin, str(file), camera)
    if isinstance(stream, Images):
        _check_images(stream, file)
    return stream


def _check_images(images: Images, index: Path) -> None:
    for row, name in enumerate(images.file, start=1):
        place = PurePosixPath(str(name))
        if place.is_absolute() or ".." in place.parts:
            raise DataError(
                f"row {row} leads out of the folder: {name!s}",
                where=f"{index}: file",
                remedy="give paths relative to the camera's folder",
            )
        if not (index.parent / place).is_file():
            raise DataError(
                f"row {row} names {name!s}, which is not there",
                where=f"{index}: file",
                remedy="copy the image there, or remove the row",
            )


def copy_images(dive: Dive, source: Path, folder: Path) -> None:
    """Copy the image files and calibrations of a dive from the folder ``source`` of a dive into another."""
    for camera, images in dive.images.items():
        _copy_camera(images, source / "images" / camera, folder / "images" / camera)


def _copy_camera(images: Images, source: Path, place: Path) -> None:
    for name in map(str, images.file):
        target = place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target)
    if (source / CAMERA_FILE).is_file():
        shutil.copyfile(source / CAMERA_FILE, place / CAMERA_FILE)
