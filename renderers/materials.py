"""Materials as a flat table that kernels gather from, and what a hit's material is after textures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import opaque_float
from renderers.requirements import Requirements, base_rgba, is_cutout, is_see_through, texture_image
from renderers.surface import Surface
from renderers.textures import TextureArrays, TextureSource, build_atlas, look_up, source_of
from stimuli.scene import Material

_ROWS = 7  # Vector4f rows of a material
_PHONG, _UNLIT, _CUTOUT, _SEE_THROUGH = 1, 2, 4, 8


@dataclass
class MaterialArrays:
    """A PyTree: ``rows`` (M, 7, 4) float32 flat (see `_row`), and all textures."""

    rows: Any
    textures: TextureArrays


@dataclass
class Look:
    """A PyTree: one hit's material. Phong: ``diffuse``, ``specular``, ``shine``, ``ambient``; metallic-roughness:
    ``diffuse`` = base (1 - metallic), ``specular`` = F0, ``roughness``, ``ambient`` = base colour.
    """

    phong: Any
    unlit: Any
    base: Any
    diffuse: Any
    specular: Any
    shine: Any
    roughness: Any
    ambient: Any
    emission: Any
    alpha: Any
    transmission: Any
    see_through: Any


def _row(material: Material, textures: tuple[int, int, int]) -> np.ndarray:
    """(7, 4): base rgba | diffuse, shine | specular, roughness | ambient, metallic | emission, transmission |
    base, emissive, metallic-roughness texture (-1: none), kind bits | alpha cutoff, 0, 0, 0."""
    pbr, phong = material.pbr, material.phong
    base = base_rgba(material)
    emission = np.zeros(3) if pbr.emissiveFactor is None else np.asarray(pbr.emissiveFactor, float)[:3]
    bits = (phong is not None) * _PHONG + material.unlit * _UNLIT
    bits += is_cutout(material) * _CUTOUT + is_see_through(material) * _SEE_THROUGH
    cutoff = 0.5 if pbr.alphaCutoff is None else float(pbr.alphaCutoff)
    transmission = max(material.transmission, phong.transmission if phong else 0.0)
    diffuse, specular, ambient = (phong.diffuse, phong.specular, phong.ambient) if phong else ((0, 0, 0),) * 3
    return np.array(
        [
            base,
            [*diffuse, phong.shine if phong else 0.0],
            [*specular, float(pbr.roughnessFactor)],
            [*ambient, float(pbr.metallicFactor)],
            [*emission, transmission],
            [*textures, bits],
            [cutoff, 0, 0, 0],
        ],
        np.float32,
    )


def material_arrays(materials: tuple[Material, ...]) -> MaterialArrays:
    """The device's table of ``materials`` with the atlas of their textures (an image used twice is stored once)."""
    sources: list[TextureSource] = []
    numbers: dict[tuple[int, int, bool], int] = {}

    def number(texture: Any, srgb: bool) -> int:
        if texture_image(texture) is None:
            return -1
        key = (id(texture.source), id(texture.sampler), srgb)
        if key not in numbers:
            numbers[key] = len(sources)
            sources.append(source_of(texture, srgb))
        return numbers[key]

    rows = [
        _row(
            m,
            (
                number(m.pbr.baseColorTexture, True),
                number(m.pbr.emissiveTexture, True),
                number(m.pbr.metallicRoughnessTexture, False) if m.phong is None else -1,
            ),
        )
        for m in materials
    ]
    table = np.stack(rows) if rows else np.zeros((1, _ROWS, 4), np.float32)
    return MaterialArrays(opaque_float(table), build_atlas(sources))


def _row_at(arrays: MaterialArrays, material: Any, row: int, active: Any) -> Any:
    return dr.gather(mi.Vector4f, arrays.rows, material * _ROWS + row, active)


def _rgb(v: Any) -> Any:
    return mi.Color3f(v.x, v.y, v.z)


def _textured(arrays: MaterialArrays, texture: Any, surface: Surface, footprint: Any, active: Any) -> Any:
    """The texture's value, or 1 where the material has none (number -1)."""
    on = active & (texture >= 0)
    value = look_up(arrays.textures, mi.UInt32(dr.maximum(texture, 0)), surface.uv, footprint, on)
    return dr.select(on, value, mi.Vector4f(1))


def opacity(needs: Requirements, arrays: MaterialArrays, surface: Surface, width: Any, facing: Any, active: Any) -> Any:
    """Whether a hit is there at all: False where an alphaMode MASK material is cut out."""
    maps = _row_at(arrays, surface.material, 5, active)
    base = _row_at(arrays, surface.material, 0, active)
    alpha = base.w * surface.color.w
    cutout = (mi.UInt32(maps.w) & _CUTOUT) != 0
    if needs.base_texture:
        alpha *= _textured(arrays, maps.x, surface, _footprint(surface, width, facing), active & cutout).w
    return ~cutout | (alpha >= _row_at(arrays, surface.material, 6, active).x)


def _footprint(surface: Surface, width: Any, facing: Any) -> Any:
    """Width of a cone on the surface in texture coordinates, stretched by the angle (Akenine-Moeller et al. 2019)."""
    return width * surface.uv_density * dr.rcp(dr.maximum(facing, 1e-3))


def look_at_hit(
    needs: Requirements, arrays: MaterialArrays, surface: Surface, width: Any, facing: Any, active: Any
) -> Look:
    """The material at a hit. ``width``: cone width there (tracer units); ``facing``: |cosine| of ray and face."""
    material = surface.material
    zero, none = mi.Color3f(0), mi.Bool(False)
    maps = _row_at(arrays, material, 5, active)
    bits = mi.UInt32(maps.w)
    footprint = _footprint(surface, width, facing) if needs.textures else None
    texture = mi.Vector4f(1)
    if needs.base_texture:
        texture = _textured(arrays, maps.x, surface, footprint, active)
    texture = texture * surface.color
    base, alpha = zero, mi.Float(1)
    if needs.metallic or needs.unlit or needs.transparency:
        row = _row_at(arrays, material, 0, active) * texture
        base, alpha = _rgb(row), row.w
    fifth: Any = _row_at(arrays, material, 4, active) if needs.emissive or needs.transparency else None
    emission = zero
    if needs.emissive:
        emission = _rgb(fifth)
        if needs.other_textures:
            emission *= _rgb(_textured(arrays, maps.y, surface, footprint, active))
    diffuse, specular, ambient = base, zero, base
    shine = roughness = mi.Float(1)
    phong = mi.Bool(not needs.metallic and not needs.unlit)
    if needs.metallic or needs.specular:
        second = _row_at(arrays, material, 2, active)
    if needs.metallic:
        metallic = _row_at(arrays, material, 3, active).w
        roughness = second.w
        if needs.other_textures:
            packed = _textured(arrays, maps.z, surface, footprint, active)
            metallic, roughness = metallic * packed.z, roughness * packed.y
        diffuse = base * (1 - metallic)
        specular = dr.lerp(mi.Color3f(0.04), base, metallic)
    if needs.phong:
        phong = (bits & _PHONG) != 0 if needs.metallic or needs.unlit else mi.Bool(True)
        first = _row_at(arrays, material, 1, active)
        third = _row_at(arrays, material, 3, active)
        diffuse = dr.select(phong, _rgb(first) * _rgb(texture), diffuse)
        ambient = dr.select(phong, _rgb(third) * _rgb(texture), ambient)
        if needs.specular:
            specular = dr.select(phong, _rgb(second), specular)
            shine = first.w
    unlit = (bits & _UNLIT) != 0 if needs.unlit else none
    return Look(
        phong=phong,
        unlit=unlit,
        base=base,
        diffuse=diffuse,
        specular=specular,
        shine=shine,
        roughness=roughness,
        ambient=ambient,
        emission=dr.select(unlit, base, emission) if needs.unlit else emission,
        alpha=alpha,
        transmission=fifth.w if needs.transparency else mi.Float(0),
        see_through=(bits & _SEE_THROUGH) != 0 if needs.transparency else none,
    )
