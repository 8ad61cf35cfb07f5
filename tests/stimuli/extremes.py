"""The table of extremes of scenes, paths and clips: each row a name and what must hold there."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.camera_path import camera_path, read_camera_path, scene_radius
from stimuli.clip import ClipStore, estimate_disk
from stimuli.clip_parts import PartWriter, assemble
from stimuli.encode import encode
from stimuli.errors import InputError
from stimuli.exr import read_exr, write_exr
from stimuli.load import bounding_sphere
from stimuli.path_recording import Steering, fly
from stimuli.play_cache import PlayCache
from stimuli.scene import Scene, StillCamera
from tests.stimuli.test_clip import request
from tests.stimuli.test_path_recording import Script
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb

HALF_MAX = 65504.0
SIZES = ((1, 1), (1, 31), (31, 1), (33, 17), (4096, 2))
RATES = ("24", "24000/1001", "60000/1001", "240", "1000")
SCALES = (1e-6, 1e-3, 1.0, 1e3, 1e6)
LIGHT = (0.0, 1e-30, 1e-8, 0.5, 1.0, 6e4, 1e30, float("inf"))


@dataclass(frozen=True)
class Extreme:
    """``holds`` raises where it does not; it may write into the folder that it is given."""

    name: str
    holds: Callable[[Path], None]


def clip_of_size(folder: Path, size_px: tuple[int, int]) -> None:
    """Written, verified, read, encoded: every pixel is where it was."""
    width, height = size_px
    asked = request(2, size_px=size_px)
    store, frames = ClipStore(folder), np.random.default_rng(0).random((2, height, width, 3)).astype(np.float32)
    writer = PartWriter(store, asked)
    for frame in frames:
        writer.add(frame, {"Z": np.full((height, width), np.inf, np.float32)})
    writer.publish("all")
    clip = assemble(store, asked, ["all"])
    assert store.problems_of(clip.identity) == []
    played = PlayCache(store).played(clip)
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(clip.frame(k).color, frame.astype(np.float16))
        np.testing.assert_array_equal(played.frame(k), encode(frame.astype(np.float16), 1.0))


def exact_rate(folder: Path, rate: str) -> None:
    """As many frames as the exact rate says, after an hour too; the play cache keeps the fraction."""
    asked = request(rate_hz=rate, duration_s="3600")
    assert asked.frame_count == round(Fraction(rate) * 3600)
    assert request(rate_hz=rate, duration_s=str(1 / Fraction(rate))).frame_count == 1
    short = request(rate_hz=rate, duration_s=str(2 / Fraction(rate)))
    store = ClipStore(folder)
    writer = PartWriter(store, short)
    for _ in range(2):
        writer.add(np.zeros((8, 12, 3), np.float32))
    writer.publish("all")
    assert PlayCache(store).played(assemble(store, short, ["all"])).rate_hz == Fraction(rate)


def light_in_files(folder: Path, value: float) -> None:
    """Half floats hold it as well as they can, nothing overflows; codes stay within 0 to 255."""
    color = np.full((2, 3, 3), value, np.float32)
    write_exr(folder / "x.exr", color)
    stored = read_exr(folder / "x.exr").color
    assert stored is not None
    wanted = np.float16(min(value, HALF_MAX))
    assert (stored == wanted).all()
    for exposure in (1e-12, 1.0, 1e12):
        expected = 255 * np.clip(np.float64(wanted) * exposure, 0, 1)
        codes = encode(stored, exposure)[..., :3]
        assert codes.min() == codes.max()
        assert (codes.max() == 0) == (expected < 0.5 / 12.92)
        assert (codes.max() == 255) == (expected >= 253.9)


def triangles(folder: Path, points: np.ndarray, faces: list[int], scale: float = 1.0) -> Scene:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(np.asarray(points) * scale, faces, NORMAL=glb.accessor([[0, 0, 1.0]] * len(points))))
    return load_scene(glb.write(folder))


def scaled(folder: Path, scale: float) -> None:
    """The camera that frames everything, the sphere round it and a flight through it grow with the scene."""
    one, other = triangles(folder, TRIANGLE, [0, 1, 2]), triangles(folder, TRIANGLE, [0, 1, 2], scale)
    for a, b in zip(bounding_sphere(one.static), bounding_sphere(other.static), strict=True):
        np.testing.assert_allclose(np.asarray(b), np.asarray(a) * scale, rtol=1e-6)
    at = np.array([0.3])
    for name in ("file", "sway", "interactive"):
        a, b = (camera_path(each, name).pose(at)[0] for each in (one, other))
        np.testing.assert_allclose(b[:3, 3], a[:3, 3] * scale, rtol=1e-6, atol=1e-9 * scale)
        np.testing.assert_allclose(b[:3, :3], a[:3, :3], atol=1e-9)
    hand = [(0.0, Steering(record=True)), *[(0.06, Steering(move=(0, 0, 1)))] * 10]
    flown = [fly(each, each.camera, Script(list(hand)))[-1] for each in (one, other)]
    np.testing.assert_allclose(flown[1].position, flown[0].position * scale, rtol=1e-6, atol=1e-9 * scale)


def far_from_the_origin(folder: Path) -> None:
    """A shape at 1e5 keeps its size: a node's translation is not rounded to float32."""
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(np.multiply(TRIANGLE, 1e-3)), translation=[1e5, 1e5, 1e5])
    scene = load_scene(glb.write(folder))
    part = scene.static[0]
    world = part.positions @ part.matrix[:3, :3].T + part.matrix[:3, 3]
    np.testing.assert_allclose(world - [1e5, 1e5, 1e5], np.multiply(TRIANGLE, 1e-3), atol=1e-10)
    # Half the diagonal of a square of 1 mm; float32 would give steps of 8 mm here.
    assert scene_radius(scene) == pytest.approx(1e-3 * np.sqrt(2) / 2, rel=1e-6)


def degenerate(folder: Path) -> None:
    """Triangles without area, twice the same, and needles: all read, finite, none invented."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [50, 1e-6, 0], [-50, 0, 0]]
    faces = [0, 1, 2, 0, 1, 2, 0, 0, 0, 0, 1, 3, 5, 4, 0]
    scene = triangles(folder, np.array(points, float), faces)
    (part,) = scene.static
    assert scene.triangle_count == 5
    assert np.isfinite(part.positions).all()
    assert np.allclose(np.linalg.norm(part.primitive.normals, axis=1), 1)


def crowd(folder: Path) -> None:
    """2,000 moving nodes: a body each, all poses at once."""
    from stimuli.many_poses import mover_poses

    glb = TinyGlb()
    mesh = glb.mesh(TRIANGLE)
    times = glb.accessor([0.0, 1.0])
    samplers, channels = [], []
    for k in range(2000):
        node = glb.node(mesh=mesh, translation=[k, 0, 0])
        samplers.append({"input": times, "output": glb.accessor([[k, 0, 0], [k, 1, 0]]), "interpolation": "LINEAR"})
        channels.append({"sampler": k, "target": {"node": node, "path": "translation"}})
    glb.json["animations"] = [{"name": "all", "samplers": samplers, "channels": channels}]
    scene = load_scene(glb.write(folder))
    assert len(scene.movers) == 2000
    poses = mover_poses([mover.track for mover in scene.movers], np.array([0.0, 0.5]))
    np.testing.assert_allclose(poses[:, :, 0, 3], np.repeat(np.arange(2000)[:, None], 2, 1))
    np.testing.assert_allclose(poses[:, :, 1, 3], [[0.0, 0.5]] * 2000)


def late(folder: Path) -> None:
    """After 1e6 s a periodic path is where it was, and ended keys hold."""
    scene = triangles(folder, TRIANGLE, [0, 1, 2])
    sway = camera_path(scene, "sway")
    np.testing.assert_allclose(sway.pose(np.array([1e6 + 0.5])), sway.pose(np.array([0.5])), atol=1e-9)
    glb = TinyGlb()
    node = glb.node(mesh=glb.mesh(TRIANGLE))
    glb.animate(node, "translation", [0.0, 1.0], [[0, 0, 0], [3, 0, 0]])
    mover = load_scene(glb.write(folder)).movers[0]
    assert mover.track.pose(np.array([1e6]))[0, 0, 3] == 3


def field_of(folder: Path, degrees: float, fits: bool = True) -> None:
    """A camera's field in a glTF file and in a file of keys."""
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": float(np.radians(degrees))}}]
    glb.node(camera=0)
    keys = {"yfov_deg": degrees, "keys": [{"time_s": 0, "position": [0, 0, 1], "look_at": [0, 0, 0]}]}
    (folder / "keys.yaml").write_text(json.dumps(keys))
    glb.write(folder)
    for read in (lambda: load_scene(folder / "tiny.glb").camera, lambda: read_camera_path(folder / "keys.yaml", 1.0)):
        if fits:
            assert np.degrees(read().yfov_rad) == pytest.approx(degrees)
        else:
            with pytest.raises(InputError, match="yfov"):
                read()


def empty(folder: Path) -> None:
    """Nothing at all: a sphere of 1 round the origin; a file of nothing is refused."""
    scene = Scene("nothing", (), (), (), StillCamera(np.eye(4), 1.0), "0" * 64)
    assert scene_radius(scene) == 1.0
    assert scene.triangle_count == 0
    np.testing.assert_allclose(camera_path(scene, "sway").pose(np.zeros(1))[0, :3, 3], [0.02, 0, 0])
    with pytest.raises(InputError, match="no triangles"):
        load_scene(TinyGlb().write(folder))


def huge(folder: Path) -> None:
    """8k at 1000 Hz for an hour: the bytes are said exactly, nothing is made."""
    asked = request(size_px=(7680, 4320), rate_hz="1000", duration_s="3600")
    estimate = estimate_disk([asked])
    assert estimate.frames == 3_600_000
    assert estimate.exr_bytes == 3_600_000 * 7680 * 4320 * 6
    assert estimate.play_bytes == 3_600_000 * 7680 * 4320 * 4
    assert not list(folder.iterdir())


def unbounded(folder: Path) -> None:
    """Vertices, keys and lights that are not finite numbers are refused with their place."""
    for bad in (np.nan, np.inf, 1e39):
        glb = TinyGlb()
        with np.errstate(over="ignore"):
            glb.node(mesh=glb.mesh([[bad, 0, 0], [1, 0, 0], [0, 1, 0]]))
        with pytest.raises(InputError, match="bad vertices"):
            load_scene(glb.write(folder))
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    glb.write(folder)
    flat = [[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]]
    for light, word in (
        ({"type": "sphere", "center": [0, 0, 0], "radius": 0, "radiance": [1, 1, 1]}, "radius"),
        ({"type": "sphere", "center": [0, 0, 0], "radius": 1, "radiance": [1e999, 1, 1]}, "radiance"),
        ({"type": "area", "vertices": flat, "radiance": [1, 1, 1]}, "without area"),
    ):
        (folder / "tiny_lights.json").write_text(json.dumps({"lights": [light]}))
        with pytest.raises(InputError, match=word):
            load_scene(folder / "tiny.glb")


def no_such_names(folder: Path) -> None:
    """Names that no file has, or can have."""
    for name in ("", "x" * 5000, "../" * 600 + "x.glb", str(folder)):
        with pytest.raises(InputError):
            load_scene(name)
        with pytest.raises(InputError):
            read_camera_path(Path(name), 1.0)


def light_files(folder: Path) -> None:
    """Lights of 1e-30 and 1e30, and two in one place, are read as they are."""
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    entries = [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "radiance": [v] * 3} for v in (1e-30, 1e30, 1e30)]
    (folder / "tiny_lights.json").write_text(json.dumps({"lights": entries}))
    assert [light.intensity[0] for light in load_scene(glb.write(folder)).lights] == [1e-30, 1e30, 1e30]


def _row(name: str, check: Callable[..., None], *values: object) -> Extreme:
    return Extreme(name, lambda folder: check(folder, *values))


TABLE: tuple[Extreme, ...] = (
    *(_row(f"clip of {w}x{h}", clip_of_size, (w, h)) for w, h in SIZES),
    *(_row(f"clip at {rate} Hz", exact_rate, rate) for rate in RATES),
    *(_row(f"radiance {value:g}", light_in_files, value) for value in LIGHT),
    *(_row(f"scene scale {scale:g}", scaled, scale) for scale in SCALES),
    *(_row(f"field of {degrees:g} degrees", field_of, degrees) for degrees in (0.01, 1.0, 179.0)),
    *(_row(f"field of {degrees:g} degrees", field_of, degrees, False) for degrees in (0.0, 180.0, -1.0)),
    Extreme("origin shifted by 1e5", far_from_the_origin),
    Extreme("degenerate, duplicate and needle triangles", degenerate),
    Extreme("2000 movers", crowd),
    Extreme("time 1e6 s", late),
    Extreme("empty scene", empty),
    Extreme("an hour of 8k at 1000 Hz", huge),
    Extreme("numbers that are not finite, lights without area", unbounded),
    Extreme("names that no file has", no_such_names),
    Extreme("lights of 1e-30 and 1e30", light_files),
)
