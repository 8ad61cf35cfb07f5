"""Frames from other renderers: right light from any coding, and nothing taken that is not what it says."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from stimuli.clip import ClipStore
from stimuli.encode import encode, srgb_from_linear
from stimuli.errors import InputError
from stimuli.exr import write_exr
from stimuli.import_frames import Import, find_ffmpeg, frame_files, import_frames
from stimuli.play_cache import PlayCache
from stimuli.png import read_png

ABOUT = Import("240", "ours", "kitchen", "srgb")


@pytest.fixture
def store(tmp_path) -> ClipStore:
    return ClipStore(tmp_path / "store")


def codes(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def png_frames(folder, count: int = 3):
    folder.mkdir()
    for index in range(count):
        Image.fromarray(codes(index)).save(folder / f"frame_{index + 8:04d}.png")
    return folder


def test_srgb_png_comes_back_as_the_same_codes(store, tmp_path):
    clip = import_frames(png_frames(tmp_path / "in"), ABOUT, store)
    assert clip.manifest["provenance"] == "external"
    assert clip.request.technique == "imported:ours"
    assert (clip.request.size_px, Fraction(clip.request.rate_hz), clip.frame_count) == ((7, 5), 240, 3)
    source = PlayCache(store).played(clip)
    for index in range(3):
        np.testing.assert_array_equal(source.frame(index)[..., :3], codes(index))
    assert store.problems_of(clip.identity) == []


def test_same_frames_are_the_same_clip_and_other_frames_or_codings_are_not(store, tmp_path):
    folder = png_frames(tmp_path / "in")
    first = import_frames(folder, ABOUT, store)
    assert import_frames(folder, ABOUT, store).identity == first.identity
    others = [replace(ABOUT, transfer="linear"), replace(ABOUT, rate_hz="120"), replace(ABOUT, exposure=2.0)]
    identities = {import_frames(folder, about, store).identity for about in others}
    Image.fromarray(codes(9)).save(folder / "frame_0009.png")
    identities.add(import_frames(folder, ABOUT, store).identity)
    assert len(identities | {first.identity}) == 5


def test_linear_exr_and_pq_are_decoded(store, tmp_path):
    (tmp_path / "exr").mkdir()
    light = np.random.default_rng(0).random((4, 6, 3)).astype(np.float32) * 50
    write_exr(tmp_path / "exr" / "1.exr", light)
    clip = import_frames(tmp_path / "exr", replace(ABOUT, transfer="linear"), store)
    np.testing.assert_array_equal(clip.frame(0).color, light.astype(np.float16))
    (tmp_path / "pq").mkdir()
    Image.fromarray(np.full((2, 2, 3), 130, np.uint8)).save(tmp_path / "pq" / "1.png")
    clip = import_frames(tmp_path / "pq", replace(ABOUT, transfer="pq"), store)
    # code 130 / 255 is 102 cd/m2 by SMPTE ST 2084; 1 is 100 cd/m2
    color = clip.frame(0).color
    assert color is not None
    assert float(color[0, 0, 0]) == pytest.approx(1.02, abs=0.01)


def png16(pixels: np.ndarray, filters: list[int]) -> bytes:
    """A 16-bit RGB or RGBA PNG with the given filter on each line, written from the specification."""
    height, width, channels = pixels.shape
    raw = pixels.astype(">u2").tobytes()
    step, stride = channels * 2, channels * 2 * width
    lines, above = b"", bytes(stride)
    for y in range(height):
        line = raw[y * stride : (y + 1) * stride]
        out = bytearray()
        for x in range(stride):
            left = line[x - step] if x >= step else 0
            corner = above[x - step] if x >= step else 0
            p = left + above[x] - corner
            near = min((abs(p - left), 0, left), (abs(p - above[x]), 1, above[x]), (abs(p - corner), 2, corner))[2]
            guess = [0, left, above[x], (left + above[x]) // 2, near][filters[y]]
            out.append((line[x] - guess) & 255)
        lines += bytes([filters[y]]) + bytes(out)
        above = line

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 16, 2 if channels == 3 else 6, 0, 0, 0)
    packed = zlib.compress(lines)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", packed[:10]) + chunk(b"IDAT", packed[10:]) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.mark.parametrize("channels", [3, 4])
def test_16_bit_colour_png_keeps_all_its_bits(tmp_path, channels):
    pixels = np.random.default_rng(1).integers(0, 65536, (10, 9, channels)).astype(np.uint16)
    pixels[..., 3:] = 65535
    (tmp_path / "a.png").write_bytes(png16(pixels, [0, 1, 2, 3, 4, 4, 3, 2, 1, 0]))
    np.testing.assert_array_equal(read_png(tmp_path / "a.png") * 65535, pixels[..., :3])


def test_grey_and_palette_png_are_read(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(np.rint(read_png(tmp_path / "grey.png") * 255), np.repeat(grey[..., None], 3, axis=2))
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    np.testing.assert_allclose(read_png(tmp_path / "deep.png")[..., 0], grey / 255)
    Image.fromarray(codes(1)).quantize(16).save(tmp_path / "palette.png")
    assert read_png(tmp_path / "palette.png").shape == (5, 7, 3)


REFUSED = {
    "an empty folder": (lambda d: None, "no pictures"),
    "a gap": (lambda d: [Image.fromarray(codes(k)).save(d / f"{k}.png") for k in (1, 2, 4)], "no frame 3"),
    "a number twice": (
        lambda d: [Image.fromarray(codes(1)).save(d / n) for n in ("a1.png", "b1.png")],
        "each number once",
    ),
    "no number": (lambda d: Image.fromarray(codes(1)).save(d / "a.png"), "a number in it"),
    "two types": (
        lambda d: (Image.fromarray(codes(1)).save(d / "1.png"), write_exr(d / "2.exr", np.ones((5, 7, 3)))),
        "PNG or EXR files only",
    ),
    "another size": (
        lambda d: (Image.fromarray(codes(1)).save(d / "1.png"), Image.fromarray(codes(1)[:4]).save(d / "2.png")),
        "7x4",
    ),
    "alpha": (lambda d: Image.fromarray(np.full((2, 2, 4), 128, np.uint8)).save(d / "1.png"), "alpha"),
    "a JPEG called PNG": (lambda d: Image.fromarray(codes(1)).save(d / "1.png", format="JPEG"), "JPEG"),
    "junk": (lambda d: (d / "1.png").write_bytes(b"junk"), "unreadable"),
    "a PNG cut short": (
        lambda d: (
            Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)).save(d / "1.png"),
            (d / "1.png").write_bytes((d / "1.png").read_bytes()[:2000]),
        ),
        "unreadable",
    ),
    "nan": (lambda d: write_exr(d / "1.exr", np.full((2, 2, 3), np.nan, np.float32)), "finite"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_taken_as_it_is_is_refused_in_one_line(store, tmp_path, case):
    make, text = REFUSED[case]
    (tmp_path / "in").mkdir()
    make(tmp_path / "in")
    with pytest.raises(InputError, match=text) as refusal:
        import_frames(tmp_path / "in", ABOUT, store)
    assert len(refusal.value.problems) == 1
    assert "\n" not in refusal.value.problems[0]
    assert store.identities() == []


@pytest.mark.parametrize(
    ("change", "text"),
    [({"rate_hz": "0"}, "above 0"), ({"rate_hz": "fast"}, "rate"), ({"exposure": 0.0}, "exposure"),
     ({"transfer": "log"}, "srgb")],
)  # fmt: skip
def test_wrong_facts_are_refused(store, tmp_path, change, text):
    with pytest.raises(InputError, match=text):
        import_frames(png_frames(tmp_path / "in"), replace(ABOUT, **change), store)


def test_nothing_there_is_said(store, tmp_path):
    with pytest.raises(InputError, match="nothing there"):
        import_frames(tmp_path / "none", ABOUT, store)
    assert frame_files(png_frames(tmp_path / "in", 1)) == (tmp_path / "in" / "frame_0008.png",)


def test_video_without_a_decoder_is_refused_with_what_to_install(store, tmp_path, monkeypatch):
    monkeypatch.setattr("stimuli.import_frames.find_ffmpeg", lambda: None)
    (tmp_path / "a.mkv").write_bytes(b"")
    with pytest.raises(InputError, match="ffmpeg on the path"):
        import_frames(tmp_path / "a.mkv", ABOUT, store)


@pytest.mark.skipif(find_ffmpeg() is None, reason="no ffmpeg on this machine")
def test_lossless_video_is_read_bit_for_bit_and_lossy_is_refused(store, tmp_path):
    import subprocess

    folder = png_frames(tmp_path / "in")
    common = [
        find_ffmpeg(),
        "-v",
        "error",
        "-framerate",
        "240",
        "-start_number",
        "8",
        "-i",
        str(folder / "frame_%04d.png"),
    ]
    for codec in (["-c:v", "ffv1", "-pix_fmt", "gbrp"], ["-c:v", "rawvideo", "-pix_fmt", "bgr24"]):
        target = tmp_path / f"{codec[1]}.avi"
        subprocess.run([*common, *codec, str(target)], check=True)
        clip = import_frames(target, ABOUT, store)
        for index in range(3):
            np.testing.assert_array_equal(encode(np.asarray(clip.frame(index).color))[..., :3], codes(index))
    subprocess.run([*common, "-c:v", "mpeg4", str(tmp_path / "lossy.mkv")], check=True)
    with pytest.raises(InputError, match="lossless codec"):
        import_frames(tmp_path / "lossy.mkv", ABOUT, store)
    (tmp_path / "junk.mkv").write_bytes(b"junk")
    with pytest.raises(InputError, match="no readable video"):
        import_frames(tmp_path / "junk.mkv", ABOUT, store)


def test_srgb_values_survive_half_storage_in_every_code(store, tmp_path):
    (tmp_path / "in").mkdir()
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    Image.fromarray(ramp).save(tmp_path / "in" / "0.png")
    clip = import_frames(tmp_path / "in", ABOUT, store)
    color = clip.frame(0).color
    assert color is not None
    np.testing.assert_allclose(srgb_from_linear(color.astype(np.float64)) * 255, ramp, atol=0.2)
    np.testing.assert_array_equal(encode(color)[..., :3], ramp)
