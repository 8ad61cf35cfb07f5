"""Materials, textures, samplers and vertex colours of glTF files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stimuli import load_scene
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb, textured


def test_materials_textures_and_samplers_arrive(tmp_path: Path) -> None:
    glb = TinyGlb()
    textured(
        glb,
        name="wood",
        pbrMetallicRoughness={
            "baseColorFactor": [0.5, 0.6, 0.7, 0.8],
            "metallicFactor": 0.25,
            "roughnessFactor": 0.75,
            "baseColorTexture": {"index": 0},
        },
        emissiveFactor=[0.1, 0.2, 0.3],
        alphaMode="MASK",
        alphaCutoff=0.3,
        doubleSided=True,
        extensions={
            "KHR_materials_emissive_strength": {"emissiveStrength": 50.0},
            "KHR_materials_ior": {"ior": 1.7},
            "KHR_materials_transmission": {"transmissionFactor": 0.6},
            "KHR_materials_unlit": {},
        },
    )
    part = load_scene(glb.write(tmp_path)).static[0]
    material, pbr = part.material, part.material.pbr
    assert np.allclose(pbr.baseColorFactor, [0.5, 0.6, 0.7, 0.8])
    assert (pbr.metallicFactor, pbr.roughnessFactor, pbr.alphaMode, pbr.alphaCutoff) == (0.25, 0.75, "MASK", 0.3)
    assert np.allclose(pbr.emissiveFactor, [5.0, 10.0, 15.0])
    assert (material.ior, material.transmission, material.unlit, pbr.doubleSided) == (1.7, 0.6, True, True)
    texture = pbr.baseColorTexture
    assert texture.source.shape == (2, 2, 4)
    assert texture.source[0, 0].tolist() == [255, 128, 0, 255]
    assert (texture.sampler.wrapS, texture.sampler.wrapT) == (33071, 33648)
    assert (texture.sampler.magFilter, texture.sampler.minFilter) == (9728, 9984)
    assert part.primitive.texcoord_0.tolist() == [[0, 0], [1, 0], [0, 1]]


def test_second_coordinate_set_and_texture_transform_are_applied_to_the_vertices(tmp_path: Path) -> None:
    glb = TinyGlb()
    transform = {"offset": [0.5, 0.0], "rotation": np.pi / 2, "scale": [2.0, 4.0]}
    use = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": transform}}
    textured(glb, pbrMetallicRoughness={"baseColorTexture": use})
    uv = load_scene(glb.write(tmp_path)).static[0].primitive.texcoord_0
    # Scale, then turn by 90 degrees as KHR_texture_transform's matrix does: (u, v) -> (v, -u), then shift.
    source = np.array([[0.5, 0.5], [0.25, 0.5], [0.5, 0.75]]) * (2.0, 4.0)
    assert np.allclose(uv, np.stack([source[:, 1] + 0.5, -source[:, 0]], axis=1), atol=1e-6)


def test_a_texture_that_wants_other_coordinates_is_left_out_aloud(tmp_path: Path) -> None:
    glb = TinyGlb()
    textured(glb, pbrMetallicRoughness={"baseColorTexture": {"index": 0}}, emissiveTexture={"index": 0, "texCoord": 1})
    scene = load_scene(glb.write(tmp_path))
    assert scene.static[0].material.pbr.emissiveTexture is None
    assert scene.static[0].material.pbr.baseColorTexture is not None
    assert any("emissiveTexture left out" in note for note in scene.notes)


def test_missing_and_broken_pictures_are_said_and_the_factor_stays(tmp_path: Path) -> None:
    glb = TinyGlb()
    textured(glb, pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "baseColorFactor": [0.2, 0.3, 0.4, 1.0]})
    glb.json["images"] = [{"uri": "gone.png"}]
    scene = load_scene(glb.write(tmp_path))
    assert scene.static[0].material.pbr.baseColorTexture is None
    assert any("gone.png: no such file" in note for note in scene.notes)
    glb.json["images"] = [{"bufferView": glb.view(b"not a picture")}]
    scene = load_scene(glb.write(tmp_path))
    assert any("image" in note and "without this texture" in note for note in scene.notes)


def test_bart_phong_values_come_from_the_extras(tmp_path: Path) -> None:
    glb = TinyGlb()
    values = {
        "amb": [0.1, 0.2, 0.3],
        "dif": [0.4, 0.5, 0.6],
        "spc": [0.7, 0.8, 0.9],
        "shine": 20.0,
        "T": 0.25,
        "ior": 0.0,
    }
    textured(glb, extras={"aff_fm": values})
    scene = load_scene(glb.write(tmp_path))
    phong = scene.static[0].material.phong
    assert phong is not None
    assert (phong.ambient, phong.diffuse, phong.specular) == ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9))
    assert (phong.shine, phong.transmission, phong.index) == (20.0, 0.25, 1.0)
    assert scene.default_exposure == 1.0


def test_vertex_colours_of_any_type_become_linear_rgba(tmp_path: Path) -> None:
    glb = TinyGlb()
    bytes3 = glb.accessor([[255, 0, 51]] * 3, "u1", normalized=True)
    floats4 = glb.accessor([[0.5, 0.25, 0.125, 0.75]] * 3)
    glb.node(mesh=glb.mesh(TRIANGLE, COLOR_0=bytes3))
    glb.node(mesh=glb.mesh(TRIANGLE, COLOR_0=floats4))
    first, second = load_scene(glb.write(tmp_path)).static
    assert np.allclose(first.primitive.color_0, [[1.0, 0.0, 0.2, 1.0]] * 3)
    assert np.allclose(second.primitive.color_0, [[0.5, 0.25, 0.125, 0.75]] * 3)


def test_specular_glossiness_keeps_its_diffuse_colour_and_picture(tmp_path: Path) -> None:
    glb = TinyGlb()
    glossy = {"diffuseFactor": [0.1, 0.2, 0.3, 1.0], "glossinessFactor": 0.25, "diffuseTexture": {"index": 0}}
    textured(glb, extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    scene = load_scene(glb.write(tmp_path))
    pbr = scene.static[0].material.pbr
    assert np.allclose(pbr.baseColorFactor, [0.1, 0.2, 0.3, 1.0])
    assert (pbr.metallicFactor, pbr.roughnessFactor) == (0.0, 0.75)
    assert pbr.baseColorTexture is not None
    assert any("specular-glossiness" in note for note in scene.notes)
