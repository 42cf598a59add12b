"""ROS 2 bags: a folder with ``metadata.yaml`` and files of either storage, or such files alone."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Final

from pydantic import BaseModel

from uwgraph.dive.readers.inflate import InflateError, inflate_file, inflate_message
from uwgraph.dive.readers.mcapfile import McapStorage
from uwgraph.dive.readers.mcapfile import open_storage as open_mcap
from uwgraph.dive.readers.ros_log import Channel, Message
from uwgraph.dive.readers.sqlitebag import SqliteBag, open_database
from uwgraph.dive.yamlfile import parse_settings, read_yaml
from uwgraph.errors import DataError

METADATA: Final = "metadata.yaml"
_KEY: Final = "rosbag2_bagfile_information"
_ZSTD: Final = ".zstd"
File = SqliteBag | McapStorage
Opener = Callable[[Path, str], AbstractContextManager[File]]
_OPENERS: Final[dict[str, Opener]] = {"sqlite3": open_database, "mcap": open_mcap}
_SUFFIXES: Final = {".db3": "sqlite3", ".mcap": "mcap"}


class Metadata(BaseModel):
    """What is used of ``metadata.yaml``, versions 1 to 9; the rest is ignored."""

    storage_identifier: str
    relative_file_paths: list[str]
    compression_format: str = ""
    compression_mode: str = ""
    ros_distro: str = ""


@dataclass(frozen=True)
class _Layout:
    """The files of a bag, and how they are written."""

    path: Path
    files: tuple[Path, ...]
    storage: str
    per_file: bool = False
    per_message: bool = False
    distribution: str = "humble"
    caveats: tuple[str, ...] = ()


def bag_files(path: Path) -> list[Path]:
    """The storage files in a folder, in the order of their numbers; of a file, the file itself."""
    if not path.is_dir():
        return [path] if _storage(path) else []
    found = [file for file in path.iterdir() if _storage(file) and file.is_file()]
    return sorted(found, key=lambda file: (len(file.name), file.name))


@contextmanager
def open_bag(path: Path) -> Iterator[Rosbag2]:
    """A bag, open; raises DataError or ConfigError when it cannot be read at all."""
    layout = _described(path) if (path / METADATA).is_file() else _undescribed(path)
    with ExitStack() as stack:
        files = layout.files
        if layout.per_file:
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="uwgraph-")))
            files = tuple(_inflated(file, folder / file.stem) for file in files)
        opener = _OPENERS[layout.storage]
        yield Rosbag2(layout, [stack.enter_context(opener(file, layout.distribution)) for file in files])


class Rosbag2:
    """The messages of all files of a bag, one file after the other."""

    def __init__(self, layout: _Layout, files: Sequence[File]) -> None:
        self._layout = layout
        self._files = files
        self._current = 0

    @property
    def caveats(self) -> tuple[str, ...]:
        broken = zip(self._layout.files, self._files, strict=True)
        return (*self._layout.caveats, *(f"{name.name}: {caveat}" for name, file in broken for caveat in file.caveats))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of all files; their number in the file is kept in steps of the number of files."""
        return tuple(
            replace(channel, id=channel.id * len(self._files) + number)
            for number, file in enumerate(self._files)
            for channel in file.channels
        )

    def messages(self, wanted: Collection[int]) -> Iterator[Message]:
        total = len(self._files)
        for number, file in enumerate(self._files):
            self._current = number
            for channel, t_ns, data, at in file.messages({id_ // total for id_ in wanted if id_ % total == number}):
                yield channel * total + number, t_ns, self._plain(data, at), at

    def where(self, at: int) -> str:
        name = self._layout.files[self._current]
        return f"{name}: {self._files[self._current].damage.unit} {at}" if at else str(self._layout.path)

    def share(self) -> float:
        return (self._current + self._files[self._current].share()) / len(self._files)

    def _plain(self, data: bytes | memoryview, at: int) -> bytes | memoryview:
        if not self._layout.per_message:
            return data
        try:
            return inflate_message(data)
        except InflateError as error:
            raise DataError(str(error), where=self.where(at), remedy="copy the log again") from error


def _described(path: Path) -> _Layout:
    """As ``metadata.yaml`` says."""
    where = path / METADATA
    values = read_yaml(where)
    about = values.get(_KEY) if isinstance(values, dict) else None
    metadata = parse_settings(Metadata, about, f"{where}: {_KEY}")
    if metadata.storage_identifier not in _OPENERS:
        raise DataError(
            f"storage {metadata.storage_identifier[:30]!r} is not read; known: {', '.join(_OPENERS)}",
            where=str(where),
            remedy="convert the bag with 'ros2 bag convert'",
        )
    mode = metadata.compression_mode.lower() or "none"
    if mode != "none" and (mode not in ("file", "message") or metadata.compression_format != "zstd"):
        raise DataError(
            f"compression {metadata.compression_format[:30]!r} of {mode[:30]!r} is not read",
            where=str(where),
            remedy="convert the bag with 'ros2 bag convert'",
        )
    return _Layout(
        path=path,
        files=tuple(_inside(path, name) for name in metadata.relative_file_paths),
        storage=metadata.storage_identifier,
        per_file=mode == "file",
        per_message=mode == "message",
        distribution=metadata.ros_distro or "humble",
    )


def _undescribed(path: Path) -> _Layout:
    """A bag whose recording was cut off before the metadata were written, or one of its files."""
    files = bag_files(path)
    if not files:
        raise DataError("holds no file *.db3 or *.mcap", where=str(path), remedy="name the folder of a ROS 2 bag")
    storages = {_storage(file) for file in files}
    if len(storages) > 1:
        raise DataError("holds both *.db3 and *.mcap files", where=str(path), remedy="name one of them")
    compressed = {file.suffix == _ZSTD for file in files}
    return _Layout(
        path=path,
        files=tuple(files),
        storage=storages.pop(),
        per_file=True in compressed,
        caveats=(f"there is no {METADATA}: the recording was cut off, or the file stands alone",),
    )


def _inside(folder: Path, name: str) -> Path:
    """The file of the bag with that name; what leads elsewhere in it is not followed."""
    pure = PurePosixPath(name)
    file = folder / pure.name
    if pure.is_absolute() or ".." in pure.parts or "\\" in name or "\0" in name or not pure.name or not file.is_file():
        raise DataError(
            f"names {name[:100]!r}, which is no file of this folder",
            where=f"{folder / METADATA}: relative_file_paths",
            remedy="keep the files of a bag together in one folder",
        )
    return file


def _storage(file: Path) -> str:
    """The storage that a file's name tells, or nothing."""
    return _SUFFIXES.get(Path(file.stem).suffix if file.suffix == _ZSTD else file.suffix, "")


def _inflated(file: Path, target: Path) -> Path:
    try:
        inflate_file(file, target)
    except (InflateError, OSError) as error:
        raise DataError(str(error), where=str(file), remedy="copy the log again, or make room in TMPDIR") from error
    return target
