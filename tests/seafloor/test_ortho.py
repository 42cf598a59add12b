"""The picture from above: where things land, and which image is on top."""

from __future__ import annotations

import numpy as np

from uwgraph.seafloor.ortho import Raster, lay
from uwgraph.seafloor.patch import Patch

STEP = 5


def square(colour: int, size: float = 1.0, nodes: int = 8) -> Patch:
    """A level square of the floor below the body, one colour, its first row to the north."""
    edge = ((np.arange(nodes) + 0.5) / nodes - 0.5) * size
    north, east = np.meshgrid(-edge, edge, indexing="ij")
    points = np.stack([north, east, np.full_like(north, 3.0)], axis=-1).astype(np.float32)
    texture = np.full((nodes * STEP, nodes * STEP, 3), colour, dtype=np.uint8)
    sigma = np.full((nodes, nodes), 0.01, dtype=np.float32)
    return Patch(1, points, sigma, 0.0, np.ones((nodes, nodes), bool), texture)


def around(pixel: float = 0.025, half: float = 1.0) -> Raster:
    return Raster.around(np.array([-half, -half]), np.array([half, half]), pixel, 10**6)


EYE = np.eye(3)


def test_a_square_lands_on_its_place_and_nowhere_else() -> None:
    raster = around()
    canvas = raster.blank()
    made = square(200)
    made.texture[: 4 * STEP] = 40  # the northern half
    lay(canvas, raster, made, EYE, np.array([0.25, -0.25, 0.0]))
    covered = canvas[..., 3] > 0
    rows, columns = np.nonzero(covered)
    assert (rows.min(), rows.max()) == (10, 49)  # north 0.75 to -0.25 below an upper edge at 1
    assert (columns.min(), columns.max()) == (10, 49)
    assert covered.sum() == 1600
    assert (canvas[10:29, 10:50, 0] == 40).all()
    assert (canvas[31:50, 10:50, 0] == 200).all()


def test_turned_by_a_quarter_the_first_row_is_east() -> None:
    raster = around()
    canvas = raster.blank()
    made = square(200)
    made.texture[: 4 * STEP] = 40
    lay(canvas, raster, made, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    assert (canvas[30:50, 45:58, 0] == 40).all()
    assert (canvas[30:50, 22:35, 0] == 200).all()


def test_textures_coarser_or_finer_than_the_raster_leave_no_holes() -> None:
    for pixel in (0.004, 0.01, 0.013, 0.06):
        raster = around(pixel)
        canvas = raster.blank()
        lay(canvas, raster, square(90), EYE, np.zeros(3))
        middle = raster.column_row(np.array([[0.45, -0.45], [-0.45, 0.45]])).astype(int)
        window = canvas[middle[0, 1] : middle[1, 1], middle[0, 0] : middle[1, 0]]
        assert (window == [90, 90, 90, 255]).all()


def test_later_lies_on_top_with_soft_edges() -> None:
    raster = around()
    canvas = raster.blank()
    lay(canvas, raster, square(200, size=1.8), EYE, np.zeros(3))
    lay(canvas, raster, square(100), EYE, np.zeros(3))
    line = canvas[40, :, 0].astype(int)
    assert line[40] == 100
    assert line[8] == 200
    ramp = line[20:30]
    assert (np.diff(ramp) <= 0).all()
    assert 100 < ramp[2] < 200


def test_stretched_and_unknown_points_are_not_drawn() -> None:
    raster = around()
    canvas = raster.blank()
    made = square(90)
    made.points_b[0, 0] = np.nan
    made.points_b[4, 4, 1] += 0.9  # a mismatch that would smear the texture
    lay(canvas, raster, made, EYE, np.zeros(3))
    assert canvas[30:50, 61:].max() == 0
    assert canvas[21, 21, 3] == 0
    assert canvas[55, 30, 3] == 255


def test_outside_the_raster_nothing_happens() -> None:
    raster = around()
    canvas = raster.blank()
    lay(canvas, raster, square(90), EYE, np.array([500.0, 0.0, 0.0]))
    assert not canvas.any()
    lay(canvas, raster, square(90), EYE, np.array([1.0, 1.0, 0.0]))
    assert canvas[:19, 61:, 3].all()


def test_the_raster_is_bounded() -> None:
    wide = Raster.around(np.array([0.0, 0.0]), np.array([5_000.0, 9_000.0]), 0.005, 1_000_000)
    assert wide.width * wide.height < 1_010_000
    line = Raster.around(np.array([0.0, 0.0]), np.array([0.0, 1e5]), 0.005, 1_000_000)
    assert line.width * line.height < 1_010_000
    assert Raster.around(np.zeros(2), np.zeros(2), 0.01, 10_000).blank().shape == (1, 1, 4)
