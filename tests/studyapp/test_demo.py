"""The demo's protocol with a scene file in place of the embedded scenes."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocols.load import load_study
from renderers.catalogue import CATALOGUE
from studyapp.demo import protocol_for


@pytest.mark.parametrize("deforms", [False, True])
@pytest.mark.parametrize("moves", [False, True])
def test_a_file_s_demo_is_a_sound_study_of_what_can_show_it(tmp_path: Path, deforms: bool, moves: bool) -> None:
    scene = tmp_path / "thing.obj"
    scene.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    written = tmp_path / "demo.yaml"
    written.write_text(protocol_for(scene, None, moves, 4.0, deforms))
    study = load_study(written)
    assert set(study.scenes) == {"view_1", "view_2", "view_3"}
    own_times = {name for name, entry in CATALOGUE.items() if entry.own_times}
    assert own_times == {"adaptive_frameless", "traditional_frameless"}
    shown = {condition.technique for condition in study.all_conditions().values()}
    assert "temporally_dense" in shown
    assert (own_times & shown == set()) if deforms else (own_times < shown)
