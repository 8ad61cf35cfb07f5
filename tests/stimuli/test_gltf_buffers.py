"""Accessors decode as glTF 2.0 says: every component type, strides, normalisation, sparse values, matrices."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stimuli.errors import InputError
from stimuli.gltf_buffers import open_document
from tests.stimuli.tiny_glb import CODES, TinyGlb

SETTINGS = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FORMATS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "u4": "I", "f4": "f"}


@SETTINGS
@given(
    code=st.sampled_from(sorted(CODES)),
    width=st.integers(1, 4),
    count=st.integers(0, 9),
    gap=st.sampled_from([0, 4, 12]),
    offset=st.sampled_from([0, 4, 8]),
    seed=st.integers(0, 2**31),
)
def test_accessor_of_any_type_stride_and_offset_decodes_to_what_was_packed(
    tmp_path: Path, code: str, width: int, count: int, gap: int, offset: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    if code == "f4":
        values = rng.normal(size=(count, width)).astype(np.float32)
    else:
        info = np.iinfo(np.dtype(code))
        values = rng.integers(info.min, info.max, (count, width), endpoint=True, dtype=np.int64)
    # struct, not numpy, lays the bytes out.
    element = struct.calcsize(f"<{width}{FORMATS[code]}")
    stride = element + gap + (-(element + gap) % 4)
    body = b"\xaa" * offset
    for row in values:
        body += struct.pack(f"<{width}{FORMATS[code]}", *row.tolist()) + b"\xbb" * (stride - element)
    glb = TinyGlb()
    view = glb.view(body or b"\0", stride)
    kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
    glb.json["accessors"].append(
        {"bufferView": view, "byteOffset": offset, "componentType": CODES[code], "count": count, "type": kinds[width]}
    )
    document = open_document(glb.write(tmp_path))
    assert np.array_equal(document.array(0), values.astype(np.float64).reshape(count, width))


@pytest.mark.parametrize(
    ("code", "stored", "wanted"),
    [
        ("u1", [0, 51, 255], [0.0, 0.2, 1.0]),
        ("i1", [-128, -127, 0, 127], [-1.0, -1.0, 0.0, 1.0]),
        ("u2", [0, 13107, 65535], [0.0, 0.2, 1.0]),
        ("i2", [-32768, -32767, 32767], [-1.0, -1.0, 1.0]),
    ],
)
def test_normalised_integers_become_fractions(
    tmp_path: Path, code: str, stored: list[int], wanted: list[float]
) -> None:
    glb = TinyGlb()
    glb.accessor(np.array(stored), code, normalized=True)
    assert np.allclose(open_document(glb.write(tmp_path)).array(0)[:, 0], wanted, atol=1e-12)


def test_sparse_values_replace_the_dense_ones_and_zeros_stand_where_there_is_no_view(tmp_path: Path) -> None:
    glb = TinyGlb()
    rows, new = glb.view(struct.pack("<2H", 1, 3)), glb.view(struct.pack("<6f", 1, 2, 3, 4, 5, 6))
    sparse = {
        "count": 2,
        "indices": {"bufferView": rows, "componentType": 5123},
        "values": {"bufferView": new},
    }
    glb.json["accessors"].append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    glb.accessor(np.ones((4, 3)), sparse=sparse)
    document = open_document(glb.write(tmp_path))
    assert document.array(0).tolist() == [[0, 0, 0], [1, 2, 3], [0, 0, 0], [4, 5, 6]]
    assert document.array(1).tolist() == [[1, 1, 1], [1, 2, 3], [1, 1, 1], [4, 5, 6]]


def test_small_matrices_skip_the_padding_of_their_columns(tmp_path: Path) -> None:
    glb = TinyGlb()
    # MAT3 of bytes: three columns of three bytes, each padded to four.
    view = glb.view(bytes([1, 2, 3, 99, 4, 5, 6, 99, 7, 8, 9, 99]))
    glb.json["accessors"].append({"bufferView": view, "componentType": 5121, "count": 1, "type": "MAT3"})
    assert open_document(glb.write(tmp_path)).array(0).tolist() == [[1, 2, 3, 4, 5, 6, 7, 8, 9]]


def test_data_uris_and_files_beside_are_read_and_hashed(tmp_path: Path) -> None:
    data = struct.pack("<3f", 1.0, 2.0, 3.0)
    (tmp_path / "two words.bin").write_bytes(data)
    digests = []
    for uri in ("data:application/octet-stream;base64," + base64.b64encode(data).decode(), "two%20words.bin"):
        tree = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 12, "uri": uri}],
            "bufferViews": [{"buffer": 0, "byteLength": 12}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "SCALAR"}],
        }
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        document = open_document(tmp_path / "a.gltf")
        assert document.array(0)[:, 0].tolist() == [1.0, 2.0, 3.0]
        digests.append(document.digest.hexdigest())
    (tmp_path / "two words.bin").write_bytes(struct.pack("<3f", 1.0, 2.0, 4.0))
    changed = open_document(tmp_path / "a.gltf")
    changed.array(0)
    assert changed.digest.hexdigest() != digests[1]


@pytest.mark.parametrize("extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"])
def test_compression_we_cannot_unpack_is_refused_by_name(tmp_path: Path, extension: str) -> None:
    glb = TinyGlb()
    glb.json["extensionsRequired"] = [extension]
    with pytest.raises(InputError, match=f"without {extension}"):
        open_document(glb.write(tmp_path))


def test_an_accessor_that_runs_past_its_view_is_an_error(tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.accessor(np.zeros((3, 3)))
    glb.json["accessors"][0]["count"] = 4
    document = open_document(glb.write(tmp_path))
    with pytest.raises(InputError, match="accessor 0: got needs 48 bytes, wanted at most the view's 36"):
        document.array(0)
