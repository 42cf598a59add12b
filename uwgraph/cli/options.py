"""Settings from a YAML file and from options, the options winning."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from uwgraph.errors import ConfigError, DataError

if TYPE_CHECKING:
    from pydantic import BaseModel

Model = TypeVar("Model", bound="BaseModel")


def settings_from(model: type[Model], file: Path | None, asked: Mapping[str, Any]) -> Model:
    """The settings; an option that was not given (None) leaves the file's value, or the default, alone.

    Raises
    ------
    ConfigError
        Naming the file or the command line, the key, and what would do.
    """
    from uwgraph.dive.yamlfile import parse_settings, read_yaml

    given = {name: value for name, value in asked.items() if value is not None}
    if file is None:
        return parse_settings(model, given, "command line")
    values = read_yaml(file)
    stated = parse_settings(model, values, str(file)).model_dump(exclude_unset=True)
    return parse_settings(model, stated | given, "command line")


def utc_ns(text: str, where: str) -> int:
    """Nanoseconds UTC of an ISO 8601 time with a zone.

    Raises
    ------
    ConfigError
        When it is no time, or has no zone.
    """
    from uwgraph.dive.validate import EARLIEST_NS, LATEST_NS
    from uwgraph.time import from_datetime

    try:
        t_ns = from_datetime(datetime.fromisoformat(text))
        if not EARLIEST_NS <= t_ns <= LATEST_NS:
            raise ConfigError(f"{text} is not between 1990 and 2100", where=where, remedy="give the time of the dive")
        return t_ns
    except ValueError as error:
        raise ConfigError(f"{text!r} is no time", where=where, remedy="write 2022-06-08T09:00:00Z") from error
    except DataError as error:
        raise ConfigError(error.problem, where=where, remedy=error.remedy) from error


def instant(text: str | None, where: str) -> int | float | None:
    """Seconds from the start as a float, or nanoseconds UTC of an ISO 8601 time with a zone; None for None.

    Raises
    ------
    ConfigError
        When it is neither.
    """
    if text is None:
        return None
    try:
        seconds = float(text)
    except ValueError:
        return utc_ns(text, where)
    if not abs(seconds) <= 1e9:
        raise ConfigError(f"{text!r} is no time", where=where, remedy="give seconds from the start")
    return seconds
