"""Messages of ROS from bytes: types built from the definitions in the log, which are checked before they are believed.

rosbags makes Python code of a definition. A small definition can name a type that contains itself, or arrays of arrays
that unfold to billions of fields, so its parse tree is measured first.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from uwgraph.dive.readers.ros_known import KNOWN_DEFINITIONS

MAX_DEFINITION: Final = 1 << 16
"""Characters of a message definition ..."""
MAX_DEFINITIONS: Final = 1 << 21
"""... and of all that a log has: parsing takes up to 0.1 ms each."""
MAX_ELEMENTS: Final = 4096
"""Fields of a type with everything in it unfolded."""
MAX_DEPTH: Final = 16
MAX_NESTED: Final = 1 << 18
"""Bytes of a message with lists of structures or of text, and of JSON: they grow about 200 times in memory."""
DEFINITIONS: Final = {"ros1": "ros1msg", "cdr": "ros2msg"}
"""The encodings of messages that are read by definition, and how the definition must be written."""

Decode = Callable[[bytes | memoryview], Any]
_Types = Mapping[str, Any]
_TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TEXT: Final = ("string", "wstring")


class TypeTrouble(ValueError):
    """Why messages of a type cannot be read, in words."""


@dataclass(frozen=True)
class MessageType:
    """How the messages of one topic are written."""

    name: str
    """``sensor_msgs/msg/Imu``."""
    encoding: str
    """``ros1``, ``cdr``, ``json``; others are known by name only."""
    definition: str = ""
    """Empty where the log has none: a type of the standard packages, or a DVL's, is then known by its name."""
    definition_encoding: str = ""
    """``ros1msg``, ``ros2msg``, ``jsonschema``, ..."""
    distribution: str = "humble"
    """Of ROS 2, for definitions that the log does not have."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Paths of the numbers in a message; empty where they are not known before reading."""
        try:
            return () if self.encoding == "json" else tuple(_paths(_checked(self), self.name, ""))
        except TypeTrouble:
            return ()

    @property
    def unread(self) -> str:
        """Why its messages cannot be read, as far as that is seen without trying; else empty."""
        try:
            if self.encoding != "json":
                _checked(self)
        except TypeTrouble as error:
            return str(error)
        return ""

    def decoder(self) -> Decode:
        """What makes an object (fields by attribute) or a dict of a message's bytes; it may raise anything.

        Raises
        ------
        TypeTrouble
            When the encoding or the definition cannot be used.
        """
        return _decode_json if self.encoding == "json" else _decoder(self)


@lru_cache(maxsize=256)
def _decoder(kind: MessageType) -> Decode:
    types = _checked(kind)
    store = get_typestore(Stores.EMPTY)
    try:
        store.register({name: tree for name, tree in types.items() if name not in _TIMES})
        layout = store.get_msgdef(kind.name)
    except Exception as error:  # the code made of a definition that is none
        raise TypeTrouble(f"its definition cannot be used ({str(error)[:100]})") from error
    deserialize = store.deserialize_ros1 if kind.encoding == "ros1" else store.deserialize_cdr
    name = layout.name
    if not _grows(types, name):
        return lambda data: deserialize(data, name)

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > MAX_NESTED:
            raise ValueError(f"{len(data)} bytes of lists of structures are more than {MAX_NESTED}")
        return deserialize(data, name)

    return decode


def _decode_json(data: bytes | memoryview) -> Any:
    if len(data) > MAX_NESTED:
        raise ValueError(f"{len(data)} bytes of JSON are more than {MAX_NESTED}")
    return json.loads(bytes(data))


@lru_cache(maxsize=512)
def _checked(kind: MessageType) -> _Types:
    """The parse tree of a type and of all that it needs, measured; raises TypeTrouble."""
    if kind.encoding not in DEFINITIONS:
        raise TypeTrouble(f"messages are encoded as {kind.encoding[:30] or 'nothing known'!r}, which is not read")
    if kind.definition_encoding not in ("", DEFINITIONS[kind.encoding]):
        raise TypeTrouble(f"its definition is written as {kind.definition_encoding[:30]!r}, which is not read")
    types = _parsed(kind) if kind.definition.strip() else _known(kind)
    needed: dict[str, tuple[int, bool]] = {}
    _measure(types, kind.name, (), needed)
    return {name: types[name] for name in needed}


def _parsed(kind: MessageType) -> _Types:
    if len(kind.definition) > MAX_DEFINITION:
        raise TypeTrouble(f"its definition has more than {MAX_DEFINITION} characters")
    try:
        types = get_types_from_msg(kind.definition, kind.name)
    except Exception as error:  # the parser's own errors, and what it stumbles on in text that is none
        raise TypeTrouble(f"its definition cannot be read ({str(error)[-100:]!r})") from error
    return {**get_typestore(Stores.EMPTY).fielddefs, **types}


def _known(kind: MessageType) -> _Types:
    """Types that the log names and does not define."""
    types = _standard("ros1_noetic" if kind.encoding == "ros1" else f"ros2_{kind.distribution}").fielddefs
    if kind.name in types:
        return types
    if kind.name not in KNOWN_DEFINITIONS:
        raise TypeTrouble("the log has no definition of it, and it is not a standard one")
    return {**types, **_parsed(replace(kind, definition=KNOWN_DEFINITIONS[kind.name]))}


@lru_cache(maxsize=4)
def _standard(name: str) -> Typestore:
    known = {store.value: store for store in Stores}
    return get_typestore(known.get(name, Stores.ROS2_HUMBLE))


def _measure(types: _Types, name: str, above: Sequence[str], known: dict[str, tuple[int, bool]]) -> tuple[int, bool]:
    """How many fields a type unfolds to, and whether it takes any bytes."""
    if name in known:
        return known[name]
    if name in above:
        raise TypeTrouble(f"its definition contains itself ({name[:60]})")
    if name not in types:
        raise TypeTrouble(f"its definition lacks the type {name[:60]}")
    if len(above) > MAX_DEPTH:
        raise TypeTrouble(f"its definition is nested more than {MAX_DEPTH} deep")
    total, filled = 1, False
    for _, (node, what) in types[name][1]:
        inner, times = (what[0], what[1]) if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else ((node, what), 1)
        count, takes = (1, True) if inner[0] == Nodetype.BASE else _measure(types, inner[1], (*above, name), known)
        if node == Nodetype.SEQUENCE:
            if not takes:
                raise TypeTrouble("its definition has a list of things without content")
            total, filled = total + count, True
        else:
            plain = inner[0] == Nodetype.BASE and inner[1][0] not in _TEXT
            total += count if plain else count * times
            filled = filled or (takes and times > 0)
        if total > MAX_ELEMENTS:
            raise TypeTrouble(f"its definition unfolds to more than {MAX_ELEMENTS} fields")
    known[name] = (total, filled)
    return known[name]


def _grows(types: _Types, name: str) -> bool:
    """Whether a type holds lists of structures or of text."""
    for _, (node, what) in types[name][1]:
        if node == Nodetype.SEQUENCE and (what[0][0] == Nodetype.NAME or what[0][1][0] in _TEXT):
            return True
        inner = what[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, what)
        if inner[0] == Nodetype.NAME and _grows(types, inner[1]):
            return True
    return False


def _paths(types: _Types, name: str, prefix: str) -> list[str]:
    """Paths of the numbers of a type; of a list of structures those of its first element."""
    found: list[str] = []
    for field, (node, what) in types[name][1]:
        inner = what[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, what)
        path = f"{prefix}{field}"
        if inner[0] == Nodetype.BASE:
            found += [] if inner[1][0] in _TEXT else [path]
        elif inner[1] in _TIMES:
            found.append(path)
        else:
            found += _paths(types, inner[1], f"{path}." if inner is not what[0] else f"{path}[0].")
    return found


def number_paths(message: Any, prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Paths of the numbers in a message of JSON; of a list of objects those of its first."""
    if isinstance(message, bool | int | float):
        yield prefix
    elif isinstance(message, list) and message:
        if isinstance(message[0], dict):
            yield from number_paths(message[0], f"{prefix}[0]", depth + 1)
        elif isinstance(message[0], bool | int | float):
            yield prefix
    elif isinstance(message, dict) and depth < MAX_DEPTH:
        for name, value in message.items():
            yield from number_paths(value, f"{prefix}.{name}" if prefix else str(name), depth + 1)
