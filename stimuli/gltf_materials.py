"""glTF materials, textures and images as pyrender's types; BART's Phong values from ``extras.aff_fm``.

Source: glTF 2.0 specification 3.8, 3.9; KHR_materials_{unlit, emissive_strength, transmission, ior}.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from stimuli.errors import InputError, problem
from stimuli.gltf_buffers import Document, refuse_extensions
from stimuli.scene import RGB, Material, Phong, pyrender

CLAMP, MIRROR, REPEAT = 33071, 33648, 10497
"""GL enums of the wrap modes."""


@dataclass(frozen=True)
class TextureUse:
    """Which texture coordinates a texture wants: their set, and the 3x3 KHR_texture_transform on (u, v, 1)."""

    texcoord: int = 0
    transform: np.ndarray = field(default_factory=lambda: np.eye(3))

    def same_as(self, other: TextureUse) -> bool:
        """True where both read the same coordinates."""
        return self.texcoord == other.texcoord and bool(np.allclose(self.transform, other.transform))


@dataclass(frozen=True)
class ReadMaterial:
    """A material and the coordinates that its textures want (the first texture's; the others must agree)."""

    material: Material
    use: TextureUse


def decode_image(data: bytes, where: str) -> np.ndarray:
    """(H, W, 4) uint8 from PNG, JPEG or anything else that Pillow knows; InputError where it is no image."""
    try:
        with Image.open(io.BytesIO(data)) as image:
            if image.mode.startswith("I;16"):
                return np.asarray(Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert("RGBA"))
            return np.asarray(image.convert("RGBA"))
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, SyntaxError, ValueError) as error:
        raise InputError(problem(where, "image", str(error), "a PNG or JPEG that can be decoded")) from error


def texture_of(
    pixels: np.ndarray,
    name: str = "",
    wrap: tuple[int, int] = (REPEAT, REPEAT),
    mag: int | None = None,
    mip: int | None = None,
) -> pyrender.Texture:
    """A pyrender texture of (H, W, 4) uint8 codes; ``mag`` and ``mip`` are GL filter enums, None: any."""
    sampler = pyrender.Sampler(magFilter=mag, minFilter=mip, wrapS=wrap[0], wrapT=wrap[1])
    return pyrender.Texture(name=name, sampler=sampler, source=pixels, source_channels="RGBA")


class MaterialReader:
    """Reads each material, texture and image of a document once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._images: dict[int, np.ndarray | None] = {}
        self._textures: dict[int, pyrender.Texture | None] = {}
        self._materials: dict[int | None, ReadMaterial] = {}

    def read(self, index: int | None) -> ReadMaterial:
        """Material ``index``; None is glTF's default material."""
        if index not in self._materials:
            entry = {} if index is None else self._document.item("materials", index, "primitive")
            self._materials[index] = self._material(entry, f"material {index}")
        return self._materials[index]

    def _material(self, entry: dict[str, Any], label: str) -> ReadMaterial:
        name = str(entry.get("name", label))
        where = f"{self._document.path.name}: material {name!r}"
        extensions = entry.get("extensions", {})
        glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
        metal = entry.get("pbrMetallicRoughness", {}) if glossy is None else _from_glossiness(glossy)
        if glossy is not None:
            self._document.note(f"{where}: specular-glossiness is read as its diffuse colour and glossiness")
        slots: dict[str, Mapping[str, Any] | None] = {
            "baseColorTexture": metal.get("baseColorTexture"),
            "emissiveTexture": entry.get("emissiveTexture"),
            "metallicRoughnessTexture": metal.get("metallicRoughnessTexture"),
            "normalTexture": entry.get("normalTexture"),
            "occlusionTexture": entry.get("occlusionTexture"),
        }
        uses = {slot: _texture_use(info) for slot, info in slots.items() if info is not None}
        main = next(iter(uses.values()), TextureUse())
        textures: dict[str, pyrender.Texture | None] = {}
        for slot, use in uses.items():
            if use.same_as(main):
                info = slots[slot] or {}
                textures[slot] = self._texture(info.get("index", -1))
            else:
                self._document.note(
                    f"{where}: {slot} left out: it wants other texture coordinates than the first texture"
                )
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        emissive = np.asarray(_numbers(entry.get("emissiveFactor", (0.0, 0.0, 0.0)), 3, where, "emissiveFactor"))
        pbr = pyrender.MetallicRoughnessMaterial(
            name=name,
            baseColorFactor=np.asarray(_numbers(metal.get("baseColorFactor", (1.0,) * 4), 4, where, "baseColorFactor")),
            metallicFactor=float(metal.get("metallicFactor", 1.0)),
            roughnessFactor=float(metal.get("roughnessFactor", 1.0)),
            emissiveFactor=emissive * strength,
            alphaMode=entry.get("alphaMode", "OPAQUE"),
            alphaCutoff=float(entry.get("alphaCutoff", 0.5)),
            doubleSided=bool(entry.get("doubleSided", False)),
            **textures,
        )
        transmission = extensions.get("KHR_materials_transmission", {})
        if "transmissionTexture" in transmission:
            self._document.note(f"{where}: transmissionTexture not used, the factor alone counts")
        extras = entry.get("extras")
        phong = _phong(extras["aff_fm"], where) if isinstance(extras, dict) and "aff_fm" in extras else None
        material = Material(
            name=name,
            pbr=pbr,
            phong=phong,
            transmission=phong.transmission if phong else float(transmission.get("transmissionFactor", 0.0)),
            unlit="KHR_materials_unlit" in extensions,
            ior=float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5)),
        )
        return ReadMaterial(material, main)

    def _texture(self, index: int) -> pyrender.Texture | None:
        if index not in self._textures:
            entry = self._document.item("textures", index, "material")
            source = entry.get("source", entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source"))
            if source is None:
                refuse_extensions(self._document, entry.get("extensions", {}))
                self._document.note(f"{self._document.path.name}: texture {index} has no image we can read; left out")
            pixels = None if source is None else self._image(source)
            sampler = self._document.item("samplers", entry["sampler"], "texture") if "sampler" in entry else {}
            self._textures[index] = (
                None
                if pixels is None
                else texture_of(
                    pixels,
                    name=str(entry.get("name", f"texture {index}")),
                    wrap=(sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)),
                    mag=sampler.get("magFilter"),
                    mip=sampler.get("minFilter"),
                )
            )
        return self._textures[index]

    def _image(self, index: int) -> np.ndarray | None:
        if index not in self._images:
            document = self._document
            entry = document.item("images", index, "texture")
            where = f"{document.path.name}: image {entry.get('name', entry.get('uri', index))!s:.60}"
            if "bufferView" in entry:
                data: bytes | None = bytes(document.view_bytes(entry["bufferView"])[0])
            else:
                data = document.uri_bytes(str(entry.get("uri", "")))
            pixels: np.ndarray | None = None
            if data is not None and data[:4] == b"\xabKTX":
                refuse_extensions(document, ["KHR_texture_basisu"])
            if data is None:
                document.note(f"{where}: no such file; drawn without this texture")
            else:
                try:
                    pixels = decode_image(data, where)
                except InputError as error:
                    document.note(f"{error}; drawn without this texture")
            self._images[index] = pixels
        return self._images[index]


def _from_glossiness(values: Mapping[str, Any]) -> dict[str, Any]:
    """A metallic-roughness entry with the diffuse colour and 1 - glossiness of a specular-glossiness one."""
    metal: dict[str, Any] = {
        "baseColorFactor": values.get("diffuseFactor", [1.0, 1.0, 1.0, 1.0]),
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0 - float(values.get("glossinessFactor", 1.0)),
    }
    if "diffuseTexture" in values:
        metal["baseColorTexture"] = values["diffuseTexture"]
    return metal


def _texture_use(info: Mapping[str, Any]) -> TextureUse:
    extra = info.get("extensions", {}).get("KHR_texture_transform")
    texcoord = int(info.get("texCoord", 0))
    if extra is None:
        return TextureUse(texcoord)
    (du, dv), (su, sv) = extra.get("offset", (0.0, 0.0)), extra.get("scale", (1.0, 1.0))
    turn = float(extra.get("rotation", 0.0))
    # T R S on (u, v, 1): counter-clockwise seen with v downwards, as the text of KHR_texture_transform has it and as
    # viewers do it (its GLSL lines, read by columns, would turn the other way).
    rotation = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    move = np.array([[1.0, 0.0, du], [0.0, 1.0, dv], [0.0, 0.0, 1.0]])
    return TextureUse(int(extra.get("texCoord", texcoord)), move @ rotation @ np.diag([su, sv, 1.0]))


def _phong(values: Mapping[str, Any], where: str) -> Phong:
    """BART's AFF material line: ambient, diffuse, specular, shine, transmission, index of refraction."""
    return Phong(
        ambient=_rgb(values.get("amb"), where, "aff_fm amb"),
        diffuse=_rgb(values.get("dif"), where, "aff_fm dif"),
        specular=_rgb(values.get("spc"), where, "aff_fm spc"),
        shine=float(values.get("shine", 0.0)),
        transmission=float(values.get("T", 0.0)),
        # AFF writes 0 for surfaces that do not refract.
        index=float(values.get("ior", 0.0)) or 1.0,
    )


def _rgb(value: object, where: str, what: str) -> RGB:
    red, green, blue = _numbers(value, 3, where, what)
    return (red, green, blue)


def _numbers(value: object, count: int, where: str, what: str) -> list[float]:
    if (
        not isinstance(value, (list, tuple))
        or len(value) != count
        or not all(isinstance(item, (int, float)) and np.isfinite(item) for item in value)
    ):
        raise InputError(problem(where, what, value, f"{count} finite numbers"))
    return [float(item) for item in value]
