"""KML for Google Earth: the track as a line and as a gx:Track that plays in time; fixes as points.

Altitudes are absolute, against the sea surface: a dive lies below it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent, register_namespace

import numpy as np

from uwgraph.export.geojson import coordinates
from uwgraph.export.track import Track
from uwgraph.time import isoformat
from uwgraph.types import Fixes

KML: Final = "http://www.opengis.net/kml/2.2"
GX: Final = "http://www.google.com/kml/ext/2.2"

_LINE_COLOUR: Final = "ff3de8a8"
"""aabbggrr"""


def write_kml(track: Track | None, fixes: Fixes | None, path: Path, title: str) -> None:
    """A document with a folder per source."""
    register_namespace("", KML)
    register_namespace("gx", GX)
    root = Element(f"{{{KML}}}kml")
    document = _add(root, "Document")
    # XML has no way to write control characters, and names of folders may hold them.
    _add(document, "name", "".join(c for c in title if c.isprintable()))
    style = _add(document, "Style")
    style.set("id", "track")
    line = _add(style, "LineStyle")
    _add(line, "color", _LINE_COLOUR)
    _add(line, "width", "2")
    if track is not None:
        _add_track(document, track)
    if fixes is not None:
        _add_fixes(document, fixes)
    indent(root)
    ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _add_track(document: Element, track: Track) -> None:
    places = coordinates(track.lat, track.lon, track.height)
    times = [isoformat(t) for t in track.t_ns.tolist()]
    folder = _folder(document, track.name)
    if len(track) > 1:
        line = _geometry(_placemark(folder, f"{track.name}: line", "#track"), "LineString")
        _add(line, "coordinates", "\n".join(",".join(map(repr, place)) for place in places))
    moving = _placemark(folder, f"{track.name}: in time", "#track")
    played = SubElement(moving, f"{{{GX}}}Track")
    _add(played, "altitudeMode", "absolute")
    for time in times:
        _add(played, "when", time)
    for place in places:
        _gx(played, "coord", " ".join(map(repr, place)))
    if np.isfinite(track.rph).all():
        for roll, pitch, heading in np.degrees(track.rph).round(4).tolist():
            _gx(played, "angles", f"{heading} {pitch} {roll}")
    for word, k in (("start", 0), ("end", -1)):
        mark = _placemark(folder, f"{track.name}: {word}")
        _stamp(mark, times[k])
        _add(_geometry(mark, "Point"), "coordinates", ",".join(map(repr, places[k])))


def _add_fixes(document: Element, fixes: Fixes) -> None:
    folder = _folder(document, "fixes")
    places = coordinates(fixes.lat, fixes.lon, fixes.height)
    for t, source, place in zip(fixes.t_ns.tolist(), fixes.source, places, strict=True):
        mark = _placemark(folder, str(source))
        _stamp(mark, isoformat(t))
        _add(_geometry(mark, "Point"), "coordinates", ",".join(map(repr, place)))


def _folder(document: Element, name: str) -> Element:
    folder = _add(document, "Folder")
    _add(folder, "name", name)
    return folder


def _placemark(folder: Element, name: str, style: str = "") -> Element:
    mark = _add(folder, "Placemark")
    _add(mark, "name", "".join(c for c in name if c.isprintable()))
    if style:
        _add(mark, "styleUrl", style)
    return mark


def _stamp(mark: Element, time: str) -> None:
    _add(_add(mark, "TimeStamp"), "when", time)


def _geometry(mark: Element, kind: str) -> Element:
    geometry = _add(mark, kind)
    _add(geometry, "altitudeMode", "absolute")
    return geometry


def _add(parent: Element, tag: str, text: str | None = None) -> Element:
    element = SubElement(parent, f"{{{KML}}}{tag}")
    element.text = text
    return element


def _gx(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, f"{{{GX}}}{tag}").text = text
