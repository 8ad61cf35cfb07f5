"""The page in a real browser: no horizontal scroll from 360 to 1600 px, in light, dark and print."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import escape, unescape
from pathlib import Path

import pytest

from analysis.report import analyse, render_html
from tests.analysis.fabricate import demo_study

WIDTHS_PX = (360, 768, 1600)
MEASURE = """
const said = {};
for (const width of %s) {
  const frame = document.getElementById('f' + width);
  const page = frame.contentDocument;
  const small = [...page.querySelectorAll('svg text:not(.stamp)')].map(t => t.getBoundingClientRect().height);
  said[width] = {
    scroll: page.documentElement.scrollWidth, inner: frame.contentWindow.innerWidth,
    figures: page.querySelectorAll('figure svg').length, smallest_px: Math.min(...small.filter(h => h > 0)),
    outside: [...page.querySelectorAll('figure, .table, p, h2')].filter(
      e => e.getBoundingClientRect().right > frame.contentWindow.innerWidth + 1).length,
  };
}
document.getElementById('said').textContent = JSON.stringify(said);
"""


@pytest.fixture(scope="module")
def chromium() -> str:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium to look at the page with")
    return program


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("demo")
    demo_study(folder, participants=4, gaze_hz=60)
    return render_html(analyse([folder]))


def headless(program: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [
        program,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={folder / 'profile'}",
        *arguments,
    ]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)


def test_no_horizontal_scroll_at_any_width(page: str, chromium: str, tmp_path: Path) -> None:
    frames = "".join(
        f'<iframe id="f{width}" style="width:{width}px;height:900px;border:0" srcdoc="{escape(page)}"></iframe>'
        for width in WIDTHS_PX
    )
    script = f"<script>onload = () => {{ {MEASURE % list(WIDTHS_PX)} }}</script>"
    host = tmp_path / "host.html"
    host.write_text(f'<!doctype html><meta charset="utf-8"><body>{frames}<pre id="said"></pre>{script}</body>')
    done = headless(chromium, tmp_path, "--window-size=1700,1000", "--dump-dom", host.as_uri())
    found = re.search(r'<pre id="said">(.*?)</pre>', done.stdout, flags=re.S)
    assert found, done.stderr
    said = json.loads(unescape(found[1]))
    for width in WIDTHS_PX:
        seen = said[str(width)]
        assert seen["inner"] == width
        assert seen["scroll"] <= width, seen
        assert seen["outside"] == 0, seen
        assert seen["figures"] == page.count("<figure ")
        assert seen["smallest_px"] >= 7, seen


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_light_and_dark_follow_the_reader(page: str, chromium: str, tmp_path: Path, theme: str) -> None:
    from PIL import Image

    path = tmp_path / "report.html"
    path.write_text(page)
    shot = tmp_path / "shot.png"
    dark = ["--force-dark-mode", "--blink-settings=preferredColorScheme=0"] if theme == "dark" else []
    headless(chromium, tmp_path, "--window-size=800,600", f"--screenshot={shot}", *dark, path.as_uri())
    corner = sum(Image.open(shot).convert("RGB").getpixel((3, 3)))
    assert (corner > 600) if theme == "light" else (corner < 120)


def test_it_prints(page: str, chromium: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(page)
    pdf = tmp_path / "report.pdf"
    headless(chromium, tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", path.as_uri())
    assert pdf.read_bytes().startswith(b"%PDF")
