"""A headless Chromium that tests drive by its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import connect

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), ""
)
needs_chromium = pytest.mark.skipif(not CHROMIUM, reason="no Chromium on the PATH")
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions"),
    # The processor draws in 3-D as well.
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--hide-scrollbars", "--mute-audio", "--disable-background-networking"),
    # A page behind another one has its full share of the processor, and its timers run.
    *("--disable-renderer-backgrounding", "--disable-background-timer-throttling"),
    "--disable-backgrounding-occluded-windows",
    *("--window-size=1280,800", "--remote-debugging-port=0", "about:blank"),
)
# Two processors draw a picture in up to a minute when other tests use them as well.
_TIMEOUT = 180.0
_CODES = {"Tab": 9, "End": 35, "Home": 36, "ArrowLeft": 37, "ArrowRight": 39}


class Tab:
    """A page in the browser.

    Attributes:
      problems: messages of the console that are errors, and exceptions that nothing caught.
    """

    def __init__(self, address: str) -> None:
        self._socket = connect(address, max_size=None)
        self._numbers = itertools.count(1)
        self.problems: list[str] = []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Calls a method of the protocol and returns its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=_TIMEOUT))
            if message.get("id") == number:
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        kind, found = message.get("method"), message.get("params", {})
        if kind == "Runtime.exceptionThrown":
            details = found["exceptionDetails"]
            self.problems.append(details.get("exception", {}).get("description", details["text"]))
        elif kind == "Log.entryAdded" and found["entry"]["level"] == "error":
            self.problems.append(f"{found['entry']['text']} {found['entry'].get('url', '')}")
        elif kind == "Runtime.consoleAPICalled" and found["type"] == "error":
            self.problems.append(str(found["args"]))

    def open(self, page: Path | str) -> None:
        """Opens a file or an address and waits until it is loaded."""
        address = page.resolve().as_uri() if isinstance(page, Path) else page
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'")

    def size(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Sets the size of the window."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=mobile,
        )  # fmt: skip

    def media(self, **features: str) -> None:
        """Sets features of the system, such as prefers_color_scheme="dark"."""
        values = [{"name": n.replace("_", "-"), "value": v} for n, v in features.items()]
        self.call("Emulation.setEmulatedMedia", features=values)

    def value(self, script: str) -> Any:
        """The value of an expression in the page."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, condition: str, seconds: float = _TIMEOUT) -> None:
        """Waits until an expression is true."""
        # An element of the page itself has no value here.
        wait(lambda: self.value(f"Boolean({condition})"), seconds, condition)

    def key(self, key: str, *, down: bool, shift: bool = False) -> None:
        """Presses or releases a key where the focus is: "ArrowLeft" or "w"."""
        self.call(
            "Input.dispatchKeyEvent",
            type="keyDown" if down else "keyUp",
            key=key,
            code=key if len(key) > 1 else f"Key{key.upper()}",
            windowsVirtualKeyCode=_CODES.get(key, 0),
            modifiers=8 if shift else 0,
        )

    def press(self, key: str, *, shift: bool = False) -> None:
        """Presses a key and releases it."""
        self.key(key, down=True, shift=shift)
        self.key(key, down=False, shift=shift)

    def mouse(self, kind: str, x: float, y: float, button: str = "none") -> None:
        """Sends a mouse event: "mouseMoved", "mousePressed" or "mouseReleased"."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1)

    def picture(self) -> NDArray[np.uint8]:
        """The pixels of the window (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def pdf(self) -> bytes:
        """Prints the page."""
        found = self.call(
            "Page.printToPDF", preferCSSPageSize=True, paperWidth=8.27, paperHeight=11.7
        )
        return base64.b64decode(found["data"])

    def close(self) -> None:
        """Closes the page, which then draws no more, and the connection to it."""
        self.call("Page.close")
        self._socket.close()


class Browser:
    """A running Chromium."""

    def __init__(self, port: int) -> None:
        self._port = port

    def tab(self, page: Path | str = "", width: int = 1400, height: int = 900) -> Tab:
        """Returns a new tab; opens a file or an address in it, if one is given."""
        request = urllib.request.Request(
            f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT"
        )
        with urllib.request.urlopen(request) as answer:
            found = json.load(answer)
        tab = Tab(found["webSocketDebuggerUrl"])
        tab.size(width, height)
        if page:
            tab.open(page)
        return tab


@contextlib.contextmanager
def chromium(folder: Path) -> Iterator[Browser]:
    """Runs a Chromium with its profile in a folder."""
    command = [CHROMIUM, f"--user-data-dir={folder}", *_FLAGS]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            port = folder / "DevToolsActivePort"
            lines = wait(lambda: port.is_file() and port.read_text().split(), _TIMEOUT, "DevTools")
            yield Browser(int(lines[0]))
        finally:
            process.terminate()


def wait(found: Callable[[], Any], seconds: float, what: str) -> Any:
    """Returns the first true value of a function.

    Raises:
      AssertionError: it is not true within a time.
    """
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(0.05)
    raise AssertionError(f"{what} is not true within {seconds:g} s")
