"""glTF structure: bodies, winding, modes, materials, skins, lights, cameras, on files made by hand."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.errors import InputError
from stimuli.gltf_meshes import mend_normals, triangles_of
from stimuli.scene import Part
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb, textured


def world_triangles(part: Part, pose: np.ndarray | None = None) -> np.ndarray:
    matrix = part.matrix if pose is None else pose @ part.matrix
    return (part.positions @ matrix[:3, :3].T + matrix[:3, 3])[part.primitive.indices]


def test_mesh_nodes_under_one_animated_node_are_one_body_and_the_rest_is_static(tmp_path: Path) -> None:
    glb = TinyGlb()
    mesh = glb.mesh(TRIANGLE)
    # car (animated) > body, wheel (animated) > spokes; ground stands still.
    spokes = glb.node(root=False, mesh=mesh)
    wheel = glb.node(root=False, name="wheel", mesh=mesh, translation=[1, 0, 0], children=[spokes])
    body = glb.node(root=False, mesh=mesh, scale=[2, 2, 2])
    glb.node(name="car", children=[body, wheel])
    glb.node(name="ground", mesh=mesh)
    glb.animate(3, "translation", [0.0, 2.0], [[0, 0, 0], [4, 0, 0]])
    half = np.sin(np.pi / 4)
    glb.animate(1, "rotation", [0.0, 1.0], [[0, 0, 0, 1], [0, 0, half, half]])
    scene = load_scene(glb.write(tmp_path))
    assert [part.name for part in scene.static] == ["ground"]
    assert {mover.name: len(mover.parts) for mover in scene.movers} == {"car": 1, "wheel": 2}
    assert scene.duration_s == 2.0
    assert scene.triangle_count == 4
    wheel_pose = next(m for m in scene.movers if m.name == "wheel").track.pose(np.array([1.0]))[0]
    # At 1 s the car is at x = 2, the wheel one further, turned by 90 degrees: its x axis points up.
    assert np.allclose(wheel_pose @ [1, 0, 0, 1], [3, 1, 0, 1])


def test_animations_are_chosen_by_name_and_change_the_identity(tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=glb.mesh(TRIANGLE))
    glb.animate(node, "translation", [0.0, 1.0], [[0, 0, 0], [1, 0, 0]], name="walk")
    glb.animate(node, "translation", [0.0, 3.0], [[0, 0, 0], [0, 1, 0]], name="jump")
    path = glb.write(tmp_path)
    first, walk, jump = (load_scene(path, animation=name) for name in (None, "walk", "jump"))
    assert (first.duration_s, walk.duration_s, jump.duration_s) == (1.0, 1.0, 3.0)
    assert first.sha256 == walk.sha256 != jump.sha256
    assert any("2 animations, the first (walk)" in note for note in first.notes)
    with pytest.raises(InputError, match=r"animation: got 'swim', wanted one of walk \| jump"):
        load_scene(path, animation="swim")


def test_matrix_nodes_equal_trs_nodes_and_keep_large_translations_exact(tmp_path: Path) -> None:
    glb = TinyGlb()
    mesh = glb.mesh(TRIANGLE)
    turn = [0.0, np.sin(0.3), 0.0, np.cos(0.3)]
    trs = glb.node(mesh=mesh, translation=[1e7 + 0.125, 0, 0], rotation=turn, scale=[1, 2, 3])
    part = load_scene(glb.write(tmp_path)).static[0]
    assert part.matrix[0, 3] == 1e7 + 0.125
    glb.json["nodes"][trs] = {"mesh": mesh, "matrix": part.matrix.T.ravel().tolist()}
    assert np.array_equal(load_scene(glb.write(tmp_path)).static[0].matrix, part.matrix)


def test_mirroring_matrices_turn_the_winding_so_that_fronts_stay_fronts(tmp_path: Path) -> None:
    glb = TinyGlb()
    normal = glb.accessor(np.tile((0.0, 0.0, 1.0), (3, 1)))
    mesh = glb.mesh(TRIANGLE, NORMAL=normal)
    glb.node(mesh=mesh)
    glb.node(mesh=mesh, scale=[-1, 1, 1])
    glb.node(mesh=mesh, scale=[-1, -1, -1])
    for part in load_scene(glb.write(tmp_path)).static:
        a, b, c = world_triangles(part)[0]
        turned = np.linalg.inv(part.matrix[:3, :3]).T @ part.primitive.normals[0]
        assert np.dot(np.cross(b - a, c - a), turned) > 0.0


def test_strips_and_fans_become_triangles_wound_alike_and_lines_are_said_to_be_left_out(tmp_path: Path) -> None:
    assert triangles_of(np.arange(5), 5).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert triangles_of(np.arange(5), 6).tolist() == [[1, 2, 0], [2, 3, 0], [3, 4, 0]]
    assert triangles_of(np.arange(7), 4).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert triangles_of(np.arange(2), 5).shape == (0, 3)
    glb = TinyGlb()
    square = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    for mode in (5, 6, 1, 0, 3):
        mesh = glb.mesh(square if mode == 5 else [square[i] for i in (0, 1, 3, 2)])
        glb.json["meshes"][mesh]["primitives"][0]["mode"] = mode
        glb.node(mesh=mesh)
    scene = load_scene(glb.write(tmp_path))
    assert len(scene.static) == 2
    for part in scene.static:
        corner = world_triangles(part)
        assert (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0).all()
    assert sum("are not drawn" in note for note in scene.notes) == 3


def test_indices_beyond_float32_precision_stay_exact(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    primitive = load_scene(glb.write(tmp_path)).static[0].primitive
    primitive.indices = np.array([[2**24 + 1, 2**24 + 2, 2**24 + 3]])
    assert primitive.indices.dtype == np.uint32
    assert primitive.indices.tolist() == [[2**24 + 1, 2**24 + 2, 2**24 + 3]]


def test_punctual_lights_take_place_and_direction_from_their_node(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    entries = [
        {"type": "point", "color": [1, 0.5, 0.25], "intensity": 8.0, "range": 12.0, "name": "lamp"},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.6}},
        {"type": "directional", "intensity": 3.0},
    ]
    glb.json["extensions"] = {"KHR_lights_punctual": {"lights": entries}}
    down = [-np.sin(np.pi / 4), 0, 0, np.cos(np.pi / 4)]
    for i in range(3):
        glb.node(translation=[1, 2, 3], rotation=down, extensions={"KHR_lights_punctual": {"light": i}})
    moving = glb.node(extensions={"KHR_lights_punctual": {"light": 0}})
    glb.animate(moving, "translation", [0.0, 1.0], [[0, 0, 0], [5, 0, 0]])
    point, spot, sun, carried = load_scene(glb.write(tmp_path)).lights
    assert (point.kind, point.intensity, point.position, point.range_m) == ("point", (8.0, 4.0, 2.0), (1, 2, 3), 12.0)
    assert (spot.inner_rad, spot.outer_rad) == (0.1, 0.6)
    assert np.allclose(sun.direction, (0, -1, 0))
    assert sun.intensity == (3.0, 3.0, 3.0)
    assert carried.track is not None
    assert np.allclose(carried.track.pose(np.array([0.5]))[0, :3, 3], (2.5, 0, 0))


def test_an_animated_camera_stays_rigid_under_a_scaled_and_mirrored_node(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]
    eye = glb.node(root=False, camera=0)
    glb.node(scale=[-2, 3, 4], children=[eye])
    glb.animate(eye, "translation", [0.0, 1.0], [[0, 0, 0], [1, 1, 1]])
    camera = load_scene(glb.write(tmp_path)).camera
    pose = camera.pose(np.array([0.0, 1.0]))
    assert camera.yfov_rad == pytest.approx(0.7)
    assert np.allclose(pose[:, :3, :3], np.eye(3))
    assert np.allclose(pose[1, :3, 3], (-2, 3, 4))


def test_a_file_without_light_and_camera_gets_both_and_says_so(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(np.add(TRIANGLE, (10.0, 0.0, 0.0))))
    scene = load_scene(glb.write(tmp_path))
    assert scene.lights[0].kind == "directional"
    assert np.degrees(scene.camera.yfov_rad) == pytest.approx(50.0)
    eye = scene.camera.pose(np.zeros(1))[0, :3, 3]
    radius = np.sqrt(2.0) / 2.0
    assert np.allclose(eye, (10.5, 0.5, radius / np.sin(np.radians(25.0))))
    assert sum("no camera" in note or "no light" in note for note in scene.notes) == 2


def test_normals_without_direction_are_mended_and_counted() -> None:
    positions = np.array(TRIANGLE)
    mended, count = mend_normals(positions, np.array([[0, 0, 2.0], [0, 0, 0], [np.nan, 0, 1]]), np.array([[0, 1, 2]]))
    assert count == 2
    assert np.allclose(mended, [[0, 0, 1]] * 3)


def test_float_positions_that_float32_holds_are_not_doubled(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    mesh = glb.mesh(TRIANGLE)
    glb.json["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"] = glb.accessor(
        [[0, 0, 0], [10, 0, 0], [0, 7, 0]], "u1", normalized=True
    )
    glb.node(mesh=mesh)
    exact, fractions = load_scene(glb.write(tmp_path)).static
    assert exact.positions64 is None
    assert fractions.positions[1, 0] == 10 / 255


@pytest.mark.parametrize(
    ("spoil", "wanted"),
    [
        (lambda g: g.json["nodes"][0].update(children=[0]), "reached twice"),
        (lambda g: g.json["nodes"][0].update(mesh=7), "index into meshes"),
        (lambda g: g.json["meshes"][0]["primitives"][0]["attributes"].update(POSITION="x"), "index into accessors"),
        (lambda g: g.json["accessors"][0].update(count=9), "accessor 0"),
        (lambda g: g.json["accessors"][0].update(componentType=1), "glTF 2.0 types"),
        (lambda g: g.json["accessors"][0].pop("type"), "glTF 2.0 types"),
        (lambda g: g.json["nodes"][0].update(matrix=[1, 2]), "malformed glTF"),
        (lambda g: g.json["nodes"][0].update(translation=[float("nan"), 0, 0]), "nan or inf in its matrix"),
        (lambda g: g.json.update(scene=3), "index into scenes"),
        (lambda g: g.json.update(asset={"version": "1.0"}), "glTF version"),
        (lambda g: g.json.update(nodes="many"), "a list of objects"),
        (lambda g: g.json["scenes"][0].update(nodes=[]), "no triangles"),
    ],
)
def test_every_spoiled_file_is_one_line_of_input_error(tmp_path: Path, spoil: object, wanted: str) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    spoil(glb)  # type: ignore[operator]
    with pytest.raises(InputError, match=wanted) as caught:
        load_scene(glb.write(tmp_path))
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith(str(tmp_path))


def test_nan_vertices_are_named(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh([[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]))
    with pytest.raises(InputError, match=r"POSITION: 1 bad vertices, the first is 1: got \(1, nan, 0\), wanted finite"):
        load_scene(glb.write(tmp_path))


def test_a_file_cut_anywhere_is_one_line_of_input_error(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE, NORMAL=glb.accessor([[0, 0, 1.0]] * 3)))
    whole = glb.bytes()
    path = tmp_path / "cut.glb"
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError) as caught:
            load_scene(path)
        assert len(str(caught.value).splitlines()) == 1


def test_a_file_with_any_byte_of_its_json_changed_loads_or_is_one_line_of_input_error(tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=glb.mesh(TRIANGLE))
    glb.animate(node, "translation", [0.0, 1.0], [[0, 0, 0], [1, 0, 0]])
    whole = bytearray(glb.bytes())
    size = struct.unpack_from("<I", whole, 12)[0]
    rng = np.random.default_rng(0)
    path = tmp_path / "odd.glb"
    lines = []
    for at in rng.integers(20, 20 + size, 150):
        odd = bytearray(whole)
        odd[at] = rng.choice(list(b'0{[-9"z,'))
        path.write_bytes(odd)
        try:
            load_scene(path)
        except InputError as error:
            lines.append(str(error))
    assert len(lines) > 50
    assert all(len(line.splitlines()) == 1 for line in lines)


def test_draco_and_ktx2_that_are_used_but_not_required_are_refused_where_nothing_else_is_there(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    glb.json["accessors"][0].pop("bufferView")
    glb.json["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    with pytest.raises(InputError, match="compressed with Draco"):
        load_scene(glb.write(tmp_path))
    glb = TinyGlb()
    textured(glb, pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    glb.json["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    with pytest.raises(InputError, match="textures in KTX2"):
        load_scene(glb.write(tmp_path))
    glb.json["textures"] = [{"source": 0}]
    glb.json["images"] = [{"bufferView": glb.view(b"\xabKTX 20\xbb\r\n\x1a\n")}]
    with pytest.raises(InputError, match="textures in KTX2"):
        load_scene(glb.write(tmp_path))


def test_instances_of_a_mesh_stand_where_their_accessors_say_and_mirrored_ones_are_turned(tmp_path: Path) -> None:
    glb = TinyGlb()
    mesh = glb.mesh(TRIANGLE)
    attributes = {
        "TRANSLATION": glb.accessor([[1, 0, 0], [2, 0, 0], [3, 0, 0]]),
        "SCALE": glb.accessor([[1, 1, 1], [2, 2, 2], [1, -1, 1]]),
    }
    glb.node(mesh=mesh, translation=[0, 10, 0], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    parts = load_scene(glb.write(tmp_path)).static
    assert [part.matrix[:3, 3].tolist() for part in parts] == [[1, 10, 0], [2, 10, 0], [3, 10, 0]]
    for part in parts:
        a, b, c = world_triangles(part)[0]
        assert np.cross(b - a, c - a)[2] > 0.0
    glb.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = glb.accessor([[1, 1, 1]])
    with pytest.raises(InputError, match="EXT_mesh_gpu_instancing"):
        load_scene(glb.write(tmp_path))
