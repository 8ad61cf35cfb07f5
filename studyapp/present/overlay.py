"""Words, crosses and the light patch as RGBA8 pictures, in any script that an installed font covers.

Letters have their size in degrees of visual angle: the x-height is ``x_height_deg`` where the text fits, and never
less than 0.3 degrees.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import atan2, degrees, radians, tan
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from protocols.trial import Question
from renderers.technique import ViewGeometry
from stimuli.errors import InputError, problem

SMALLEST_X_HEIGHT_DEG = 0.3
LINE_LETTERS = 66
FONT_FOLDERS = ("/usr/share/fonts", "/usr/local/share/fonts", "~/.fonts", "/Library/Fonts", "C:/Windows/Fonts")
DEFAULT_FONTS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "LiberationSans-Regular.ttf", "Arial.ttf", "arial.ttf")
NOT_DRAWN = frozenset("\n\r\t \u00a0\u200b\u200c\u200d\u200e\u200f\u2060\ufe0e\ufe0f\u00ad")


@dataclass(frozen=True)
class Style:
    """How words look. Grey levels are display codes (0 to 255); ``font`` is a file or a file name in a font folder."""

    background: int = 119
    ink: int = 235
    dim: int = 190
    font: str | None = None
    x_height_deg: float = 0.4
    margin: float = 0.06
    cross_deg: float = 0.6
    patch_deg: float = 1.0
    patch_corner: str = "lower_left"


def style_on(background: int, patch_corner: str = "lower_left") -> Style:
    """The style for a background of this display code: light letters on the dark half, dark ones on the bright half."""
    if background <= 128:
        return Style(background=background, patch_corner=patch_corner)
    return Style(background=background, ink=16, dim=60, patch_corner=patch_corner)


def pixels_per_degree(display_px: tuple[int, int], geometry: ViewGeometry) -> float:
    """Pixels that one degree at the screen's centre spans (the smaller of the two axes)."""
    across = display_px[0] / geometry.width_m * geometry.distance_m * 2 * tan(radians(0.5))
    along = display_px[1] / geometry.height_m * geometry.distance_m * 2 * tan(radians(0.5))
    return min(across, along)


def size_deg(size_px: float, display_px: tuple[int, int], geometry: ViewGeometry) -> float:
    """The visual angle of a length at the screen's centre."""
    return 2 * degrees(atan2(size_px * geometry.height_m / display_px[1] / 2, geometry.distance_m))


@lru_cache(maxsize=1)
def installed_fonts() -> tuple[Path, ...]:
    """Every TrueType and OpenType file in the usual folders, by name."""
    found = []
    for folder in FONT_FOLDERS:
        root = Path(folder).expanduser()
        if root.is_dir():
            found += [p for p in root.rglob("*") if p.suffix.lower() in (".ttf", ".otf", ".ttc")]
    return tuple(sorted(found))


def uncovered(path: Path, text: str) -> str:
    """The characters of ``text`` that the font at ``path`` has no glyph for, each once, in order."""
    font = ImageFont.truetype(str(path), 24)
    # A character that Unicode never assigns is drawn as the font's 'missing' glyph.
    absent = _glyph(font, "\U0010fffe")
    missing = dict.fromkeys(c for c in text if c not in NOT_DRAWN and _glyph(font, c) == absent)
    return "".join(missing)


def _glyph(font: ImageFont.FreeTypeFont, character: str) -> tuple[tuple[int, int], bytes, float]:
    mask = font.getmask(character)
    return mask.size, bytes(mask), font.getlength(character)


def find_font(text: str, preferred: str | None = None) -> Path:
    """The preferred font, or the first installed one that covers every character of ``text``.

    Raises InputError where ``preferred`` does not exist or where no font covers the text (naming the characters).
    """
    return _find_font("".join(sorted(set(text))), preferred)


@lru_cache(maxsize=256)
def _find_font(characters: str, preferred: str | None) -> Path:
    fonts = installed_fonts()
    ranked: list[Path] = []
    if preferred is not None:
        named = [Path(preferred)] if Path(preferred).is_file() else [p for p in fonts if p.name == preferred]
        if not named:
            raise InputError(problem("font", "file", preferred, "a font file, or the name of one that is installed"))
        ranked += named
    ranked += [p for name in DEFAULT_FONTS for p in fonts if p.name == name]
    if not ranked and not fonts:
        raise InputError(problem("font", "installed fonts", "none", "fonts-dejavu-core, fonts-noto or any other"))
    fewest = characters
    for path in [*ranked, *_by_fontconfig(characters), *fonts]:
        missing = uncovered(path, characters)
        if not missing:
            return path
        fewest = min(fewest, missing, key=len)
    raise InputError(problem("font", "characters that no installed font has", repr(fewest), "a font that covers them"))


def _by_fontconfig(characters: str) -> list[Path]:
    """Fonts that the system says cover the rarest (highest) character; none where fontconfig is not installed."""
    if not characters:
        return []
    try:
        listed = subprocess.run(
            ["fc-list", f":charset={ord(max(characters)):x}", "file"], capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return []
    return [Path(line.rstrip().rstrip(":")) for line in listed.stdout.splitlines() if line.strip()]


def x_height_font(path: Path, x_height_px: float) -> ImageFont.FreeTypeFont:
    """The font at the size whose letter x is at least ``x_height_px`` high."""
    probe = ImageFont.truetype(str(path), 200)
    top, bottom = probe.getbbox("x")[1], probe.getbbox("x")[3]
    size = max(4, int(np.ceil(x_height_px * 200 / max(1, bottom - top))))
    while True:
        font = ImageFont.truetype(str(path), size)
        box = font.getbbox("x")
        if box[3] - box[1] >= x_height_px:
            return font
        size += 1


def wrap(text: str, font: ImageFont.FreeTypeFont, width_px: int) -> list[str]:
    """Lines no wider than ``width_px``: broken at spaces; a word wider than a line is broken within."""
    lines: list[str] = []
    for paragraph in text.split("\n"):
        line = ""
        for word in paragraph.split(" "):
            candidate = f"{line} {word}" if line else word
            if font.getlength(candidate) <= width_px:
                line = candidate
                continue
            if line:
                lines.append(line)
            line = word
            while font.getlength(line) > width_px and len(line) > 1:
                fits = max(1, _longest_prefix(line, font, width_px))
                lines.append(line[:fits])
                line = line[fits:]
        lines.append(line)
    return lines


def _longest_prefix(text: str, font: ImageFont.FreeTypeFont, width_px: int) -> int:
    low, high = 1, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if font.getlength(text[:middle]) <= width_px:
            low = middle
        else:
            high = middle - 1
    return low


@dataclass(frozen=True)
class Words:
    """A picture of words: (h, w, 4) uint8, where its top left belongs, and the x-height it was set in."""

    picture: np.ndarray
    x_px: int
    y_px: int
    x_height_px: float


Painter = Callable[[ImageFont.FreeTypeFont, int], Image.Image | None]
"""Font and width to a picture, None where it cannot be set in that width."""


def _fit(
    text: str,
    paint: Painter,
    box_px: tuple[int, int, int, int],
    display_px: tuple[int, int],
    geometry: ViewGeometry,
    style: Style,
) -> Words:
    """Set at the style's size, or smaller down to 0.3 degrees, until it stands in ``box_px`` (x, y, width, height)."""
    path = find_font(text + "x", style.font)
    ppd = pixels_per_degree(display_px, geometry)
    x, y, width, height = box_px
    wanted_deg = max(style.x_height_deg, SMALLEST_X_HEIGHT_DEG)
    for share in np.linspace(1.0, 0.0, 9):
        x_height = ppd * (SMALLEST_X_HEIGHT_DEG + float(share) * (wanted_deg - SMALLEST_X_HEIGHT_DEG))
        picture = paint(x_height_font(path, x_height), width)
        if picture is not None and picture.width <= width and picture.height <= height:
            left, top = x + (width - picture.width) // 2, y + (height - picture.height) // 2
            return Words(np.asarray(picture, np.uint8), left, top, x_height)
    short = text if len(text) <= 40 else text[:37] + "..."
    wanted = f"fewer words, or a larger screen: letters are at least {SMALLEST_X_HEIGHT_DEG} degrees high"
    raise InputError(problem("words", f"too long for {width}x{height} px", repr(short), wanted))


def paint_words(
    text: str,
    display_px: tuple[int, int],
    geometry: ViewGeometry,
    style: Style,
    box_px: tuple[int, int, int, int] | None = None,
) -> Words:
    """Centred lines in the middle of the display (or of ``box_px``)."""
    box = box_px if box_px is not None else _inner(display_px, style)

    def paint(font: ImageFont.FreeTypeFont, width: int) -> Image.Image:
        return _lines(wrap(text, font, _measure(font, width)), font, style.ink)

    return _fit(text, paint, box, display_px, geometry, style)


def paint_question(question: Question, display_px: tuple[int, int], geometry: ViewGeometry, style: Style) -> Words:
    """The question, its answers and the keys that give them; a Likert scale as a ruler with its labels."""
    key_of = {answer: key for key, answer in question.keys.items()}
    if question.kind == "likert":
        answers = [str(value) for value in range(question.low, question.high + 1)]
        if list(question.keys.values()) != answers and list(question.keys.values()) == answers[::-1]:
            answers = answers[::-1]  # the scale's direction is counterbalanced with its keys
    else:
        answers = list(question.options) or list(question.keys.values())
    keys = [key_of.get(answer, answer) for answer in answers]
    plain = ["" if key == answer else _plain(question, answer) for key, answer in zip(keys, answers, strict=True)]
    cells = [(key, question.labels.get(answer, word)) for key, answer, word in zip(keys, answers, plain, strict=True)]
    letters = question.text + "".join(key + label for key, label in cells)

    def paint(font: ImageFont.FreeTypeFont, width: int) -> Image.Image | None:
        head = _lines(wrap(question.text, font, _measure(font, width)), font, style.ink)
        if not cells:
            return head
        table = _cells(cells, font, width, style)
        if table is None:
            return None
        gap = _line_height(font)
        whole = Image.new(
            "RGBA", (max(head.width, table.width), head.height + gap + table.height), (style.ink,) * 3 + (0,)
        )
        whole.paste(head, ((whole.width - head.width) // 2, 0))
        whole.paste(table, ((whole.width - table.width) // 2, head.height + gap))
        return whole

    return _fit(letters, paint, _inner(display_px, style), display_px, geometry, style)


def _plain(question: Question, answer: str) -> str:
    return "" if question.kind == "likert" else answer.replace("_", " ")


def _inner(display_px: tuple[int, int], style: Style) -> tuple[int, int, int, int]:
    margin_x, margin_y = round(display_px[0] * style.margin), round(display_px[1] * style.margin)
    return margin_x, margin_y, display_px[0] - 2 * margin_x, display_px[1] - 2 * margin_y


def _measure(font: ImageFont.FreeTypeFont, width_px: int) -> int:
    """Width of a line: what `_lines` has room for, and no more letters than the eye follows easily."""
    return max(1, min(width_px - 2 * _pad(font) - 1, round(LINE_LETTERS * font.getlength("n"))))


def _pad(font: ImageFont.FreeTypeFont) -> int:
    return _line_height(font) // 4


def _line_height(font: ImageFont.FreeTypeFont) -> int:
    ascent, descent = font.getmetrics()
    return round(1.2 * (ascent + descent))


def _lines(lines: Sequence[str], font: ImageFont.FreeTypeFont, level: int) -> Image.Image:
    """Centred lines on nothing; the picture holds every glyph whole, overhangs too."""
    pad = _pad(font)
    widths = [font.getlength(line) for line in lines]
    high = _line_height(font)
    image = Image.new(
        "RGBA", (int(max(widths, default=0)) + 2 * pad + 1, high * max(1, len(lines)) + pad), (level, level, level, 0)
    )
    draw = ImageDraw.Draw(image)
    for row, (line, width) in enumerate(zip(lines, widths, strict=True)):
        draw.text(((image.width - width) / 2, row * high), line, font=font, fill=(level, level, level, 255))
    return image


def _cells(
    cells: Sequence[tuple[str, str]], font: ImageFont.FreeTypeFont, width: int, style: Style
) -> Image.Image | None:
    """Answers side by side, key above label; below one another where labels are too wide; None if neither fits."""
    column = width // len(cells)
    labels = [wrap(label, font, int(0.92 * column)) if label else [] for _, label in cells]
    whole_words = all(
        set(" ".join(lines).split()) == set(label.split()) for lines, (_, label) in zip(labels, cells, strict=True)
    )
    if whole_words and column >= 2 * font.getlength("M"):
        return _columns([key for key, _ in cells], labels, font, column, style)
    rows = [line for key, label in cells for line in wrap(f"{key}   {label}".rstrip(), font, _measure(font, width))]
    return _lines(rows, font, style.ink)


def _columns(
    keys: Sequence[str], labels: Sequence[Sequence[str]], font: ImageFont.FreeTypeFont, column: int, style: Style
) -> Image.Image:
    high = _line_height(font)
    rows = max((len(lines) for lines in labels), default=0)
    image = Image.new("RGBA", (column * len(keys), 2 * high + rows * high), (style.ink,) * 3 + (0,))
    draw = ImageDraw.Draw(image)
    for place, (key, lines) in enumerate(zip(keys, labels, strict=True)):
        middle = column * place + column / 2
        width = font.getlength(key)
        pad = high // 4
        box = (middle - width / 2 - pad, 2, middle + width / 2 + pad, high + pad)
        draw.rounded_rectangle(box, radius=pad, outline=(style.dim,) * 3 + (255,), width=max(1, high // 16))
        draw.text((middle, (high + pad + 2) / 2), key, font=font, fill=(style.ink,) * 3 + (255,), anchor="mm")
        for row, line in enumerate(lines):
            at = (middle - font.getlength(line) / 2, (row + 1.5) * high)
            draw.text(at, line, font=font, fill=(style.ink,) * 3 + (255,))
    return image


def paint_cross(display_px: tuple[int, int], geometry: ViewGeometry, style: Style) -> np.ndarray:
    """(s, s, 4) fixation cross: bars of a tenth of its size, transparent elsewhere; s is odd."""
    size = 2 * max(2, round(style.cross_deg * pixels_per_degree(display_px, geometry) / 2)) + 1
    half = max(0, round(size / 20))
    picture = np.zeros((size, size, 4), np.uint8)
    middle = size // 2
    picture[middle - half : middle + half + 1] = picture[:, middle - half : middle + half + 1] = (style.ink,) * 3 + (
        255,
    )
    return picture
