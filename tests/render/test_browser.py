"""The page of a drive in a headless Chromium: cursor, keys, axes, colors, film and print."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from iits_mj.core.results import Line, Panel, Results
from iits_mj.render.compare_page import Comparison
from iits_mj.render.pages import write_results_page
from iits_mj.simulation.compare import Run
from tests.browser import Browser, Tab, chromium, needs_chromium
from tests.render.drives import drive, report

pytestmark = needs_chromium
CURSORS = "[...document.querySelectorAll('.cursor')].map(c => parseFloat(c.style.left))"
DRAWN = "document.querySelectorAll('.canvas .main-svg').length"
CANVAS = "document.querySelector('.canvas[tabindex]')"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("profile")) as made:
        yield made


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a film of 30 s at 10 pictures per second."""
    folder = tmp_path_factory.mktemp("drive")
    film = folder / "drive.mp4"
    writer = imageio_ffmpeg.write_frames(str(film), (64, 64), fps=10, macro_block_size=16)
    writer.send(None)
    for k in range(301):
        writer.send(np.full((64, 64, 3), k % 256, dtype=np.uint8))
    writer.close()
    return report(drive(), film).page().write(folder / "report.html")


@pytest.fixture
def tab(browser: Browser, page: Path) -> Iterator[Tab]:
    made = browser.tab(page)
    made.wait(f"{DRAWN} > 4")
    # All plots, also those far below the window.
    made.value("dispatchEvent(new Event('beforeprint'))")
    made.wait("document.querySelectorAll('.cursor').length === 14")
    yield made
    assert made.problems == []


def test_pointing_at_a_plot_moves_the_cursor_of_all(tab: Tab) -> None:
    before = tab.value(CURSORS)
    assert len(set(before)) == 1
    box = tab.value(f"(b => [b.left, b.top, b.width])({CANVAS}.getBoundingClientRect())")
    tab.mouse("mouseMoved", box[0] + 0.3 * box[2], box[1] + 40.0)
    tab.wait(f"{CURSORS}[0] !== {before[0]}")
    after = tab.value(CURSORS)
    assert len(after) == 14
    assert len(set(after)) == 1
    assert after[0] == pytest.approx(0.3 * box[2], abs=1.0)
    now = float(tab.value("document.getElementById('time').value"))
    assert now == pytest.approx(30.0 * (0.3 * box[2] - 62.0) / (box[2] - 72.0), abs=0.11)
    # The value beside the name of the line is that of the drive at this time.
    values = "document.querySelectorAll('#plot-1 .legend .value')"
    shown = tab.value(f"[...{values}].at(-1).textContent")
    table = drive()
    speed = 3.6 * np.interp(now, table.column("time [s]"), table.column("speed [m/s]"))
    assert float(shown.split()[0]) == pytest.approx(speed, abs=0.3)
    assert shown.endswith(" km/h")


def test_arrow_keys_move_the_cursor_and_a_screen_reader_hears_the_values(tab: Tab) -> None:
    tab.value(f"{CANVAS}.focus()")
    tab.press("Home")
    for _ in range(3):
        tab.press("ArrowRight")
    tab.press("ArrowRight", shift=True)
    assert float(tab.value("document.getElementById('time').value")) == pytest.approx(1.3, abs=0.01)
    assert len(set(tab.value(CURSORS))) == 1
    words = tab.value(f"{CANVAS}.getAttribute('aria-valuetext')")
    assert words.startswith("1.3 s: ")
    assert "km/h" in words
    tab.press("End")
    assert float(tab.value("document.getElementById('time').value")) == pytest.approx(30.0)


def test_tab_reaches_the_content_first_and_the_focus_is_visible(tab: Tab) -> None:
    tab.press("Tab")
    assert tab.value("document.activeElement.className") == "skip"
    tab.value(f"{CANVAS}.focus()")
    tab.press("ArrowRight")
    outline = tab.value("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"
    assert tab.value("document.activeElement.getAttribute('role')") == "slider"


def test_the_switch_shows_all_plots_over_station(tab: Tab) -> None:
    tab.value(
        "{const e = document.getElementById('time'); e.value = 10;"
        " e.dispatchEvent(new Event('input'));}"
    )
    tab.value("document.getElementsByName('axis')[1].click()")
    tab.wait("document.querySelectorAll('.canvas')[1].layout.xaxis.title.text === 'station [m]'")
    table = drive()
    station = table.column("station [m]")
    low, high = tab.value("document.querySelectorAll('.canvas')[1].layout.xaxis.range")
    assert (low, high) == pytest.approx((station[0], station[-1]), abs=0.01)
    at = np.interp(10.0, table.column("time [s]"), station)
    tab.wait(f"new Set({CURSORS}).size === 1")
    box = tab.value(f"{CANVAS}.clientWidth")
    place = 62.0 + (at - low) / (high - low) * (box - 72.0)
    assert tab.value(CURSORS)[0] == pytest.approx(place, abs=1.0)


def test_zoom_is_shared_and_zero_shows_all_again(tab: Tab) -> None:
    ranges = (
        "[...document.querySelectorAll('.canvas[tabindex]')].map(c => c.layout.xaxis.range.join())"
    )
    tab.value(f"{CANVAS}.focus()")
    tab.press("Home")
    tab.press("+")
    tab.wait(f"new Set({ranges}).size === 1 && {ranges}[0] === '0,15'")
    tab.press("0")
    tab.wait(f"new Set({ranges}).size === 1 && {ranges}[0] === '0,30'")


def test_a_line_can_be_hidden(tab: Tab) -> None:
    button = "document.querySelector('#plot-1 .legend button')"
    tab.value(f"{button}.click()")
    assert tab.value(f"{button}.getAttribute('aria-pressed')") == "false"
    assert tab.value("document.querySelectorAll('.canvas')[1].data[0].visible") is False


def test_film_and_cursor_move_each_other(tab: Tab) -> None:
    film = "document.querySelector('video')"
    tab.wait(f"{film}.readyState > 0")
    tab.value(
        "{const e = document.getElementById('time'); e.value = 20;"
        " e.dispatchEvent(new Event('input'));}"
    )
    tab.wait(f"Math.abs({film}.currentTime - 20) < 0.1 && !{film}.seeking")
    truck = tab.value("document.querySelector('.truck').style.left")
    tab.value(f"{film}.currentTime = 5")
    tab.wait("Math.abs(document.getElementById('time').value - 5) < 0.2")
    assert tab.value("document.querySelector('.truck').style.left") != truck
    tab.value("document.getElementById('play').click()")
    tab.wait("document.getElementById('time').value > 5.5")
    tab.value("document.getElementById('play').click()")
    assert tab.value(f"{film}.paused")


def test_dark_and_light_follow_the_system_and_the_switch(tab: Tab) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    ink = "document.querySelector('.canvas').layout.font.color"
    tab.media(prefers_color_scheme="light")
    tab.wait(f"{paper} === 'rgb(255, 255, 255)' && {ink} === 'rgb(27, 39, 51)'")
    tab.media(prefers_color_scheme="dark")
    tab.wait(f"{paper} === 'rgb(20, 25, 30)' && {ink} === 'rgb(230, 234, 238)'")
    tab.value(
        "{const e = document.getElementById('theme'); e.value = 'light';"
        " e.dispatchEvent(new Event('change'));}"
    )
    tab.wait(f"{paper} === 'rgb(255, 255, 255)' && {ink} === 'rgb(27, 39, 51)'")
    tab.value("localStorage.clear()")


def test_a_phone_shows_everything_in_its_width(tab: Tab) -> None:
    tab.size(390, 844)
    tab.wait(f"{CANVAS}.clientWidth < 390 && {CANVAS}.layout.width === {CANVAS}.clientWidth")
    assert tab.value("document.documentElement.scrollWidth") == 390


def test_print_has_all_plots_in_light_colors_without_controls(tab: Tab) -> None:
    tab.media(prefers_color_scheme="dark")
    tab.call("Emulation.setEmulatedMedia", media="print")
    tab.wait("document.querySelector('.canvas').layout.font.color === 'rgb(27, 39, 51)'")
    hidden = "[...document.querySelectorAll('.bar, video, nav, .cursor, #theme')]"
    assert tab.value(f"{hidden}.every(e => e.offsetParent === null)")
    width = "[...document.querySelectorAll('.canvas')].map(c => c.layout.width)"
    tab.wait(f"{width}.every(w => w === 680)")
    assert tab.pdf().startswith(b"%PDF")
    tab.call("Emulation.setEmulatedMedia", media="")
    tab.wait(f"{width}.some(w => w !== 680)")


def test_the_page_works_without_its_film(browser: Browser, tmp_path: Path) -> None:
    page = report(drive(), tmp_path / "gone.mp4").page().write(tmp_path / "report.html")
    tab = browser.tab(page)
    tab.wait(f"{DRAWN} > 4 && document.querySelector('video').hidden")
    assert "which is missing" in tab.value("document.querySelector('.film').innerText")
    tab.value("document.getElementById('play').click()")
    tab.wait("document.getElementById('time').value > 0.3")
    # The browser itself reports the missing file, nothing else.
    time.sleep(0.2)
    assert all("gone.mp4" in problem for problem in tab.problems)


def test_pages_of_results_and_of_comparisons_draw_without_errors(
    browser: Browser, tmp_path: Path
) -> None:
    x = np.linspace(0.0, 4.0, 30)
    circle = Panel("Path", "x [m]", "y [m]", (Line("truck", np.cos(x), np.sin(x)),))
    cost = Panel("Cost", "n [-]", "t [s]", (Line("", x, x),))
    found = Results("bench", figures={"cost": [cost, circle]})
    results, _ = write_results_page(found, "1.0", tmp_path)
    first, second = (Run("a", drive(), True, {}, {}), Run("b", drive(250, 1.0), True, {}, {}))
    comparison = Comparison(first, second).page("1.0").write(tmp_path / "compare.html")
    for page, plots in ((results, 2), (comparison, 10)):
        tab = browser.tab(page)
        tab.wait(f"{CANVAS}?.tabIndex === 0")
        tab.value("dispatchEvent(new Event('beforeprint'))")
        tab.wait(f"{DRAWN} >= {plots}")
        tab.value(f"{CANVAS}.focus()")
        tab.press("End")
        assert tab.value(f"{CANVAS}.getAttribute('aria-valuetext')")
        assert tab.problems == []
    tab.value("document.getElementsByName('axis')[1].click()")
    tab.wait("document.querySelectorAll('.truck').length === 2")
    assert tab.problems == []
