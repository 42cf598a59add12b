"""The sqlite3 storage of ROS 2 bags: tables ``topics`` and ``messages``, and since Iron ``message_definitions``.

The reader of rosbags counts and sorts before the first message, which a damaged database does not survive, and puts no
limit on what is in a column. Here rows are read as they lie, with SQLite's own limits set.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from rosbags.typesys.msg import normalize_msgtype

from uwgraph.dive.readers.damage import Damage
from uwgraph.dive.readers.inflate import MAX_BLOCK
from uwgraph.dive.readers.ros_log import Channel, Message
from uwgraph.dive.readers.ros_types import MessageType
from uwgraph.errors import DataError

MAGIC: Final = b"SQLite format 3\0"
MAX_TOPICS: Final = 1 << 16
STEPS_PER_BYTE: Final = 20
"""Instructions of SQLite's machine that a query may take per byte of the file (pages in circles take more)."""
_EVERY: Final = 100_000
"""Instructions between two looks at that limit."""
_COLUMNS: Final = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"topic_id", "timestamp", "data"},
    "message_definitions": {"topic_type", "encoding", "encoded_message_definition"},
}


@contextmanager
def open_database(path: Path, distribution: str = "humble") -> Iterator[SqliteBag]:
    """A file ``*.db3``, open; raises DataError when it is none."""
    try:
        with path.open("rb") as file:
            sound = file.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror or error})", where=str(path), remedy="check the name and the permissions"
        ) from error
    if not sound:
        raise DataError("is no SQLite database", where=str(path), remedy="copy it again from the vehicle")
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        try:
            yield SqliteBag(path, database, distribution)
        except (sqlite3.Error, OverflowError) as error:
            raise DataError(
                f"the database is damaged ({error})", where=str(path), remedy="copy it again, or try 'sqlite3 .recover'"
            ) from error


class SqliteBag:
    """The messages of one database, in the order in which they were written."""

    def __init__(self, path: Path, database: sqlite3.Connection, distribution: str) -> None:
        self.damage = Damage("message")
        self._path = path
        self._database = database
        self._distribution = distribution
        self._share = 0.0
        self._steps = 0
        self._most_steps = STEPS_PER_BYTE * path.stat().st_size + 10 * _EVERY
        database.text_factory = lambda text: text.decode("utf-8", "replace")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BLOCK)
        database.set_progress_handler(self._too_many_steps, _EVERY)
        # the last lets SQLite read a file that is cut off; nothing can be written to it here
        for pragma in ("cell_size_check = 1", "trusted_schema = 0", "writable_schema = 1"):
            database.execute(f"PRAGMA {pragma}")
        if not (self._has("topics") and self._has("messages")):
            raise DataError(
                "is a database, but not of a ROS 2 bag: it needs the tables topics and messages",
                where=str(path),
                remedy="name a file that 'ros2 bag record' wrote",
            )

    @property
    def caveats(self) -> tuple[str, ...]:
        log = self._path.with_name(f"{self._path.name}-wal")
        if log.is_file() and log.stat().st_size:
            unmerged = (
                f"{log.name} holds messages that are not in the database yet and are not read: "
                f"open {self._path.name} once with sqlite3 to merge them"
            )
            return (unmerged, *self.damage.caveats)
        return self.damage.caveats

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """The topics, with their messages counted."""
        definitions = self._definitions()
        counts = Counter(row[0] for row in self._sound("SELECT topic_id FROM messages ORDER BY rowid"))
        return tuple(
            Channel(id_, topic, self._kind(name, encoding, definitions), counts[id_])
            for id_, topic, name, encoding in self._query(
                f"SELECT id, name, type, serialization_format FROM topics LIMIT {MAX_TOPICS}"
            )
            if isinstance(id_, int) and all(isinstance(text, str) for text in (topic, name, encoding))
        )

    def messages(self, wanted: Collection[int]) -> Iterator[Message]:
        ids = ",".join(str(int(channel)) for channel in wanted) or "NULL"
        (last,) = next(iter(self._sound("SELECT max(rowid) FROM messages")), (None,))
        for row, channel, stamp, data in self._sound(
            f"SELECT rowid, topic_id, timestamp, data FROM messages WHERE topic_id IN ({ids}) ORDER BY rowid"
        ):
            self._share = row / (last or row or 1)
            if isinstance(stamp, int) and isinstance(data, bytes):
                yield channel, stamp, data, row
            else:
                self.damage.skip(row, "no stamp, or no content")

    def where(self, at: int) -> str:
        return f"{self._path}: message {at}" if at else str(self._path)

    def share(self) -> float:
        return min(max(self._share, 0.0), 1.0)

    def _sound(self, query: str) -> Iterator[tuple[Any, ...]]:
        """The rows of a query over the messages, up to where the database is damaged."""
        rows = 0
        try:
            for row in self._query(query):
                yield row
                rows += 1
        except (sqlite3.Error, OverflowError) as error:
            self.damage.end(rows + 1, str(error))

    def _query(self, query: str, *values: str) -> Iterator[tuple[Any, ...]]:
        self._steps = 0
        yield from self._database.execute(query, values)

    def _too_many_steps(self) -> bool:
        self._steps += _EVERY
        return self._steps > self._most_steps

    def _has(self, table: str) -> bool:
        """Whether there is a plain table of that name with the columns of a bag, none of them computed."""
        made = [str(sql) for (sql,) in self._query("SELECT sql FROM sqlite_master WHERE name = ?", table)]
        found = {column[1] for column in self._query(f"PRAGMA table_xinfo({table})") if column[6] == 0}
        return len(made) == 1 and made[0].upper().startswith("CREATE TABLE") and _COLUMNS[table] <= found

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Definition and how it is written, by type."""
        if not self._has("message_definitions"):
            return {}
        query = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
        return {str(name): (str(text), str(encoding)) for name, text, encoding in self._query(query)}

    def _kind(self, name: str, encoding: str, definitions: dict[str, tuple[str, str]]) -> MessageType:
        definition, written = definitions.get(name, ("", ""))
        return MessageType(normalize_msgtype(name), encoding, definition, written, self._distribution)
