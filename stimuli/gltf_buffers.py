"""glTF 2.0 containers and accessors: from a file's bytes to the numpy arrays that its accessors describe.

Source: Khronos glTF 2.0 specification, sections 3.6 (binary data, sparse, normalised) and 4 (GLB container).
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from stimuli.errors import InputError, problem

_COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPE = {
    "SCALAR": (1, 1),
    "VEC2": (2, 1),
    "VEC3": (3, 1),
    "VEC4": (4, 1),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
REFUSED = {
    "KHR_draco_mesh_compression": "meshes compressed with Draco",
    "EXT_meshopt_compression": "buffers compressed with meshopt",
    "KHR_meshopt_compression": "buffers compressed with meshopt",
    "KHR_texture_basisu": "textures in KTX2 (Basis Universal)",
}
"""Extensions that hide data which this reader cannot unpack, in words."""
READ = {
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
}
"""Extensions whose meaning this reader keeps."""


@dataclass
class Document:
    """One glTF file: its JSON, its binary chunk, and a running hash of every byte that was read."""

    path: Path
    json: dict[str, Any]
    chunk: bytes | None
    digest: Any = field(default_factory=hashlib.sha256)
    notes: list[str] = field(default_factory=list)
    _buffers: dict[int, bytes] = field(default_factory=dict)
    _lists: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def items(self, kind: str) -> list[dict[str, Any]]:
        """The JSON array ``kind`` ('nodes', 'meshes', ...), empty where the file has none."""
        if kind not in self._lists:
            value = self.json.get(kind, [])
            if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
                raise InputError(problem(self.path, kind, type(value).__name__, "a list of objects"))
            self._lists[kind] = value
        return self._lists[kind]

    def item(self, kind: str, index: object, wanted_by: str) -> dict[str, Any]:
        """Entry ``index`` of ``kind``; InputError names who asked where there is none."""
        values = self.items(kind)
        if not isinstance(index, int) or not 0 <= index < len(values):
            raise InputError(problem(self.path, f"{wanted_by}: index into {kind}", index, f"0 to {len(values) - 1}"))
        return values[index]

    def note(self, line: str) -> None:
        """Remember a line for the user, once."""
        if line not in self.notes:
            self.notes.append(line)

    def uri_bytes(self, uri: str) -> bytes | None:
        """The bytes behind a data URI or a file beside the document; None where that file is absent."""
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                return base64.b64decode(body, validate=True) if head.endswith(";base64") else unquote_to_bytes(body)
            except binascii.Error as error:
                raise InputError(problem(self.path, "data uri", error, "valid base64")) from error
        file = self.path.parent / unquote(uri)
        if not file.is_file():
            return None
        data = file.read_bytes()
        self.digest.update(data)
        return data

    def buffer(self, index: int) -> bytes:
        """All bytes of buffer ``index`` (GLB chunk, data URI or file beside)."""
        if index not in self._buffers:
            entry = self.item("buffers", index, "bufferView")
            uri = entry.get("uri")
            data = self.chunk if uri is None else self.uri_bytes(uri)
            if data is None:
                what = "no binary chunk" if uri is None else f"no file {unquote(uri)}"
                raise InputError(problem(self.path, f"buffer {index}", what, f"{entry.get('byteLength')} bytes"))
            if len(data) < entry.get("byteLength", 0):
                raise InputError(
                    problem(
                        self.path, f"buffer {index}", f"{len(data)} bytes", f"{entry['byteLength']} (file cut short?)"
                    )
                )
            self._buffers[index] = data
        return self._buffers[index]

    def view_bytes(self, index: int) -> tuple[memoryview, int]:
        """Bytes of bufferView ``index`` and its byteStride (0: tightly packed)."""
        view = self.item("bufferViews", index, "accessor")
        refuse_extensions(self, view.get("extensions", {}))
        start, length = int(view.get("byteOffset", 0)), int(view.get("byteLength", 0))
        data = self.buffer(view.get("buffer", -1))
        if start < 0 or start + length > len(data):
            raise InputError(
                problem(self.path, f"bufferView {index}", f"bytes {start} to {start + length}", f"at most {len(data)}")
            )
        return memoryview(data)[start : start + length], int(view.get("byteStride", 0))

    def raw(self, index: int) -> np.ndarray:
        """Accessor ``index`` as it is stored: (count, components), its own integer or float type, sparse applied."""
        entry = self.item("accessors", index, "accessor")
        try:
            dtype = np.dtype(_COMPONENT[entry["componentType"]])
            rows, columns = _SHAPE[entry["type"]]
            count = int(entry["count"])
        except KeyError as error:
            raise InputError(
                problem(self.path, f"accessor {index}", f"no or unknown {error}", "glTF 2.0 types")
            ) from error
        # Matrix columns start on multiples of four bytes.
        column_bytes = rows * dtype.itemsize if columns == 1 else -(-rows * dtype.itemsize // 4) * 4
        element_bytes = column_bytes * columns
        if "bufferView" in entry:
            where = f"accessor {index}"
            flat = self._gather(where, entry["bufferView"], entry.get("byteOffset", 0), count, element_bytes)
        else:
            flat = np.zeros((count, element_bytes), np.uint8)
        cells = flat.reshape(count, columns, column_bytes)[:, :, : rows * dtype.itemsize]
        values = np.ascontiguousarray(cells).view(dtype).reshape(count, rows * columns)
        if "sparse" in entry:
            values = self._apply_sparse(index, values.copy(), entry["sparse"])
        return values

    def array(self, index: int) -> np.ndarray:
        """Accessor ``index`` as numbers: (count, components) float64; normalised integers become [0, 1] or [-1, 1]."""
        entry = self.item("accessors", index, "accessor")
        values = self.raw(index)
        if not entry.get("normalized") or values.dtype.kind == "f":
            return values.astype(np.float64)
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)

    def _gather(self, where: str, view: int, offset: int, count: int, element_bytes: int) -> np.ndarray:
        data, stride = self.view_bytes(view)
        stride = stride or element_bytes
        need = offset + (stride * (count - 1) + element_bytes if count else 0)
        if offset < 0 or need > len(data) or stride < element_bytes:
            raise InputError(problem(self.path, where, f"needs {need} bytes", f"at most the view's {len(data)}"))
        if not count:
            return np.zeros((0, element_bytes), np.uint8)
        span = np.frombuffer(data, np.uint8)[offset:need]
        return np.lib.stride_tricks.as_strided(span, (count, element_bytes), (stride, 1), writeable=False)

    def _apply_sparse(self, index: int, values: np.ndarray, sparse: dict[str, Any]) -> np.ndarray:
        try:
            count, where, what = int(sparse["count"]), sparse["indices"], sparse["values"]
            kind = np.dtype(_COMPONENT[where["componentType"]])
            views = where["bufferView"], what["bufferView"]
        except KeyError as error:
            raise InputError(
                problem(self.path, f"accessor {index} sparse", f"no {error}", "indices and values")
            ) from error
        name = f"accessor {index} sparse"
        rows = self._gather(name, views[0], where.get("byteOffset", 0), count, kind.itemsize).copy().view(kind)[:, 0]
        size = values.dtype.itemsize * values.shape[1]
        new = self._gather(name, views[1], what.get("byteOffset", 0), count, size).copy().view(values.dtype)
        if rows.size and int(rows.max()) >= len(values):
            raise InputError(problem(self.path, f"{name} index", int(rows.max()), f"below {len(values)}"))
        values[rows] = new
        return values


def refuse_extensions(document: Document, used: object) -> None:
    """Raise InputError, in words, where ``used`` names an extension of `REFUSED`."""
    for name in used if isinstance(used, (list, dict)) else ():
        if name in REFUSED:
            wanted = f"uncompressed data (re-export without {name})"
            raise InputError(problem(document.path, "extension", REFUSED[name], wanted))


def open_document(path: Path) -> Document:
    """Read a .gltf or .glb file; InputError for anything that is not glTF 2.0 or needs what we cannot unpack."""
    data = path.read_bytes()
    chunk: bytes | None = None
    text = data
    if data[:4] == b"glTF":
        text, chunk = _split_glb(path, data)
    try:
        tree = json.loads(text)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(problem(path, "not a glTF file", str(error).replace("\n", " "), "JSON or a GLB")) from error
    version = str(tree.get("asset", {}).get("version", "none")) if isinstance(tree, dict) else "none"
    if not version.startswith("2."):
        raise InputError(problem(path, "glTF version", version, "2.0"))
    document = Document(path, tree, chunk)
    document.digest.update(data)
    refuse_extensions(document, tree.get("extensionsRequired", []))
    unknown = sorted(set(tree.get("extensionsRequired", [])) - READ)
    if unknown:
        raise InputError(problem(path, "required extension", ", ".join(unknown), f"one of {', '.join(sorted(READ))}"))
    ignored = sorted(set(tree.get("extensionsUsed", [])) - READ - set(REFUSED))
    if ignored:
        document.note(f"{path.name}: extensions not used: {', '.join(ignored)}")
    return document


def _split_glb(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    if len(data) < 20:
        raise InputError(problem(path, "broken GLB", f"{len(data)} bytes", "a header and a JSON chunk"))
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(problem(path, "GLB version", version, 2))
    if length > len(data):
        raise InputError(problem(path, "broken GLB", f"{len(data)} bytes", f"{length} as its header says"))
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > len(data):
            raise InputError(
                problem(path, "broken GLB", f"a chunk of {size} bytes at {at}", f"at most {len(data) - at - 8}")
            )
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size + (-size) % 4
    if 0x4E4F534A not in chunks:
        raise InputError(problem(path, "broken GLB", "no JSON chunk", "one"))
    return chunks[0x4E4F534A], chunks.get(0x004E4942)
