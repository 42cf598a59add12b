from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from evo.core import metrics as evo_metrics
from evo.core import sync, trajectory
from evo.tools import file_interface
from hand_made import as_reference, disturbed, shifted, truth

from uwgraph.errors import ConfigError, UwgraphError
from uwgraph.evaluate.metrics import metrics
from uwgraph.evaluate.output import FILES, write_solution
from uwgraph.evaluate.plot import track_plot
from uwgraph.evaluate.table import solution_table, trajectory_tum


def write(out: Path, *, overwrite: bool = False) -> None:
    solution = truth()
    write_solution(
        solution, out, metrics(solution, as_reference(solution)), {"max_iterations": 7}, "hello\n", overwrite=overwrite
    )


def test_the_folder_holds_every_file(tmp_path: Path) -> None:
    write(tmp_path / "out")
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == sorted(FILES)
    assert json.loads((tmp_path / "out/metrics.json").read_text())["matched"] == 400
    assert yaml.safe_load((tmp_path / "out/config.yaml").read_text()) == {"max_iterations": 7}
    assert (tmp_path / "out/run.log").read_text() == "hello\n"


def test_tum_stamps_are_exact(tmp_path: Path) -> None:
    lines = trajectory_tum(truth()).splitlines()
    stamps = [int(line.split()[0].replace(".", "")) for line in lines]
    assert stamps == truth().t_ns.tolist()
    assert all(len(line.split()[0].split(".")[1]) == 9 for line in lines)


def test_evo_reads_the_trajectory_and_agrees(tmp_path: Path) -> None:
    planted = disturbed(shifted(truth(), np.array([3.0, -4.0, 1.0])), np.random.default_rng(3))
    tracks = []
    for name, solution in (("est", planted), ("ref", truth())):
        (tmp_path / name).write_text(trajectory_tum(solution))
        tracks.append(file_interface.read_tum_trajectory_file(tmp_path / name))
    est, ref = tracks
    np.testing.assert_allclose(est.positions_xyz, planted.p_n, atol=1e-6)
    np.testing.assert_allclose(np.array(est.poses_se3)[:, :3, :3], planted.R_nb, atol=1e-10)

    ref, est = sync.associate_trajectories(ref, est)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    flat_ref, flat_est = flattened(ref), flattened(est)
    ape.process_data((flat_ref, flat_est))
    ours = metrics(planted, as_reference(truth()))
    assert ours["horizontal_rmse_m"] == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-5)


def flattened(track: trajectory.PoseTrajectory3D) -> trajectory.PoseTrajectory3D:
    flat = copy.deepcopy(track)
    xyz = flat.positions_xyz * np.array([1.0, 1.0, 0.0])
    return trajectory.PoseTrajectory3D(xyz, flat.orientations_quat_wxyz, flat.timestamps)


def test_the_table_is_in_peoples_units() -> None:
    solution = truth()
    table: pd.DataFrame = solution_table(solution).to_pandas()
    assert table["t_ns"].tolist() == solution.t_ns.tolist()
    reference = as_reference(solution)
    np.testing.assert_allclose(table["lat_deg"], np.degrees(reference.lat), rtol=0, atol=1e-12)
    np.testing.assert_allclose(table["heading_deg"], np.degrees(reference.rph[:, 2]) % 360, atol=1e-9)
    assert table["heading_deg"].between(0, 360).all()
    # The trace of the position covariance does not depend on the axes.
    total = np.sqrt(sum(table[f"sigma_{axis}"] ** 2 for axis in ("north", "east", "down")))
    np.testing.assert_allclose(total, np.sqrt(0.1**2 + 0.2**2 + 0.05**2))
    np.testing.assert_allclose(table["sigma_bias_gyro_x"], 1e-4)


def test_an_earlier_result_needs_overwrite(tmp_path: Path) -> None:
    write(tmp_path / "out")
    with pytest.raises(ConfigError, match="earlier result"):
        write(tmp_path / "out")
    (tmp_path / "out/track.png").write_bytes(b"old")
    write(tmp_path / "out", overwrite=True)
    assert not (tmp_path / "out/track.png").exists()


def test_a_foreign_folder_is_never_touched(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ConfigError, match="not a result"):
        write(tmp_path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_failure_on_the_way_leaves_nothing(tmp_path: Path) -> None:
    def fail(folder: Path) -> None:
        assert (folder / "metrics.json").is_file()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_solution(truth(), tmp_path / "out", {}, {}, "", extras=fail)
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UwgraphError, match="file"):
        write(tmp_path / "file" / "out")


@pytest.mark.parametrize("with_reference", [True, False])
def test_the_plot_is_a_picture(tmp_path: Path, with_reference: bool) -> None:
    solution = truth()
    track_plot(solution, as_reference(solution) if with_reference else None, tmp_path / "track.png", "dive")
    assert (tmp_path / "track.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert (tmp_path / "track.png").stat().st_size > 20_000
