"""What a scene requires of the kernels. A branch that no material, light or mover needs is never recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stimuli.scene import Light, Material, Part, Scene

MIRROR_ROUGHNESS = 0.25
"""Metallic-roughness surfaces up to this roughness reflect (decisions.md, Rays)."""
MIRROR_LEAST = 0.03
"""Reflections that weigh less send no ray."""


@dataclass(frozen=True)
class Requirements:
    """The features of one scene's kernels; hashable, part of every recording."""

    static: bool
    glass: bool
    movers: int
    appearing: bool
    normals: bool
    colors: bool
    phong: bool
    metallic: bool
    specular: bool
    emissive: bool
    unlit: bool
    mirrors: bool
    transparency: bool
    cutouts: bool
    base_texture: bool
    other_textures: bool
    ambient: bool
    lights: tuple[str, ...]

    @property
    def textures(self) -> bool:
        """Whether texture coordinates are needed at all."""
        return self.base_texture or self.other_textures


def base_rgba(material: Material) -> np.ndarray:
    """(4,) base colour factor; white where the file gives none."""
    factor = material.pbr.baseColorFactor
    return np.ones(4) if factor is None else np.asarray(np.append(np.asarray(factor, float), [1.0] * 4)[:4], float)


def texture_image(texture: object | None) -> np.ndarray | None:
    """The (H, W, C) uint8 source of a pyrender texture, or None."""
    source = None if texture is None else getattr(texture, "source", None)
    return None if source is None else np.asarray(source)


def is_cutout(material: Material) -> bool:
    """alphaMode MASK with some texel or factor below the cutoff."""
    return str(material.pbr.alphaMode) == "MASK"


def is_see_through(material: Material) -> bool:
    """Transmits, or blends with an alpha that is somewhere below 1: such meshes cast no shadow."""
    if material.transmission > 0 or (material.phong is not None and material.phong.transmission > 0):
        return True
    if str(material.pbr.alphaMode) != "BLEND":
        return False
    image = texture_image(material.pbr.baseColorTexture)
    textured = image is not None and image.ndim == 3 and image.shape[2] == 4 and bool((image[..., 3] < 255).any())
    return base_rgba(material)[3] < 1 or textured


def mirror_possible(material: Material) -> bool:
    """Whether some part of this material can send a reflection ray."""
    if material.unlit:
        return False
    if material.phong is not None:
        return max(material.phong.specular) >= MIRROR_LEAST
    return material.pbr.metallicRoughnessTexture is not None or material.pbr.roughnessFactor <= MIRROR_ROUGHNESS


def light_kind(light: Light, sphere_sampled: bool) -> str:
    """The kernel that a light needs; an unsampled sphere is a point light."""
    return "point" if light.kind == "sphere" and not sphere_sampled else light.kind


def all_parts(scene: Scene) -> list[Part]:
    """Static parts, then the movers' parts, in file order."""
    return [*scene.static, *(part for mover in scene.movers for part in mover.parts)]


def requirements_of(scene: Scene, sphere_sampled: bool = False) -> Requirements:
    """What ``scene`` requires."""
    parts = all_parts(scene)
    materials = [part.material for part in parts]
    hidden = [is_see_through(m) or is_cutout(m) for m in materials]
    emissive = [
        m.pbr.emissiveFactor is not None and max(np.asarray(m.pbr.emissiveFactor, float)) > 0 for m in materials
    ]
    other = [
        m.phong is None
        and (m.pbr.metallicRoughnessTexture is not None or m.pbr.emissiveTexture is not None)
        and not m.unlit
        for m in materials
    ]
    return Requirements(
        static=any(not h for h in hidden[: len(scene.static)]),
        glass=any(hidden[: len(scene.static)]),
        movers=len(scene.movers),
        appearing=any(np.isfinite(mover.visible_s).any() for mover in scene.movers),
        normals=any(part.primitive.normals is not None for part in parts),
        colors=any(part.primitive.color_0 is not None for part in parts),
        phong=any(m.phong is not None for m in materials),
        metallic=any(m.phong is None and not m.unlit for m in materials),
        specular=any(not m.unlit and (m.phong is None or max(m.phong.specular) > 0) for m in materials),
        emissive=any(emissive),
        unlit=any(m.unlit for m in materials),
        mirrors=any(mirror_possible(m) for m in materials),
        transparency=any(is_see_through(m) for m in materials),
        cutouts=any(is_cutout(m) for m in materials),
        base_texture=any(texture_image(m.pbr.baseColorTexture) is not None for m in materials),
        other_textures=any(other),
        ambient=max(scene.ambient) > 0,
        lights=tuple(sorted({light_kind(light, sphere_sampled) for light in scene.lights})),
    )
