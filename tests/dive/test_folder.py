"""The dive folder: what is written reads back, and is either whole or not there."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.atomic import atomic_file, atomic_folder
from uwgraph.dive import Dive, Rig
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.layout import depth_from_pressure
from uwgraph.dive.rig import DvlRig
from uwgraph.errors import DataError
from uwgraph.types import (
    Altitude,
    Depth,
    Dvl,
    Fixes,
    Gravity,
    Heading,
    Images,
    Imu,
    Origin,
    Reference,
    RelativePoses,
    Stream,
    Sun,
    stream_fields,
)

START = 1_654_646_400_000_000_000
EVERY_STREAM = (
    *("imu", "dvl", "depth", "fixes", "heading", "sun", "gravity", "altitude", "odometry", "closures", "reference"),
)


def relative_poses(rng: np.random.Generator, t: np.ndarray) -> RelativePoses:
    n = len(t)
    factor = rng.normal(size=(n, 6, 6))
    cov = factor @ factor.swapaxes(1, 2)
    return RelativePoses(
        t,
        from_ns=t - rng.integers(1, 10**9, n),
        p=rng.normal(size=(n, 3)),
        rotvec=rng.uniform(-1, 1, (n, 3)),
        cov=0.5 * (cov + cov.swapaxes(1, 2)),
        accepted=rng.random(n) < 0.5,
        reason=np.array(["", "plane", "12 matches, fewer than 20"])[rng.integers(0, 3, n)],
        inliers=rng.integers(0, 500, n),
    )


def full_dive(seed: int = 0, n: int = 40) -> Dive:
    """A dive with every stream, random but valid."""
    rng = np.random.default_rng(seed)
    t = START + np.cumsum(rng.integers(1, 10**7, n))
    origin = Origin(lat=0.57, lon=0.61)
    spread = rng.normal(size=(n, 3, 3))
    cov = spread @ spread.swapaxes(1, 2) * 1e-3
    cov = 0.5 * (cov + cov.swapaxes(1, 2))
    sun = rng.normal(size=(n, 3))
    unknown = rng.random(n) < 0.3
    flat = cov.copy()
    flat[:, 2, :], flat[:, :, 2], flat[:, 2, 2] = 0.0, 0.0, np.inf
    reference_height = rng.normal(-20, 3, n)
    return Dive(
        origin=origin,
        rig=Rig(dvl=DvlRig(translation_m=(0.1, 0.2, 1 / 3), rotation_deg=(0.0, 0.0, 45.0))),
        imu=Imu(t, rng.normal((0, 0, -9.8), 0.3, (n, 3)), rng.normal(0, 0.1, (n, 3))),
        dvl=Dvl(t, rng.normal(0, 1, (n, 3)), np.where(unknown[:, None, None], np.nan, cov), rng.random(n) < 0.8),
        depth=Depth(t, rng.uniform(0, 50, n), np.where(unknown, np.nan, 0.05)),
        fixes=Fixes(
            np.repeat(t[::2], 2)[:n],
            *(0.57 + 1e-6 * rng.normal(size=n), 0.61 + 1e-6 * rng.normal(size=n)),
            np.where(unknown, np.nan, 0.1),
            np.where(unknown[:, None, None], flat, cov),
            np.array(["gnss", 'usbl é, "x"'])[rng.integers(0, 2, n)],
        ),
        heading=Heading(t, rng.uniform(-np.pi, np.pi, n), np.where(unknown, np.nan, 0.01), "magnetic"),
        sun=Sun(
            t,
            information_b=cov,
            s_b=sun / np.linalg.norm(sun, axis=1, keepdims=True),
            cov_b=np.where(unknown[:, None, None], np.nan, cov),
            method=np.full(n, "simulated"),
            quality=rng.random(n),
            flags=rng.integers(0, 8, n),
        ),
        gravity=Gravity(t, rng.normal(0, 1e-4, n), np.full(n, 1e-5), "anomaly"),
        altitude=Altitude(t, rng.uniform(1, 9, n), np.where(unknown, np.nan, 0.05)),
        odometry=relative_poses(rng, t),
        closures=relative_poses(rng, np.repeat(t[::2], 2)[:n]),
        reference=Reference(
            t,
            *(0.57 + 1e-6 * rng.normal(size=n), 0.61 + 1e-6 * rng.normal(size=n)),
            np.where(unknown, np.nan, reference_height),
            rng.uniform(-1, 1, (n, 3)),
            rng.normal(size=(n, 3)),
        ),
        provenance={"source": "made up", "conversions": ["none"], "number": 1e-7},
    )


ANGLES = {"lat", "lon", "rph", "heading", "rotvec"}


def assert_same(a: Stream, b: Stream) -> None:
    assert type(a) is type(b)
    for (key, x), (_, y) in zip(stream_fields(a), stream_fields(b), strict=True):
        assert x.dtype.kind == y.dtype.kind, key
        angles = key in ANGLES or (key == "sigma" and isinstance(a, Heading))
        if angles:  # through degrees and back: the last bits only
            np.testing.assert_allclose(x, y, rtol=4e-16, atol=0)
        else:
            np.testing.assert_array_equal(x, y, err_msg=key)
    for key in a.scalars():
        assert getattr(a, key) == getattr(b, key)


@pytest.mark.parametrize("table_format", ["parquet", "csv"])
@pytest.mark.parametrize("seed", range(5))
def test_round_trip_is_exact(tmp_path: Path, table_format: str, seed: int) -> None:
    dive = full_dive(seed)
    write_dive(dive, tmp_path / "dive", table_format=table_format)  # type: ignore[arg-type]
    back = read_dive(tmp_path / "dive")
    assert dict(dive.streams()).keys() == dict(back.streams()).keys() == set(EVERY_STREAM)
    for name, stream in dive.streams():
        assert_same(stream, getattr(back, name))
    assert back.rig == dive.rig
    assert back.provenance == dive.provenance
    np.testing.assert_allclose([back.origin.lat, back.origin.lon], [dive.origin.lat, dive.origin.lon], rtol=4e-16)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64, min_value=-3.0, max_value=3.0)


@settings(max_examples=40, deadline=None)
@given(
    rows=st.lists(st.tuples(st.integers(1, 10**12), finite, finite, finite), min_size=1, max_size=20),
    table_format=st.sampled_from(["parquet", "csv"]),
)
def test_any_numbers_survive(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple], table_format: str) -> None:
    steps, *v = zip(*rows, strict=True)
    n = len(rows)
    dvl = Dvl(
        START + np.cumsum(np.array(steps, dtype=np.int64)), np.array(v).T, np.full((n, 3, 3), np.nan), np.ones(n, bool)
    )
    place = tmp_path_factory.mktemp("any") / "dive"
    write_dive(Dive(Origin(0.1, 0.2), dvl=dvl), place, table_format=table_format)  # type: ignore[arg-type]
    assert_same(dvl, read_dive(place).dvl)  # type: ignore[arg-type]


def test_odd_stamps_keep_every_nanosecond(tmp_path: Path) -> None:
    t = START + np.array([1, 3, 7], dtype=np.int64)  # float64 steps by 256 ns here
    for table_format in ("parquet", "csv"):
        place = tmp_path / table_format
        write_dive(Dive(Origin(0, 0), depth=Depth(t, np.ones(3), np.ones(3))), place, table_format=table_format)  # type: ignore[arg-type]
        assert (read_dive(place).depth.t_ns == t).all()  # type: ignore[union-attr]


def handmade(tmp_path: Path, header: str, **files: str) -> Path:
    folder = tmp_path / "dive"
    folder.mkdir()
    (folder / "dive.yaml").write_text(header)
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


HEADER = "origin: {lat_deg: 32.0, lon_deg: 34.0}\nstreams: [STREAM]\n"


def test_minimal_csv_with_free_column_order(tmp_path: Path) -> None:
    text = f"v_z,v_y,v_x,t_ns\n3,2,1,{START}\n6,5,4.5,{START + 1}\n"
    dvl = read_dive(handmade(tmp_path, HEADER.replace("STREAM", "dvl"), dvl=text)).dvl
    assert dvl is not None
    np.testing.assert_array_equal(dvl.v_s, [[1, 2, 3], [4.5, 5, 6]])
    assert dvl.valid.all()
    assert np.isnan(dvl.cov_s).all()


def test_a_byte_order_mark_and_windows_line_ends_are_fine(tmp_path: Path) -> None:
    folder = handmade(tmp_path, HEADER.replace("STREAM", "depth"))
    (folder / "depth.csv").write_bytes(f"\ufefft_ns,depth\r\n{START},1.5\r\n\r\n".encode())
    np.testing.assert_array_equal(read_dive(folder).depth.depth, [1.5])  # type: ignore[union-attr]


def test_pressure_becomes_depth(tmp_path: Path) -> None:
    text = f"t_ns,pressure\n{START},0\n{START + 1},1e6\n"
    depth = read_dive(handmade(tmp_path, HEADER.replace("STREAM", "depth"), depth=text)).depth
    assert depth is not None
    # hydrostatics by hand: sea water of SA = 35.16504 g/kg at 0 deg C has 1028.1 kg/m^3 at the surface
    np.testing.assert_allclose(depth.depth, [0.0, 1e6 / (1028.1 * 9.7952)], rtol=3e-4)
    assert depth_from_pressure(np.array([1e8]), np.radians(30))[0] == pytest.approx(
        9713.735, abs=5
    )  # UNESCO 44: 9712.65


def test_partial_reference(tmp_path: Path) -> None:
    text = f"t_ns,heading_deg,height\n{START},90,-3\n"
    reference = read_dive(handmade(tmp_path, HEADER.replace("STREAM", "reference"), reference=text)).reference
    assert reference is not None
    np.testing.assert_array_equal(reference.rph, [[np.nan, np.nan, np.pi / 2]])
    assert np.isnan(reference.lat).all()


def test_images_are_copied_and_must_be_there(tmp_path: Path) -> None:
    t = START + np.arange(2)
    images = Images(t, np.array(["a.jpg", "sub/b.jpg"]), "down")
    source = tmp_path / "source"
    write_dive(Dive(Origin(0, 0), images={"down": images}), source)
    with pytest.raises(DataError, match=r"row 1 names a\.jpg"):
        read_dive(source)
    (source / "images/down/sub").mkdir()
    (source / "images/down/a.jpg").write_bytes(b"a")
    (source / "images/down/sub/b.jpg").write_bytes(b"b")
    report = import_dive(source, tmp_path / "copy")
    assert [s.name for s in report.streams] == ["images/down"]
    assert_same(images, read_dive(tmp_path / "copy").images["down"])
    assert (tmp_path / "copy/images/down/sub/b.jpg").read_bytes() == b"b"


def test_images_may_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    images = Images(START + np.arange(1), np.array(["../../secret"]), "down")
    write_dive(Dive(Origin(0, 0), images={"down": images}), tmp_path / "dive")
    with pytest.raises(DataError, match="leads out"):
        read_dive(tmp_path / "dive")


# --- whole or not at all


def test_a_taken_folder_is_refused_and_ours_replaced_on_request(tmp_path: Path) -> None:
    dive = full_dive()
    place = tmp_path / "dive"
    write_dive(dive, place, table_format="csv")
    with pytest.raises(DataError, match="not empty"):
        write_dive(dive, place)
    write_dive(replace(dive, dvl=None), place, overwrite=True)
    assert not (place / "imu.csv").exists()
    assert read_dive(place).dvl is None
    theirs = tmp_path / "holiday"
    theirs.mkdir()
    (theirs / "photo.jpg").write_bytes(b"x")
    with pytest.raises(DataError, match="not empty"):
        write_dive(dive, theirs, overwrite=True)
    assert sorted(os.listdir(tmp_path)) == ["dive", "holiday"]


def write_half_a_file(path: Path, error: type[BaseException]) -> None:
    with atomic_file(path) as partial:
        partial.write_text("new")
        raise error


def write_half_a_folder(path: Path, error: type[BaseException]) -> None:
    with atomic_folder(path) as partial:
        (partial / "a").write_text("new")
        raise error


def test_a_failing_block_leaves_nothing_and_keeps_the_old(tmp_path: Path) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.write_text("old")
    for error in (ValueError, KeyboardInterrupt):
        with pytest.raises(error):
            write_half_a_file(file, error)
        with pytest.raises(error):
            write_half_a_folder(folder, error)
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["file"]
    with atomic_file(file) as partial:
        partial.write_text("new")
    assert file.read_text() == "new"


def test_provenance_that_yaml_cannot_hold(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="provenance"):
        write_dive(Dive(Origin(0, 0), provenance={"x": np.float64(1)}), tmp_path / "dive")
    assert os.listdir(tmp_path) == []


def limit_file_size() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@pytest.mark.parametrize("table_format", ["parquet", "csv"])
def test_a_disk_that_fills_up(tmp_path: Path, table_format: str) -> None:
    write_dive(full_dive(n=2000), tmp_path / "source")
    code = (
        "import sys\nfrom uwgraph.dive.importing import import_dive\nfrom uwgraph.errors import DataError\n"
        "try:\n    import_dive(sys.argv[1], sys.argv[2], table_format=sys.argv[3])\n"
        "except DataError as error:\n    print(error)\n    sys.exit(3)\n"
    )
    place = tmp_path / "out" / "dive"
    arguments = [sys.executable, "-c", code, str(tmp_path / "source"), str(place), table_format]
    done = subprocess.run(arguments, preexec_fn=limit_file_size, capture_output=True, text=True, timeout=60)
    assert done.returncode == 3, done.stderr
    assert "disk is full" in done.stdout
    assert str(place) in done.stdout
    assert "remedy" in done.stdout
    assert os.listdir(tmp_path / "out") == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_no_space_left_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="disk is full"), atomic_folder(tmp_path / "out"):
        Path("/dev/full").write_text("x")
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_place(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(DataError, match="cannot be written"):
        write_dive(full_dive(), tmp_path / "dive")


def test_an_interrupted_run_leaves_no_output(tmp_path: Path) -> None:
    code = (
        "import sys, time\nfrom uwgraph.atomic import atomic_folder\n"
        "with atomic_folder(sys.argv[1]) as folder:\n"
        "    (folder / 'half').write_text('x')\n    print('writing', flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "out")], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as run:
        assert run.stdout is not None
        run.stdout.readline()
        time.sleep(0.05)
        run.send_signal(signal.SIGINT)
        assert run.wait(timeout=20) != 0
    assert os.listdir(tmp_path) == []
