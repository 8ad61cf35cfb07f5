"""The table of design: which package may import which, read from the source (ast) and seen in fresh interpreters."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "stimuli": {"renderers", "protocols", "studyapp", "analysis", "glfw"},
    "renderers": {"protocols", "studyapp", "analysis", "glfw"},
    "protocols": {"studyapp", "analysis", "drjit", "mitsuba", "moderngl", "glfw"},
    "studyapp": {"analysis"},
    "analysis": {"studyapp", "renderers", "drjit", "mitsuba", "moderngl", "glfw"},
}
HEAVY = {"drjit", "mitsuba", "moderngl", "glfw", "pyrender", "OpenGL"}
NOT_LOADED = {
    "stimuli": HEAVY,
    "renderers": HEAVY,
    "protocols": HEAVY,
    "protocols.load": HEAVY,
    "studyapp": HEAVY | {"analysis"},
    "studyapp.cli": HEAVY | {"analysis"},
    "analysis": HEAVY | {"studyapp"},
    "analysis.sessions": HEAVY | {"studyapp"},
}


def imported_modules(source: str) -> set[str]:
    """Every dotted name that a source file imports, at any depth."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
    return names


def files_of(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_file_imports_what_its_package_may_not(package: str) -> None:
    found = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in files_of(package)
        for name in imported_modules(path.read_text())
        if name.split(".")[0] in FORBIDDEN[package]
    ]
    assert found == []


def test_protocols_see_only_the_catalogue_of_renderers() -> None:
    allowed = {"renderers.catalogue"}
    found = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in files_of("protocols")
        for name in imported_modules(path.read_text())
        if name.split(".")[0] == "renderers" and name not in allowed
    ]
    assert found == []


@pytest.mark.parametrize("module", NOT_LOADED)
def test_importing_a_package_loads_no_gpu_code(module: str) -> None:
    code = f"import sys, {module}; print(' '.join(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert loaded & NOT_LOADED[module] == set()


def test_a_session_starts_without_scenes_and_compilers() -> None:
    """They take 2 s to load, and their objects 0.1 s of every collection between two phases of a trial."""
    code = "import sys, studyapp.run_session; print(' '.join(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = set(done.stdout.split())
    assert loaded.isdisjoint({"numba", "pyrender", "trimesh", "mitsuba", "drjit", "pandas", "scipy.optimize"})


def test_session_time_is_read_only_in_the_clock() -> None:
    readers = {
        "time.monotonic",
        "time.monotonic_ns",
        "time.perf_counter",
        "time.perf_counter_ns",
        "time.time",
        "time.time_ns",
    }
    found = []
    for path in files_of("studyapp"):
        if path.name == "clock.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and f"{node.value.id}.{node.attr}" in readers
            ):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno} reads {node.value.id}.{node.attr}")
    assert found == []


def test_the_top_level_is_what_the_user_fixed() -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    top = {name.split("/")[0] for name in tracked if name}
    wanted = {"pyproject.toml", "studyapp", "renderers", "protocols", "analysis", "stimuli", "tests", "README.md"}
    ours = {"Makefile", "constraints.txt", "LICENSE", ".ci", ".gitignore", "docs"}
    assert wanted <= top
    assert top <= wanted | ours


def test_no_index_address_or_machine_path_is_in_the_tree() -> None:
    bad = ["index" + "-url", "/simple" + "/", "/ho" + "me/", "/wo" + "rk/", "pypi" + ".org"]
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    found = []
    for name in tracked:
        path = ROOT / name
        if name and path.is_file() and path.suffix in {".py", ".toml", ".txt", ".md", ".yaml", ".glsl", ".jinja", ""}:
            text = path.read_text(errors="ignore")
            found += [f"{name}: {word}" for word in bad if word in text]
    assert found == []


@pytest.mark.parametrize("package", ["stimuli", "renderers", "protocols", "analysis"])
def test_no_public_name_is_hidden_by_a_module_of_the_same_name(package: str) -> None:
    public = __import__(package).__all__
    inside = ROOT / package
    modules = {path.stem for path in inside.glob("*.py")} | {path.name for path in inside.iterdir() if path.is_dir()}
    assert set(public) & modules == set()
