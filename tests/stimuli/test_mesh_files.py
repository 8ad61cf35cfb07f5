"""OBJ and PLY: normals, materials and pictures of the file; what is made where they are missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stimuli import load_scene
from stimuli.mesh_files import decode_srgb, smooth_normals

QUAD = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\n"


def test_obj_with_material_file_keeps_colour_picture_normals_and_quads(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4), (10, 200, 30)).save(tmp_path / "green.png")
    (tmp_path / "m.mtl").write_text("newmtl one\nKd 0.5 0.25 1.0\nmap_Kd green.png\n\nnewmtl two\nKd 1 0 0\n")
    (tmp_path / "q.obj").write_text(
        "mtllib m.mtl\n" + QUAD + "v 5 0 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0.6 0.8\n"
        "usemtl one\nf 1/1/1 2/2/1 3/3/1 4/4/1\nusemtl two\nf -1//1 -3//1 -4//1\n"
    )
    scene = load_scene(tmp_path / "q.obj")
    assert scene.triangle_count == 3
    textured = [part for part in scene.static if part.material.pbr.baseColorTexture is not None]
    plain = [part for part in scene.static if part.material.pbr.baseColorTexture is None]
    assert len(textured) == len(plain) == 1
    assert textured[0].material.pbr.baseColorTexture.source[0, 0].tolist() == [10, 200, 30, 255]
    assert np.allclose(plain[0].material.pbr.baseColorFactor[:3], (1.0, 0.0, 0.0))
    assert np.allclose(textured[0].primitive.normals, [[0.0, 0.6, 0.8]] * 4)
    # v runs upwards in OBJ and downwards here.
    by_place = {tuple(p[:2]): uv for p, uv in zip(textured[0].positions, textured[0].primitive.texcoord_0, strict=True)}
    assert by_place[(0.0, 0.0)].tolist() == [0.0, 1.0]
    assert by_place[(2.0, 1.0)].tolist() == [1.0, 0.0]


def test_identity_of_an_obj_covers_its_material_file_and_pictures(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl one\nKd 0.5 0.25 1.0\n")
    (tmp_path / "q.obj").write_text("mtllib m.mtl\n" + QUAD + "usemtl one\nf 1 2 3\n")
    before = load_scene(tmp_path / "q.obj").sha256
    (tmp_path / "m.mtl").write_text("newmtl one\nKd 0.5 0.25 0.5\n")
    assert load_scene(tmp_path / "q.obj").sha256 != before


def test_ply_vertex_colours_are_display_codes_and_become_linear(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "c.ply").write_text(head + "0 0 0 188 0 255\n1 0 0 188 0 255\n0 1 0 188 0 255\n3 0 1 2\n")
    color = load_scene(tmp_path / "c.ply").static[0].primitive.color_0
    assert np.allclose(color, [[0.5028865, 0.0, 1.0, 1.0]] * 3, atol=1e-5)


def test_float64_coordinates_of_a_text_file_are_kept(tmp_path: Path) -> None:
    (tmp_path / "far.obj").write_text("v 1000000.123 0 0\nv 1000001.123 0 0\nv 1000000.123 1 0\nf 1 2 3\n")
    part = load_scene(tmp_path / "far.obj").static[0]
    assert part.positions[0, 0] == pytest.approx(1000000.123, abs=1e-9)
    assert np.float32(part.positions[0, 0]) != part.positions[0, 0]


def test_smooth_normals_weigh_faces_by_area_and_survive_unused_vertices() -> None:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2.0], [9, 9, 9]])
    normals = smooth_normals(positions, np.array([[0, 1, 2], [0, 2, 3]]))
    assert np.allclose(normals[0], np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0))
    assert normals[4].tolist() == [0.0, 0.0, 1.0]


def test_srgb_decoding_has_its_published_values() -> None:
    assert decode_srgb(np.array([0.0, 0.04045, 0.5, 1.0])).tolist() == pytest.approx(
        [0.0, 0.0031308, 0.2140411, 1.0], abs=1e-6
    )


def test_a_missing_material_file_is_said_once(tmp_path: Path) -> None:
    (tmp_path / "q.obj").write_text("mtllib gone.mtl\n" + QUAD + "usemtl one\nf 1 2 3\nusemtl two\nf 1 3 4\n")
    notes = load_scene(tmp_path / "q.obj").notes
    assert sum("material file gone.mtl is not there" in note for note in notes) == 1
