"""Kalibr's and OpenCV's camera files, as the values of our own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np

from uwgraph.dive.yamlfile import parse_yaml
from uwgraph.errors import ConfigError
from uwgraph.types import FloatArray

_KALIBR_DISTORTION: Final = {"radtan": "pinhole", "equidistant": "fisheye", "equi": "fisheye", "none": "pinhole"}
_FISHEYE_MARKERS: Final = ("fisheye", "equidistant", "kannala_brandt")


_OURS: Final = ("mount", "R_bs", "translation_m", "port", "analyser", "mosaic", "polarizer_deg", "sensor")
"""Keys of ours that may be added to a file of any format."""
_MATRIX: Final = ("camera_matrix", "K", "Camera_Matrix")
_DISTORTION: Final = ("distortion_coefficients", "D", "Distortion_Coefficients", "dist_coeffs", "distortion")


def is_kalibr(values: Mapping[str, Any]) -> bool:
    return "camera_model" in values or any("camera_model" in _dict(camera) for camera in values.values())


def kalibr_camera(chain: Mapping[str, Any], where: str, camera: str | None = None) -> tuple[dict[str, Any], str]:
    """A camera of a camchain, the first one by default, or a camera by itself; and where it stands.

    Raises
    ------
    ConfigError
        When there is no such camera.
    """
    if "camera_model" in chain:
        return dict(chain), where
    cameras = {str(key): value for key, value in chain.items() if "camera_model" in _dict(value)}
    name = camera or min(cameras)
    if name not in cameras:
        raise ConfigError(f"there is no camera {name!r}", where=where, remedy=f"it has {', '.join(sorted(cameras))}")
    return cameras[name], f"{where}: {name}"


def kalibr_values(chain: Mapping[str, Any], where: str, camera: str | None = None) -> dict[str, Any]:
    """The values of a camera of a camchain (pinhole-radtan, pinhole-equi), the first one by default."""
    values, where = kalibr_camera(chain, where, camera)
    model, bend = str(values["camera_model"]), str(values.get("distortion_model", "none"))
    if model != "pinhole" or bend not in _KALIBR_DISTORTION:
        raise ConfigError(
            f"camera model {model}-{bend} is not supported",
            where=where,
            remedy="calibrate as pinhole-radtan or pinhole-equi",
        )
    for key, count in (("intrinsics", 4), ("resolution", 2)):
        if not isinstance(values.get(key), list) or len(values[key]) != count:
            raise ConfigError(f"needs a list of {count} numbers", where=f"{where}.{key}", remedy="export it again")
    fu, fv, cu, cv = values["intrinsics"]
    return {
        "model": _KALIBR_DISTORTION[bend],
        "f": [fu, fv],
        "c": [cu, cv],
        "size": values["resolution"],
        "distortion": [] if bend == "none" else values.get("distortion_coeffs"),
        **_ours(values),
    }


def is_matrix_file(values: Mapping[str, Any]) -> bool:
    """Whether a camera is told by OpenCV's names without its tags: ROS camera_info, or fx, fy, cx, cy."""
    return "f" not in values and any(key in values for key in (*_MATRIX, "fx"))


def is_opencv(text: str) -> bool:
    """Whether a text looks as ``cv2.FileStorage`` writes it."""
    return text.lstrip("\ufeff \r\n\t").startswith(("%YAML:1.0", "<?xml", "<opencv_storage")) or "!!opencv-" in text


def file_values(text: str, where: str) -> dict[str, Any]:
    """The keys of a calibration file: plain YAML, or as ``cv2.FileStorage`` writes it."""
    values = opencv_storage(text, where) if is_opencv(text) else parse_yaml(text, where)
    return _dict(values)


def opencv_storage(text: str, where: str) -> dict[str, Any]:
    """The values of a FileStorage, YAML or XML. ``cv2.FileStorage`` itself dies of some damaged files."""
    if text.lstrip("\ufeff \r\n\t").startswith("<"):
        return _xml(text, where)
    plain = re.sub(r"!!opencv-[\w-]+|^\ufeff?%YAML:1\.0", "", text)
    values = parse_yaml(plain, where)
    return _dict(values)


def opencv_values(storage: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Our values of OpenCV's keys, as its FileStorage, ROS's camera_info or a plain file has them.

    camera_matrix (or K; or fx, fy, cx, cy), distortion_coefficients (or D), image_width and image_height (or width and
    height), and a model that says fisheye or equidistant where it is one.
    """
    K = _camera_matrix(storage, where)
    fisheye = str(storage.get("fisheye", storage.get("fisheye_model", 0))).lower() in ("1", "true", "yes") or any(
        marker in str(storage.get(key, "")).lower()
        for key in ("distortion_model", "model")
        for marker in _FISHEYE_MARKERS
    )
    return {
        "model": "fisheye" if fisheye else "pinhole",
        "f": [K[0, 0].item(), K[1, 1].item()],
        "c": [K[0, 2].item(), K[1, 2].item()],
        "size": storage["size"]
        if "size" in storage
        else [_first(storage, where, "image_width", "width"), _first(storage, where, "image_height", "height")],
        "distortion": _coefficients(storage, where, fisheye),
        **_ours(storage),
    }


def _camera_matrix(storage: Mapping[str, Any], where: str) -> FloatArray:
    if "fx" in storage:
        fx, fy, cx, cy = (_number(storage, where, key) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    K = _matrix(storage, where, *_MATRIX)
    if K.size != 9:
        raise ConfigError("is not a 3 x 3 matrix", where=f"{where}: camera_matrix", remedy="write it again")
    return K.reshape(3, 3)


def _coefficients(storage: Mapping[str, Any], where: str, fisheye: bool) -> list[float]:
    """Distortion as one matrix or list, or by name: k1 to k4 of a fisheye, k1, k2, p1, p2, k3 of a pinhole."""
    if any(storage.get(key) is not None for key in _DISTORTION):
        return [float(x) for x in _matrix(storage, where, *_DISTORTION).ravel()]
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if not any(name in storage for name in names):
        return []
    return [_number(storage, where, name) if name in storage else 0.0 for name in names]


def _number(storage: Mapping[str, Any], where: str, name: str) -> float:
    try:
        return float(_first(storage, where, name))
    except (TypeError, ValueError) as error:
        raise ConfigError("is no number", where=f"{where}: {name}", remedy="write it again") from error


def _ours(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: values[key] for key in _OURS if key in values}


def _xml(text: str, where: str) -> dict[str, Any]:
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise ConfigError("has XML declarations (<!...>), which are not accepted", where=where, remedy="remove them")
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \r\n\t").encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ConfigError(f"is not XML ({str(error)[:100]})", where=where, remedy="write it again") from error
    return {
        node.tag: {part.tag: (part.text or "").split() if part.tag == "data" else part.text for part in node}
        if len(node)
        else (node.text or "").strip()
        for node in root
    }


def _matrix(storage: Mapping[str, Any], where: str, *names: str) -> FloatArray:
    """A matrix with its rows and columns, or as lists."""
    found = _first(storage, where, *names)
    try:
        if isinstance(found, dict) and "sizes" in found:
            return np.atleast_2d(np.array(found["data"], dtype=np.float64))
        if isinstance(found, dict):
            return np.array(found["data"], dtype=np.float64).reshape(int(found["rows"]), int(found["cols"]))
        return np.atleast_2d(np.array(found, dtype=np.float64))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError("is not a matrix", where=f"{where}: {names[0]}", remedy="write it again") from error


def _first(storage: Mapping[str, Any], where: str, *names: str) -> Any:
    for name in names:
        if storage.get(name) is not None:
            return storage[name]
    raise ConfigError("is missing", where=f"{where}: {names[0]}", remedy="add it")


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
