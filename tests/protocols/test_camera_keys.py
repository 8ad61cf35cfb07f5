"""Camera paths of a protocol: keys in the file or in one beside it; mistakes named at their line in either."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from protocols.freeze import differences, registration
from protocols.load import load_study, read_study
from protocols.requests import clip_specs
from protocols.schema import protocol_schema
from protocols.yaml_source import read_yaml
from renderers.clip_renderer import keyed_camera
from stimuli import load_scene
from stimuli.camera_path import read_camera_path
from stimuli.errors import InputError
from stimuli.path_recording import PathKey, write_path_keys
from tests.protocols.tiny import TEXT

KEYS = """\
  - {time_s: 0, position: [0, 0, 1], look_at: [0, 0, 0]}
  - {time_s: 1, position: [1, 0, 1], look_at: [0, 0, 0]}
  - {time_s: 3, position: [1, 1, 1], look_at: [0, 0, 0], yfov_deg: 40}
"""


def study_with(folder: Path, paths: str) -> Path:
    file = folder / "s.yaml"
    file.write_text(TEXT + "defaults: {path: walk}\n" + paths)
    return file


def keys_of(file: Path) -> str:
    (said,) = {spec.path_keys for spec in clip_specs(load_study(file))}
    return said


def test_a_recorded_file_is_the_path_it_holds(tmp_path: Path) -> None:
    at = np.array([[k, 0.1 * k, 5.0] for k in range(6)])
    keys = [PathKey(0.05 * k, at[k], at[k] + [0.1, 0, -1]) for k in range(6)]
    write_path_keys(tmp_path / "walk.yaml", keys, 0.7, "flown")
    file = study_with(tmp_path, "paths: {walk: walk.yaml}\n")
    scene = load_scene("tunnel_geom")
    camera = keyed_camera(scene, keys_of(file))
    direct = read_camera_path(tmp_path / "walk.yaml", 1.0)
    times = np.linspace(0, 0.3, 40)
    np.testing.assert_allclose(camera.pose(times), direct.pose(times), atol=1e-12)
    assert camera.yfov_rad == pytest.approx(0.7)
    # The study's text holds it whole, and its registration notices another path.
    study, text = read_study(file)
    assert "# --- walk.yaml" in text
    assert "# yfov_deg: " in text
    before = registration(study, text)
    write_path_keys(tmp_path / "walk.yaml", keys[:-1], 0.7, "flown")
    study, text = read_study(file)
    assert registration(study, text)["protocol_sha256"] != before["protocol_sha256"]
    assert isinstance(differences(before, registration(study, text)), list)
    assert keys_of(file) != before


def test_keys_in_the_protocol_are_what_they_always_were(tmp_path: Path) -> None:
    said = json.loads(keys_of(study_with(tmp_path, "paths:\n  walk:\n" + KEYS)))
    assert said[2] == {"time_s": 3.0, "position": [1.0, 1.0, 1.0], "look_at": [0.0, 0.0, 0.0], "yfov_deg": 40.0}
    assert said[0]["yfov_deg"] is None
    assert set(said[0]) == {"time_s", "position", "look_at", "yfov_deg"}


def test_a_path_may_close_and_its_keys_may_be_turned(tmp_path: Path) -> None:
    turned = "{time_s: 0, position: [0, 0, 1], rotation: [0, 0, 0, 1]}"
    keys = f"[{turned}, {KEYS.splitlines()[1][4:]}]"
    more = f"{{closed: true, period_s: 4, interpolation: linear, yfov_deg: 30, keys: {keys}}}"
    camera = keyed_camera(load_scene("tunnel_geom"), keys_of(study_with(tmp_path, f"paths: {{walk: {more}}}\n")))
    np.testing.assert_allclose(camera.pose(np.array([0.5])), camera.pose(np.array([4.5])), atol=1e-12)
    np.testing.assert_allclose(camera.pose(np.zeros(1))[0, :3, :3], np.eye(3), atol=1e-12)
    assert np.degrees(camera.yfov_rad) == pytest.approx(30)


@pytest.mark.parametrize(
    ("paths", "place", "words"),
    [
        ("paths: {walk: nowhere.yaml}\n", "s.yaml:26:15", "'nowhere.yaml', which is not there"),
        ("paths:\n  walk:\n" + KEYS.replace("time_s: 3", "time_s: 1"), "s.yaml:30:8", "later than 1"),
        ("paths:\n  walk:\n" + KEYS.replace("[0, 0, 1]", "[0, 0, 0]"), "s.yaml:28:5", "another point to look at"),
        ("paths:\n  walk:\n" + KEYS.replace("look_at: [0, 0, 0], yfov", "yfov"), "s.yaml:30:5", "neither of look_at"),
        ("paths: {walk: {closed: true, keys: [{time_s: 0, position: [0, 0, 1], look_at: [0, 0, 0]}]}}\n", "s.yaml:26:9",
         "both of closed"),
        ("paths: {walk: {keys: []}}\n", "s.yaml:26:16", "keys"),
    ],
)  # fmt: skip
def test_mistakes_are_named_where_they_stand(paths: str, place: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_study(study_with(tmp_path, paths))
    found = [line for line in caught.value.problems if words in line]
    assert found, caught.value.problems
    line = place.split(":")[1]
    assert f"s.yaml:{line}:" in found[0]


def test_mistakes_in_the_file_of_keys_are_named_in_that_file(tmp_path: Path) -> None:
    file = study_with(tmp_path, "paths: {walk: walk.yaml}\n")
    (tmp_path / "walk.yaml").write_text("keys:\n" + KEYS.replace("[1, 0, 1]", "[1, 0]") + "speed: 3\n")
    with pytest.raises(InputError) as caught:
        load_study(file)
    assert any("walk.yaml:3:" in line for line in caught.value.problems)
    assert any("walk.yaml:5:1" in line and "'speed'" in line for line in caught.value.problems)


def test_an_extended_study_finds_the_path_beside_its_own_file(tmp_path: Path) -> None:
    (tmp_path / "base").mkdir()
    study_with(tmp_path / "base", "paths: {walk: walk.yaml}\n")
    (tmp_path / "base" / "walk.yaml").write_text("keys:\n" + KEYS)
    (tmp_path / "variant.yaml").write_text("extends: base/s.yaml\nseed: 4\n")
    assert len(load_study(tmp_path / "variant.yaml").paths["walk"].keys) == 3


@pytest.mark.parametrize("form", ["file", "list", "table"])
def test_the_schema_knows_every_form(form: str, tmp_path: Path) -> None:
    listed = "\n  walk:\n" + KEYS
    table = "\n  walk:\n    keys:\n" + KEYS.replace("  -", "      -")
    paths = {"file": " {walk: walk.yaml}\n", "list": listed, "table": table}
    data = read_yaml(study_with(tmp_path, "paths:" + paths[form])).plain()
    validator = jsonschema.Draft202012Validator(protocol_schema())
    validator.validate(data)
    for wrong in (3, [], {"keys": [{"time_s": 0}]}, [{"time_s": 0, "position": [0, 0, 0], "look": [0, 0, 1]}]):
        assert not validator.is_valid({**data, "paths": {"walk": wrong}})
