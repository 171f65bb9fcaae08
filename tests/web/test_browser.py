"""The viewer in a real browser."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.core.errors import Error
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.web import WebServer
from iits_mj.web.stage import Stage
from tests.browser import chromium, needs_chromium, wait

pytest.importorskip("mjviser")
pytestmark = needs_chromium

SPEED = "document.querySelector('#iits .dash:not([hidden]) .speed')?.textContent"
ROWS = (
    "Object.fromEntries([...document.querySelectorAll('#iits .list div')]"
    ".map(e => [...e.children].map(c => c.textContent)))"
)
BUTTONS = "[...document.querySelectorAll('#iits button')]"
BANNER = "document.querySelector('#iits .banner:not([hidden])')?.textContent"
CANVAS = "[...document.querySelectorAll('canvas')].some(c => c.width > 100)"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as made:
        yield made


class View:
    """A running `iits-mj view --web`."""

    def __init__(self, *arguments):
        command = [sys.executable, "-m", "iits_mj.cli", "view", "--web", "--port", "0", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        lines = []
        for line in self.process.stdout:
            lines.append(line)
            if found := re.search(r"http://\S+", line):
                self.url = found.group(0)
            if line.startswith("Ctrl-C"):
                return
        raise AssertionError("".join(lines))

    def end(self):
        """Interrupts it; returns its exit code and last words."""
        self.process.send_signal(signal.SIGINT)
        words, _ = self.process.communicate(timeout=120)
        return self.process.returncode, words


@pytest.fixture
def view():
    started = []

    def start(*arguments):
        started.append(View(*arguments))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
            one.process.wait()


def number(text):
    return float(re.search(r"[-+]?\d+(\.\d+)?", text).group(0))


def test_a_drive_is_shown_paused_steered_and_ended(view, browser):
    live = view("--density", "sparse", "--speed-planner", "cruise")
    page = browser.tab(live.url)
    # Few pixels: here the processor draws them.
    page.size(800, 600)
    page.wait(SPEED, 240.0)
    page.wait(CANVAS)
    assert page.value("location.pathname") in live.url

    def time_shown():
        return number(page.value(ROWS)["time"])

    page.wait(f"Boolean({SPEED}) && ({ROWS}).time > '1'", 120.0)
    words = page.value("document.querySelector('#iits').innerText")
    assert not re.search(r"\b(None|NaN|undefined|inf)\b", words)

    page.wait("document.querySelectorAll('canvas').length", 60.0)
    page.press("Space")
    page.wait(f"{BUTTONS}.some(b => b.textContent == 'Resume')")
    held = time_shown()
    # The scene still arrives, and the drive waits meanwhile.
    picture = wait_for_truck(page)
    assert time_shown() == held
    colors = np.unique(picture.reshape(-1, 3) // 32, axis=0)
    assert len(colors) > 20
    press(page, "Resume")

    # A page that draws for seconds, on a busy machine, loses the wheel, as it must.
    no_drawing = "window.requestAnimationFrame = () => 0"
    page.value(no_drawing)
    second = browser.tab(live.url)
    second.value(no_drawing)
    second.wait(SPEED, 120.0)
    press(page, "Drive yourself")
    page.wait("document.querySelector('#iits .help:not([hidden])')")
    # The other page cannot take the wheel.
    second.wait(f"{BUTTONS}.some(b => b.disabled)")
    second.close()
    page.key("ArrowLeft", down=True)
    page.wait(f"parseFloat(({ROWS})['steering wheel']) > 8", 60.0)
    page.key("ArrowLeft", down=False)
    page.press("Escape")
    page.wait("document.querySelector('#iits .help').hidden")

    page.close()
    assert live.process.poll() is None
    code, words = live.end()
    assert code == 130
    assert "interrupted" in words
    assert "Traceback" not in words


def press(page, name):
    page.value(f"{BUTTONS}.find(b => b.textContent == '{name}').click()")


def wait_for_truck(page):
    """Returns a picture with the truck's red and blue stripes, without the instruments."""
    page.value("document.querySelector('#iits').style.visibility = 'hidden'")
    end = time.monotonic() + 240.0
    while time.monotonic() < end:
        picture = page.picture()
        red, green, blue = picture[200:, 100:700].astype(int).transpose(2, 0, 1)
        stripes = (red > 120) & (green < 60) & (blue < 70), (blue > 60) & (red < 50) & (green < 75)
        if min(stripe.sum() for stripe in stripes) > 30:
            page.value("document.querySelector('#iits').style.visibility = ''")
            return picture
        time.sleep(1.0)
    raise AssertionError("no truck in the picture")


def test_without_the_token_there_is_no_page(view, browser):
    live = view("--traffic-mode", "none", "--speed-planner", "cruise")
    page = browser.tab(live.url.rsplit("/", 2)[0] + "/")
    page.wait("document.body.innerText.includes('token')")
    assert not page.value("document.querySelectorAll('canvas, #iits').length")
    page.close()
    assert live.end()[0] == 130


@pytest.mark.slow
def test_a_recording_has_a_time_line(view, browser, tmp_path):
    config = DriveConfig(duration=4.0, density="sparse", speed_planner="cruise")
    with Simulation(config, record=True, visuals=False) as simulation:
        simulation.run()
        simulation.save_recording(tmp_path / "drive.npz")
    shown = view(os.fspath(tmp_path / "drive.npz"))
    page = browser.tab(shown.url)
    page.size(800, 500)
    line = "document.querySelector('#iits .dash:not([hidden]) .timeline:not([hidden]) input')"
    page.wait(line, 240.0)
    assert page.value(f"Number({line}.max)") == pytest.approx(4.0)
    page.wait(f"Number({line}.value) >= 3.9", 120.0)
    page.value(f"{line}.value = 1.0, {line}.oninput()")
    page.wait(f"({ROWS}).time.startsWith('1.')", 60.0)
    page.close()
    assert shown.end()[0] == 130


class Failing(Stage):
    now = 0.0

    def play(self):
        time.sleep(3.0)
        raise Error("the simulation diverged at t = 1.00 s")


def test_an_error_of_the_simulation_stays_in_the_page(browser):
    with WebServer(port=0, title="a test") as server:
        page = browser.tab(server.url)
        page.wait("document.querySelector('#iits')")
        with pytest.raises(Error, match="diverged"):
            Failing(server).run()
        page.wait(f"({BANNER} || '').includes('diverged')")
    time.sleep(1.5)
    assert "diverged" in page.value(BANNER)
    page.close()


@pytest.mark.slow
def test_the_replay_and_the_report_around_it_move_together(browser, tmp_path):
    words = "drive --duration 4 --no-video --replay --traffic-mode none --speed-planner cruise"
    assert cli.main([*words.split(), "--out", os.fspath(tmp_path)]) == 0
    page = browser.tab(tmp_path / "report.html", 800, 900)
    assert not page.value("document.querySelector('iframe')")
    page.wait("document.getElementById('time').max > 3.8")
    page.value("document.getElementById('time').value = 2.5")
    page.value("document.getElementById('time').dispatchEvent(new Event('input'))")
    # A page of a file may not look into another: this one notes what the replay tells it.
    page.value("addEventListener('message', e => window.told ??= e.data.time)")
    page.value("document.getElementById('replay').click()")
    frame = "document.querySelector('iframe')"
    page.wait(f"{frame}?.clientHeight > 300")
    page.value(f"{frame}.scrollIntoView()")
    left, top, right, bottom = page.value(
        f"(b => [b.left, b.top, b.right, b.bottom])({frame}.getBoundingClientRect())"
    )

    def stripes():
        shown = page.picture()[int(top) : int(bottom), int(left) : int(right)].astype(int)
        red, green, blue = shown.transpose(2, 0, 1)
        return int(((red > 120) & (green < 60) & (blue < 70)).sum())

    wait(lambda: stripes() > 20, 240.0, "the truck")
    # It stands still at the cursor until it is played there.
    time.sleep(1.0)
    assert page.value("window.told") is None
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, left + 20.0, bottom - 18.0, "left")
    page.wait("window.told", 120.0)
    assert 2.5 < page.value("window.told") < 3.5
    page.wait("document.getElementById('time').value > 2.6")
    assert page.problems == []
