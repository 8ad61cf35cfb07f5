"""OpenEXR files: values, types and channel names, read back by us and by Mitsuba's own reader."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from stimuli.errors import InputError
from stimuli.exr import COMPRESSIONS, REC709_CHROMATICITIES, read_exr, to_half, write_exr


def picture(width: int = 7, height: int = 5) -> np.ndarray:
    return np.random.default_rng(3).random((height, width, 3)).astype(np.float32) * 10


def channels(width: int = 7, height: int = 5) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    return {
        "Z": rng.random((height, width)).astype(np.float32) * 1e5,
        "motion.X": rng.normal(0, 3, (height, width)).astype(np.float32),
        "motion.Y": rng.normal(0, 3, (height, width)).astype(np.float32),
        "samples": rng.integers(0, 2**32, (height, width), dtype=np.uint64).astype(np.uint32),
        "class": np.arange(height * width, dtype=np.uint32).reshape(height, width),
    }


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_values_types_and_attributes_survive_every_lossless_compression(tmp_path, compression):
    color, extra = picture(), channels()
    attributes = {"params": {"spp": 4}, "time_s": 0.25, "technique": "reference"}
    write_exr(tmp_path / "a.exr", color, extra, attributes, compression)
    back = read_exr(tmp_path / "a.exr")
    assert back.color is not None
    assert back.color.dtype == np.float16
    np.testing.assert_array_equal(back.color, color.astype(np.float16))
    assert set(back.channels) == set(extra)
    assert back.channels["Z"].dtype == np.float32
    np.testing.assert_array_equal(back.channels["Z"], extra["Z"])
    assert back.channels["samples"].dtype == np.uint32
    np.testing.assert_array_equal(back.channels["samples"], extra["samples"])
    np.testing.assert_array_equal(back.channels["motion.X"], extra["motion.X"].astype(np.float16))
    assert back.attributes == attributes


READ_WITH_MITSUBA = """
import sys, mitsuba, numpy as np
mitsuba.set_variant("scalar_rgb")
found = {}
for layer, part in mitsuba.Bitmap(sys.argv[1]).split():
    values = np.array(part)
    for i, field in enumerate(part.struct_()):
        found[field.name if layer == "<root>" else f"{layer}.{field.name}"] = np.atleast_3d(values)[..., i]
np.savez(sys.argv[2], **found)
"""


def test_another_reader_sees_the_same_names_and_values(tmp_path):
    color, extra = picture(), channels()
    extra["samples"] %= 100  # that reader makes every channel half: small whole numbers stay exact
    extra["Z"] /= 10
    write_exr(tmp_path / "a.exr", color, extra, {"technique": "vanilla"})
    # in a child: Mitsuba's variant is global to a process
    command = [sys.executable, "-c", READ_WITH_MITSUBA, str(tmp_path / "a.exr"), str(tmp_path / "a.npz")]
    subprocess.run(command, check=True, capture_output=True)
    found = np.load(tmp_path / "a.npz")
    assert set(found.files) == {"R", "G", "B", *extra}
    for i, name in enumerate("RGB"):
        np.testing.assert_array_equal(found[name], color[..., i].astype(np.float16).astype(np.float32))
    np.testing.assert_array_equal(found["class"], extra["class"])
    np.testing.assert_array_equal(found["samples"], extra["samples"])
    np.testing.assert_allclose(found["Z"], extra["Z"], rtol=2**-11)
    np.testing.assert_array_equal(found["motion.X"], extra["motion.X"].astype(np.float16).astype(np.float32))


def test_header_holds_rec709_chromaticities(tmp_path):
    import OpenEXR

    write_exr(tmp_path / "a.exr", picture())
    np.testing.assert_allclose(OpenEXR.File(str(tmp_path / "a.exr")).header()["chromaticities"], REC709_CHROMATICITIES)


def test_same_picture_gives_same_bytes(tmp_path):
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, picture(), channels(), {"b": 1, "a": [1, 2]})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (33, 17)])
def test_any_size_is_stored(tmp_path, size):
    write_exr(tmp_path / "a.exr", picture(*size))
    back = read_exr(tmp_path / "a.exr").color
    assert back is not None
    assert back.shape == (size[1], size[0], 3)


def test_extremes_are_held_in_half_range():
    values = np.array([0.0, 1e-9, 65504.0, 65519.0, 1e9, np.inf, -np.inf, np.nan, 6e-8], np.float32)
    half = to_half(values)
    assert half[:5].tolist() == [0.0, 0.0, 65504.0, 65504.0, 65504.0]
    assert half[5] == 65504.0
    assert half[6] == -65504.0
    assert np.isnan(half[7])
    assert half[8] == np.float16(6e-8) != 0


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 4), (0, 4, 3), (4, 0, 3)])
def test_wrong_shapes_are_refused(tmp_path, shape):
    with pytest.raises(InputError, match="picture shape"):
        write_exr(tmp_path / "a.exr", np.zeros(shape, np.float32))


def test_channel_of_another_size_is_refused(tmp_path):
    with pytest.raises(InputError, match="channel Z"):
        write_exr(tmp_path / "a.exr", picture(), {"Z": np.zeros((2, 2), np.float32)})


def test_damaged_and_missing_files_are_named(tmp_path):
    with pytest.raises(InputError, match="wanted a file"):
        read_exr(tmp_path / "none.exr")
    (tmp_path / "junk.exr").write_bytes(b"not an image at all")
    with pytest.raises(InputError, match=r"junk\.exr"):
        read_exr(tmp_path / "junk.exr")
    write_exr(tmp_path / "a.exr", picture(64, 64))
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.exr"):
        read_exr(tmp_path / "cut.exr")


def test_file_without_rgb_has_no_color(tmp_path):
    import OpenEXR

    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": np.ones((2, 3), np.float32)}).write(str(tmp_path / "y.exr"))
    back = read_exr(tmp_path / "y.exr")
    assert back.color is None
    assert back.channels["Y"].shape == (2, 3)
