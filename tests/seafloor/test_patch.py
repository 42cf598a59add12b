"""Patches on disk, and where their pixels lie."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.errors import DataError
from uwgraph.seafloor.patch import Patch, read_patch, write_patch

STEP = 4


def patch(rows: int = 6, columns: int = 8) -> Patch:
    """A plane 3 m below, a smooth texture."""
    v, u = np.indices((rows, columns), dtype=np.float32)
    points = np.stack([-0.1 * v, 0.1 * u, 3.0 + 0.01 * u], axis=-1)
    shade = np.indices((rows * STEP, columns * STEP)).sum(axis=0) * 3
    texture = np.repeat(shade[..., None], 3, axis=2).astype(np.uint8)
    return Patch(123, points, np.full((rows, columns), 0.02, np.float32), 0.01, np.ones((rows, columns), bool), texture)


def test_back_from_disk(tmp_path: Path) -> None:
    made = patch()
    made.points_b[1, 2] = np.nan
    made.measured[0, 0] = False
    write_patch(tmp_path, made)
    read = read_patch(tmp_path / "123.npz")
    assert read.t_ns == 123
    assert read.common == 0.01
    np.testing.assert_array_equal(read.points_b, made.points_b)
    assert not read.measured[1, 2]
    assert np.isnan(read.sigma[1, 2])
    assert not read.measured[0, 0]
    assert np.isfinite(read.points_b[0, 0]).all()
    assert np.abs(read.texture.astype(int) - made.texture).max() <= 6


def test_pixels_lie_between_the_points_and_go_on_beyond_them() -> None:
    R, p = Rotation.from_rotvec([0.1, -0.2, 0.5]).as_matrix(), np.array([1000.0, -500.0, 20.0])
    made = patch()
    at = made.pixels_n(R, p)
    assert at.shape == (24, 32, 3)
    v, u = np.indices((24, 32))
    nodes = [(v + 0.5) / STEP - 0.5, (u + 0.5) / STEP - 0.5]
    expected = np.stack([-0.1 * nodes[0], 0.1 * nodes[1], 3.0 + 0.01 * nodes[1]], axis=-1) @ R.T + p
    np.testing.assert_allclose(at, expected, atol=2e-6)


def _rewritten(path: Path, **arrays: object) -> None:
    with np.load(path) as there:
        values = {name: there[name] for name in there.files}
    np.savez(path, **(values | arrays))


@pytest.mark.parametrize(
    "change",
    [
        {"sigma": np.ones((6, 9), np.float32)},
        {"points_b": np.ones((6, 8), np.float32)},
        {"jpeg": np.zeros(40, np.uint8)},
        {"jpeg": np.zeros(0, np.uint8)},
        {"sigma": np.full((6, 8), "a")},
        {"points_b": np.array([{"a": 1}], dtype=object)},
        {"sigma": np.ones((2, 2), np.float32), "points_b": np.ones((2, 2, 3)), "measured": np.ones((2, 2), bool)},
        {"sigma": np.ones((0, 8)), "points_b": np.ones((0, 8, 3)), "measured": np.ones((0, 8), bool)},
    ],
)
def test_files_that_are_no_patches(tmp_path: Path, change: dict[str, object]) -> None:
    write_patch(tmp_path, patch())
    _rewritten(tmp_path / "123.npz", **change)
    with pytest.raises(DataError, match=r"123\.npz"):
        read_patch(tmp_path / "123.npz")


def test_damaged_files(tmp_path: Path) -> None:
    write_patch(tmp_path, patch())
    file = tmp_path / "123.npz"
    whole = file.read_bytes()
    for part in (b"", whole[:50], whole[: len(whole) // 2], b"PK\x03\x04" + whole[4:100]):
        file.write_bytes(part)
        with pytest.raises(DataError):
            read_patch(file)
    file.unlink()
    with pytest.raises(DataError):
        read_patch(file)


def test_what_cannot_be_a_point_is_none(tmp_path: Path) -> None:
    made = patch()
    made.points_b[0, 0, 1], made.points_b[0, 1, 2] = np.inf, 1e9
    write_patch(tmp_path, replace(made, sigma=np.where(made.points_b[..., 1] > 0.65, -1.0, made.sigma)))
    read = read_patch(tmp_path / "123.npz")
    assert not read.measured[0, 0]
    assert not read.measured[0, 1]
    assert not read.measured[:, 7].any()
    assert read.measured[1:, :7].all()
