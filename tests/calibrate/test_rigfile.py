"""Rig files: whole, safe, and the same when they come back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.rig import DvlRig, ReferenceRig, Rig
from uwgraph.dive.rigfile import apply_rig, read_rig, write_rig, write_rig_into
from uwgraph.errors import ConfigError
from uwgraph.simulate import SimulationSettings, simulate

finite = st.floats(-1e3, 1e3)
dvls = st.builds(
    DvlRig,
    rotation_deg=st.tuples(finite, finite, finite),
    translation_m=st.tuples(finite, finite, finite),
    time_offset_s=finite,
    scale=st.floats(1e-3, 1e3),
)


@given(dvls, st.lists(st.text(max_size=40), max_size=3))
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_rig_comes_back_whatever_the_remarks(tmp_path: Path, dvl: DvlRig, remarks: list[str]) -> None:
    rig = Rig(dvl=dvl)
    write_rig(rig, tmp_path / "rig.yaml", remarks)
    assert read_rig(tmp_path / "rig.yaml") == rig


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dvl: {scael: 1.0}", "did you mean 'scale'"),
        ("dvl: {scale: .nan}", "scale"),
        ("dvl: !!python/object/apply:os.system [ls]", "YAML"),
        ("a: &a [1]\nb: *a", "aliases"),
        ("[1, 2]", "rig.yaml"),
    ],
)
def test_bad_rigs_are_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_rig(file)


def test_onto_a_dive_with_or_without_its_clocks(tmp_path: Path) -> None:
    dive = simulate(SimulationSettings(duration_s=120.0, depth=3.0, imu_rate_hz=20.0))
    dive = replace(dive, rig=Rig(reference=ReferenceRig(time_offset_s=-0.4)))
    rig = Rig(dvl=DvlRig(scale=1.01, time_offset_s=1.0))
    assert apply_rig(dive, rig, keep_clocks=False).rig == rig
    kept = apply_rig(dive, rig, keep_clocks=True).rig
    assert (kept.dvl.scale, kept.dvl.time_offset_s, kept.reference.time_offset_s) == (1.01, 0.0, -0.4)

    write_dive(dive, tmp_path / "dive")
    write_rig_into(tmp_path / "dive", rig, "by hand")
    again = read_dive(tmp_path / "dive")
    assert again.rig == rig
    assert again.provenance["conversions"] == ["by hand"]
    assert again.provenance["seed"] == 0
    with pytest.raises(ConfigError):
        write_rig_into(tmp_path, rig, "")
