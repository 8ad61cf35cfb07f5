"""What a scene requires of the kernels. A branch that no material, light or mover needs is never recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

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
    deforming: bool
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

    @classmethod
    def all(cls, own: Requirements) -> Requirements:
        """Every feature, with the bodies and lights of ``own``: what a kernel for any scene would contain."""
        every: dict[str, Any] = dict.fromkeys(FEATURES, True)
        return replace(own, **every)

    @property
    def textures(self) -> bool:
        """Whether texture coordinates are needed at all."""
        return self.base_texture or self.other_textures


_GEOMETRY = ("static", "glass", "deforming")
FEATURES = tuple(f.name for f in fields(Requirements) if f.type == "bool" and f.name not in _GEOMETRY)
"""What can be added to a scene's kernels without adding geometry or lights to the scene."""


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


def _emits(m: Material) -> bool:
    return m.pbr.emissiveFactor is not None and max(np.asarray(m.pbr.emissiveFactor, float)) > 0


def _other_texture(m: Material) -> bool:
    more = m.pbr.metallicRoughnessTexture is not None or m.pbr.emissiveTexture is not None
    return m.phong is None and more and not m.unlit


_OF_MATERIALS: Mapping[str, Callable[[Material], bool]] = {
    "phong": lambda m: m.phong is not None,
    "metallic": lambda m: m.phong is None and not m.unlit,
    "specular": lambda m: not m.unlit and (m.phong is None or max(m.phong.specular) > 0),
    "emissive": _emits,
    "unlit": lambda m: m.unlit,
    "mirrors": mirror_possible,
    "transparency": is_see_through,
    "cutouts": is_cutout,
    "base_texture": lambda m: texture_image(m.pbr.baseColorTexture) is not None,
    "other_textures": _other_texture,
}
_OF_PARTS: Mapping[str, Callable[[Part], bool]] = {
    "normals": lambda part: part.primitive.normals is not None,
    "colors": lambda part: part.primitive.color_0 is not None,
}
_MEANING: Mapping[str, str] = {
    "static": "triangles that stand still and cast shadows",
    "glass": "still triangles that shadow rays never ask",
    "deforming": "skinned and morphing meshes, with the shape of each view's time",
    "movers": "rigid bodies with a pose at each ray's time",
    "appearing": "movers that are there for a part of the time",
    "normals": "interpolated shading normals",
    "colors": "vertex colours",
    "phong": "Phong materials",
    "metallic": "metallic-roughness materials",
    "specular": "highlights",
    "emissive": "own light of surfaces",
    "unlit": "surfaces that show their colour as it is",
    "mirrors": "the reflection loop",
    "transparency": "the straight-on rays through surfaces, in the same loop",
    "cutouts": "the loop past cut-out texels",
    "base_texture": "the base colour's texture fetch",
    "other_textures": "fetches of roughness and emission",
    "ambient": "the ambient term",
    "lights": "a loop a kind of light",
}


@dataclass(frozen=True)
class Reason:
    """One feature of a scene's kernels: whether it is ``required``, what it means, and the parts, materials, movers or
    lights that need it, by name."""

    feature: str
    required: bool
    meaning: str
    because: tuple[str, ...]


def reasons(scene: Scene, sphere_sampled: bool = False) -> tuple[Reason, ...]:
    """Every feature with what requires it, in the order of `Requirements`."""
    parts = all_parts(scene)
    materials = list({id(part.material): part.material for part in parts}.values())
    hidden = [is_see_through(part.material) or is_cutout(part.material) for part in scene.static]
    found: dict[str, list[str]] = {
        "static": [f"mesh {p.name}" for p, h in zip(scene.static, hidden, strict=True) if not h],
        "glass": [f"mesh {p.name}" for p, h in zip(scene.static, hidden, strict=True) if h],
        "deforming": [f"mesh {scene.static[skin.part].name}" for skin in scene.skins],
        "movers": [f"mover {mover.name}" for mover in scene.movers],
        "appearing": [f"mover {mover.name}" for mover in scene.movers if np.isfinite(mover.visible_s).any()],
        **{name: [f"mesh {p.name}" for p in parts if needs(p)] for name, needs in _OF_PARTS.items()},
        **{name: [f"material {m.name}" for m in materials if needs(m)] for name, needs in _OF_MATERIALS.items()},
        "ambient": [f"ambient light {scene.ambient}"] if max(scene.ambient) > 0 else [],
        "lights": [f"{light_kind(light, sphere_sampled)} light {light.name}".strip() for light in scene.lights],
    }
    return tuple(
        Reason(f.name, bool(found[f.name]), _MEANING[f.name], tuple(found[f.name])) for f in fields(Requirements)
    )


def requirements_of(scene: Scene, sphere_sampled: bool = False) -> Requirements:
    """What ``scene`` requires."""
    required = {reason.feature: reason.required for reason in reasons(scene, sphere_sampled)}
    kinds = tuple(sorted({light_kind(light, sphere_sampled) for light in scene.lights}))
    return Requirements(**{**required, "movers": len(scene.movers), "lights": kinds})  # type: ignore[arg-type]
