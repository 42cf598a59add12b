"""Cleaning by Open3D: statistical outliers away, normals on."""

from __future__ import annotations

from types import ModuleType
from typing import Final

import numpy as np

from uwgraph.errors import DataError
from uwgraph.seafloor.fuse import Cloud
from uwgraph.types import FloatArray

NEIGHBOURS: Final = 24
"""A point is compared with so many."""
DEVIATIONS: Final = 3.0
"""Mean distances to the neighbours beyond so many standard deviations are an outlier's."""
NORMAL_CELLS: Final = 4.0
"""Normals are those of the points within so many cells."""


def open3d() -> ModuleType:
    """The library, which takes a second to load and a system library that its wheel does not bring.

    Raises
    ------
    DataError
        When it cannot be loaded; the remedy names the package or the system library.
    """
    try:
        import open3d as library
    except (ImportError, OSError) as error:  # the package, or a shared library that it loads
        raise DataError(f"cannot be loaded ({str(error)[:120]})", where="open3d", remedy=_remedy(str(error))) from error
    return library


def cleaned(cloud: Cloud, voxel: float) -> tuple[Cloud, FloatArray]:
    """The cloud without statistical outliers, and unit normals (M, 3) in n that point up; raises as :func:`open3d`."""
    o3d = open3d()
    if len(cloud) <= NEIGHBOURS:
        return cloud, np.tile([0.0, 0.0, -1.0], (len(cloud), 1))
    centre = cloud.points_n.mean(axis=0)
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points_n - centre))
    points, kept = points.remove_statistical_outlier(NEIGHBOURS, DEVIATIONS)
    points.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMAL_CELLS * voxel, NEIGHBOURS))
    points.orient_normals_to_align_with_direction(np.array([0.0, 0.0, -1.0]))
    return cloud.select(np.asarray(kept, dtype=np.intp)), np.asarray(points.normals, dtype=np.float64)


def _remedy(message: str) -> str:
    for library, packages in _SYSTEM.items():
        if library in message:
            return f"install the system library {library}: {packages}"
    return "install it: pip install open3d"


_SYSTEM: Final = {
    "libusb-1.0": "apt install libusb-1.0-0 (Debian, Ubuntu), dnf install libusb1 (Fedora), brew install libusb",
    "libGL": "apt install libgl1 (Debian, Ubuntu), dnf install mesa-libGL (Fedora)",
    "libgomp": "apt install libgomp1 (Debian, Ubuntu), dnf install libgomp (Fedora)",
    "libX11": "apt install libx11-6 (Debian, Ubuntu), dnf install libX11 (Fedora)",
    "libEGL": "apt install libegl1 (Debian, Ubuntu), dnf install mesa-libEGL (Fedora)",
}
