"""GLB files made by hand for tests: accessors written byte by byte, no glTF library."""

from __future__ import annotations

import copy
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class TinyGlb:
    """Collects accessors and JSON; `write` makes the file."""

    def __init__(self) -> None:
        self.blob = bytearray()
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "meshes": [],
            "nodes": [],
            "scenes": [{"nodes": []}],
            "scene": 0,
        }

    def view(self, data: bytes, stride: int = 0) -> int:
        """Append bytes as a bufferView."""
        self.blob += b"\0" * (-len(self.blob) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        if stride:
            entry["byteStride"] = stride
        self.blob += data
        self.json["bufferViews"].append(entry)
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: Any, code: str = "f4", normalized: bool = False, **extra: Any) -> int:
        """Append a packed accessor; returns its index."""
        array = np.atleast_1d(np.asarray(values))
        array = array.reshape(len(array), -1)
        entry = {
            "bufferView": self.view(array.astype("<" + code).tobytes()),
            "componentType": CODES[code],
            "count": len(array),
            "type": TYPES[array.shape[1]],
            **({"normalized": True} if normalized else {}),
            **extra,
        }
        self.json["accessors"].append(entry)
        return len(self.json["accessors"]) - 1

    def mesh(self, positions: Any, indices: Any = None, material: int | None = None, **attributes: int) -> int:
        """Append a mesh of one primitive; further attributes are accessor indices."""
        primitive: dict[str, Any] = {"attributes": {"POSITION": self.accessor(positions), **attributes}}
        if indices is not None:
            primitive["indices"] = self.accessor(np.asarray(indices).reshape(-1, 1), "u2")
        if material is not None:
            primitive["material"] = material
        self.json["meshes"].append({"primitives": [primitive]})
        return len(self.json["meshes"]) - 1

    def node(self, root: bool = True, **entry: Any) -> int:
        """Append a node, a root of the scene unless told otherwise."""
        self.json["nodes"].append(entry)
        index = len(self.json["nodes"]) - 1
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def animate(self, node: int, path: str, times: Any, values: Any, kind: str = "LINEAR", name: str = "move") -> None:
        """Add a channel to the animation called ``name``."""
        animations = self.json.setdefault("animations", [])
        found = [entry for entry in animations if entry["name"] == name]
        if not found:
            animations.append({"name": name, "channels": [], "samplers": []})
            found = animations[-1:]
        sampler = {"input": self.accessor(times), "output": self.accessor(values), "interpolation": kind}
        found[0]["samplers"].append(sampler)
        found[0]["channels"].append({"sampler": len(found[0]["samplers"]) - 1, "target": {"node": node, "path": path}})

    def bytes(self) -> bytes:
        """The whole GLB."""
        tree = copy.deepcopy(self.json)
        tree["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        blob = bytes(self.blob) + b"\0" * (-len(self.blob) % 4)
        length = 12 + 8 + len(text) + 8 + len(blob)
        head = b"glTF" + struct.pack("<II", 2, length)
        return (
            head + struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
        )

    def write(self, folder: Path, name: str = "tiny.glb") -> Path:
        """Write the file into ``folder``."""
        path = folder / name
        path.write_bytes(self.bytes())
        return path


TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def picture(color: tuple[int, ...], mode: str = "RGB") -> bytes:
    """The bytes of a 2x2 PNG of one colour."""
    data = io.BytesIO()
    Image.new(mode, (2, 2), color).save(data, "PNG")
    return data.getvalue()


def textured(glb: TinyGlb, **material: object) -> None:
    """Add a textured triangle with two sets of coordinates and one material."""
    uv = glb.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    uv1 = glb.accessor([[0.5, 0.5], [0.25, 0.5], [0.5, 0.75]])
    image = glb.view(picture((255, 128, 0)))
    glb.json["images"] = [{"bufferView": image, "mimeType": "image/png"}]
    glb.json["samplers"] = [{"magFilter": 9728, "minFilter": 9984, "wrapS": 33071, "wrapT": 33648}]
    glb.json["textures"] = [{"source": 0, "sampler": 0}]
    glb.json["materials"] = [material]
    glb.node(mesh=glb.mesh(TRIANGLE, material=0, TEXCOORD_0=uv, TEXCOORD_1=uv1))
