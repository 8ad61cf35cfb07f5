from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from studyapp.cli import main
from tests.protocols.tiny import TEXT

ROOT = Path(__file__).parents[2]


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    file = tmp_path / "tiny.yaml"
    file.write_text(TEXT)
    return file


def test_check_prints_the_plan_in_numbers(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(protocol)]) == 0
    out = capsys.readouterr().out
    assert "tiny: 12 participants, 18 trials each" in out
    assert "cell: 12 each" in out
    assert "clips: 8 to render" in out
    assert "unmatched comparison (full, half, dense)" in out


def test_check_as_json_has_the_same_numbers(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(protocol), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["trials"], data["participants"], len(data["clips"])) == (18, 12, 8)


def test_mistakes_go_to_stderr_one_a_line_with_exit_2(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol.write_text(TEXT.replace("reference: gold", "reference: glod").replace("{spp: 4}", "{spp: -4}"))
    assert main(["check", str(protocol)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) == 2
    assert all(line.startswith(f"{protocol}:") for line in err.strip().splitlines())


def test_missing_assets_and_modules_are_named(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = TEXT.replace("b: bar", "b: nowhere.glb").replace("full: vanilla", "full: no_such_module:Thing")
    protocol.write_text(text)
    assert main(["check", str(protocol)]) == 2
    err = capsys.readouterr().err
    assert "tiny.yaml:2:26: scenes.b: got 'nowhere.glb', wanted a procedural scene" in err
    assert "tiny.yaml:5:3: conditions.full.technique: got 'no_such_module:Thing', wanted an importable" in err
    # Beside mistakes that the loader finds, and with the nearest name.
    protocol.write_text(TEXT.replace("b: bar", "b: bra").replace("full: vanilla", "full: vanila"))
    assert main(["check", str(protocol)]) == 2
    err = capsys.readouterr().err
    assert "tiny.yaml:2:26: scenes.b: got 'bra', wanted 'bar' (did you mean that?)" in err
    assert "tiny.yaml:5:3: conditions.full.technique: got 'vanila'" in err
    # Names that no file system takes are not there either.
    for name in ("x" * 290 + ".glb", "'**.glb'", "'a/../b.obj'"):
        protocol.write_text(TEXT.replace("b: bar", f"b: {name}"))
        assert main(["check", str(protocol)]) == 2
        assert "scenes.b: got" in capsys.readouterr().err


def test_a_stand_in_is_said(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol.write_text(TEXT.replace("b: bar", "b: {scene: nowhere.glb, instead: bar}"))
    assert main(["check", str(protocol)]) == 0
    assert "note: scene b: nowhere.glb is not there, bar stands in" in capsys.readouterr().out


def test_plan_prints_every_trial_in_order(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(protocol), "--participant", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 19
    assert [int(line.split()[0]) for line in lines[1:]] == list(range(18))
    assert main(["plan", str(protocol), "--participant", "2", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)) == 18
    assert main(["plan", str(protocol), "--participant", "0"]) == 2


def test_techniques_lists_parameters_ranges_and_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["techniques", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    spp = next(p for p in listed["reference"]["parameters"] if p["name"] == "spp")
    assert (spp["type"], spp["range"], spp["knob"]) == ("whole number", ">= 1, <= 65536", True)
    assert main(["techniques"]) == 0
    assert "spp" in capsys.readouterr().out


def test_check_waits_for_no_renderer_and_no_clip_format() -> None:
    """What takes longer to import than a protocol takes to check is imported where it is needed."""
    code = (
        "import sys; from studyapp.cli import main; main(['check', 'demo', '--store', 'nowhere']); print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {name.split(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert {"numpy", "pydantic"} <= loaded
    assert loaded.isdisjoint({"scipy", "numba", "pyrender", "trimesh", "OpenEXR", "drjit", "mitsuba", "matplotlib"})
