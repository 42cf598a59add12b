"""A log from its file to a dive: what is in it, the mapping given or guessed, and the provenance."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from uwgraph.atomic import FULL, atomic_file
from uwgraph.dive.logs.assemble import Wishes, assemble
from uwgraph.dive.logs.guess import Left, Taken, guess, of_mapping
from uwgraph.dive.logs.log import Log, LogReader, Progress, Topic
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.mapping_file import mapping_text
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError


@dataclass(frozen=True)
class LogOptions:
    """How a log is read."""

    mapping: LogMapping | None = None
    """Which topics to take; None: guessed from their types."""
    wishes: Wishes = field(default_factory=Wishes)
    mapping_out: Path | None = None
    """Where to write the mapping, before the log is read."""
    template: Path | None = None
    """Where to write it when nothing was guessed and there is no ``mapping_out``; not written over."""

    @property
    def says_nothing(self) -> bool:
        """Whether the log is left to speak for itself."""
        return replace(self, template=None) == LogOptions()


@dataclass(frozen=True)
class Survey:
    """What is in a log and what becomes of it."""

    topics: tuple[Topic, ...]
    mapping: LogMapping
    taken: tuple[Taken, ...]
    left: tuple[Left, ...]
    notes: tuple[str, ...] = ()
    """What the user must know of a guessed mapping."""

    @property
    def text(self) -> str:
        """The mapping file."""
        return mapping_text(self.mapping, self.topics, self.left)


@contextmanager
def opened(path: Path, reader: LogReader) -> Iterator[Log]:
    """The log, open; what the system refuses while it is read is told as the file's fault, but for a full disk."""
    try:
        with reader.open_log(path) as log:
            yield log
    except OSError as error:
        if error.errno in FULL:
            raise
        raise DataError(
            f"cannot be read ({error.strerror or error})", where=str(path), remedy="check the name and the permissions"
        ) from error


def survey_log(log: Log, reader: LogReader, options: LogOptions) -> Survey:
    """Look at an open log, and write the mapping file where the options ask for it.

    Raises
    ------
    ConfigError
        When the mapping names topics that the log has not.
    """
    if options.mapping is not None:
        survey = Survey(log.topics, options.mapping, *of_mapping(options.mapping, log.topics))
    else:
        guessed = guess(log.topics, reader.proposals)
        survey = Survey(log.topics, guessed.mapping, guessed.taken, guessed.left, guessed.notes)
    if options.mapping_out is not None:
        _write(options.mapping_out, survey.text)
    return survey


def read_log(
    path: Path, reader: LogReader, options: LogOptions, images_into: Path | None, progress: Progress
) -> tuple[Dive, Survey]:
    """The dive of a log, with its provenance.

    Raises
    ------
    ConfigError
        When the mapping does not fit the log.
    DataError
        When the log cannot be read, is damaged, or has nothing of use.
    """
    with opened(path, reader) as log:
        survey = survey_log(log, reader, options)
        if not survey.mapping.by_stream():
            raise _nothing(path, survey, options)
        dive, notes = assemble(log, survey.mapping, options.wishes, images_into, progress)
        caveats = [*log.caveats, *survey.notes, *notes.caveats]
    provenance = {
        "format": reader.NAME,
        "source": [path.name],
        "topics": {taken.stream: taken.topic for taken in survey.taken},
        "conversions": notes.conversions,
        "caveats": caveats,
    }
    return replace(dive, provenance=provenance), survey


def _nothing(path: Path, survey: Survey, options: LogOptions) -> DataError:
    """The error when no topic is known, and a file that shows what there is."""
    file = options.mapping_out or options.template
    if file is not None and not file.exists():
        _write(file, survey.text)
    return DataError(
        f"none of its {len(survey.topics)} topics is known to be of use",
        where=str(path),
        remedy=f"say what they are: edit {file} and give it with --mapping {file}"
        if file is not None
        else "'uwgraph import SRC DEST' writes a mapping file to edit",
    )


def _write(file: Path, text: str) -> None:
    with atomic_file(file) as partial:
        partial.write_text(text, encoding="utf-8")
