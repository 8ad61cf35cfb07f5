"""Words can be read: large enough, whole, in any script that a font covers."""

from __future__ import annotations

import numpy as np
import pytest

from protocols.trial import Question
from renderers.technique import ViewGeometry
from stimuli.errors import InputError
from studyapp.present.overlay import (
    SMALLEST_X_HEIGHT_DEG,
    Style,
    find_font,
    paint_cross,
    paint_question,
    paint_words,
    pixels_per_degree,
    size_deg,
    uncovered,
    wrap,
    x_height_font,
)
from studyapp.present.presenter import DESK

SIZES = [(1280, 720), (3840, 2160)]
LIKERT = Question(
    "free", "The sequence was free of artifacts (flicker, noise, blur, jagged edges).", "likert",
    labels={"-3": "strongly disagree", "0": "neither", "3": "strongly agree"},
    keys={str(place + 1): str(value) for place, value in enumerate(range(-3, 4))},
)  # fmt: skip
CHOICE = Question(
    "q", "Which is closer to the middle one?", "choice", ("left", "right"), keys={"a": "left", "b": "right"}
)
WORDS = (
    "In each trial you will see three moving pictures. The one in the middle is the reference.\n\nPress the space bar."
)


def ink_is_whole(words, size_px: tuple[int, int]) -> None:
    """Nothing touches the picture's edge, and the picture stands on the display."""
    alpha = words.picture[..., 3]
    assert alpha.any()
    assert not alpha[0].any()
    assert not alpha[-1].any()
    assert not alpha[:, 0].any()
    assert not alpha[:, -1].any()
    height, width = alpha.shape
    assert words.x_px >= 0 <= words.y_px
    assert words.x_px + width <= size_px[0]
    assert words.y_px + height <= size_px[1]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("what", ["words", "choice", "likert", "long", "wrapped"])
def test_no_letter_is_clipped_or_smaller_than_the_limit(size: tuple[int, int], what: str) -> None:
    style = Style()
    if what in ("choice", "likert"):
        words = paint_question(CHOICE if what == "choice" else LIKERT, size, DESK, style)
    else:
        text = {"words": WORDS, "long": WORDS * 6, "wrapped": "W" * 400}[what]
        words = paint_words(text, size, DESK, style)
    ink_is_whole(words, size)
    assert size_deg(words.x_height_px, size, DESK) >= SMALLEST_X_HEIGHT_DEG
    path = find_font("x")
    box = x_height_font(path, words.x_height_px).getbbox("x")
    assert size_deg(box[3] - box[1], size, DESK) >= SMALLEST_X_HEIGHT_DEG


def test_letters_keep_their_angle_when_the_observer_moves_away() -> None:
    near, far = DESK, ViewGeometry(DESK.width_m, DESK.height_m, 2 * DESK.distance_m)
    sizes = [paint_words("Right", (3840, 2160), where, Style()).x_height_px for where in (near, far)]
    assert sizes[1] == pytest.approx(2 * sizes[0], rel=0.01)


def test_words_that_do_not_fit_are_refused_not_shrunk_below_the_limit() -> None:
    with pytest.raises(InputError, match=r"words: too long for .* letters are at least 0.3 degrees"):
        paint_words(WORDS * 40, (1280, 720), DESK, Style())
    with pytest.raises(InputError, match="too long"):
        paint_words("Right", (1280, 720), DESK, Style(), box_px=(0, 0, 40, 10))


@pytest.mark.parametrize(
    "text", ["", " ", "\n\n", "é", "Größe", "Συμμετοχή", "Добро", "مشاركة", "→ ✓", "a\u0301\u200d"]
)
def test_any_script_that_the_font_has(text: str) -> None:
    words = paint_words(text, (1280, 720), DESK, Style())
    assert words.picture.shape[2] == 4
    assert bool(words.picture[..., 3].any()) == bool(text.strip())


def test_characters_that_no_font_has_are_named() -> None:
    with pytest.raises(InputError, match="characters that no installed font has"):
        find_font("abc\u0378")
    assert uncovered(find_font("a"), "a\u0378") == "\u0378"


def test_font_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match=r"font: file: got Comic\.ttf"):
        find_font("a", "Comic.ttf")


def test_font_is_replaced_where_it_lacks_a_character() -> None:
    assert find_font("abc", "DejaVuSerif.ttf").name == "DejaVuSerif.ttf"
    assert find_font("مشاركة", "DejaVuSerif.ttf").name != "DejaVuSerif.ttf"


def test_lines_break_at_spaces_and_keep_every_letter() -> None:
    font = x_height_font(find_font("x"), 10)
    text = "one two three four five\nsix " + "seven" * 30
    lines = wrap(text, font, 120)
    assert all(font.getlength(line) <= 120 for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "").replace("\n", "")


def test_reversed_scale_is_shown_in_the_order_of_its_keys() -> None:
    turned = Question(
        "free", LIKERT.text, "likert", keys={str(n + 1): str(3 - n) for n in range(7)}, labels=LIKERT.labels
    )
    straight = paint_question(LIKERT, (1280, 720), DESK, Style())
    other = paint_question(turned, (1280, 720), DESK, Style())
    assert straight.picture.shape == other.picture.shape
    assert not np.array_equal(straight.picture, other.picture)


def test_cross_has_its_size_and_is_symmetric() -> None:
    cross = paint_cross((1920, 1080), DESK, Style(cross_deg=0.6))
    assert cross.shape[0] == pytest.approx(0.6 * pixels_per_degree((1920, 1080), DESK), abs=1.5)
    assert np.array_equal(cross, cross[::-1])
    assert np.array_equal(cross, cross.swapaxes(0, 1))
    assert cross[0, 0, 3] == 0
