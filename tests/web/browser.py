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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--hide-scrollbars", "--mute-audio", "--remote-debugging-port=0", "about:blank"),
)


def find_chromium() -> str | None:
    """Returns the path of a Chromium, None without one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """One page of the browser."""

    def __init__(self, address: str) -> None:
        from websockets.sync.client import connect

        self._socket = connect(address, max_size=2**27)
        self._numbers = itertools.count(1)
        for domain in ("Page", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Returns the result of a method of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60.0))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return dict(answer["result"])

    def open(self, address: str) -> None:
        """Goes to a page."""
        self.call("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """Returns the value of a JavaScript expression."""
        result = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, expression: str, seconds: float = 60.0) -> None:
        """Returns as soon as an expression is true."""
        # An element of the page itself has no value here.
        wait(lambda: self.value(f"Boolean({expression})"), seconds, expression)

    def picture(self) -> NDArray[np.uint8]:
        """Returns the page's pixels (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def size(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Sets the size of the window."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )

    def key(self, key: str, *, down: bool) -> None:
        """Presses or releases a key, "ArrowLeft" or "w"."""
        code = key if len(key) > 1 else f"Key{key.upper()}"
        kind = "keyDown" if down else "keyUp"
        self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code)

    def close(self) -> None:
        """Closes the connection to the page."""
        self._socket.close()


class Browser:
    """A running Chromium."""

    def __init__(self, port: int) -> None:
        self._port = port

    def tab(self, address: str = "about:blank") -> Tab:
        """Returns a new page."""
        import urllib.request

        request = urllib.request.Request(
            f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT"
        )
        with urllib.request.urlopen(request) as answer:
            found = json.load(answer)
        tab = Tab(found["webSocketDebuggerUrl"])
        if address != "about:blank":
            tab.open(address)
        return tab


@contextlib.contextmanager
def chromium(folder: Path) -> Iterator[Browser]:
    """Runs a Chromium with its profile in a folder."""
    path = find_chromium()
    assert path is not None
    size = "--window-size=1280,800"
    command = [path, f"--user-data-dir={folder}", size, *_FLAGS]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            port = folder / "DevToolsActivePort"
            lines = wait(lambda: port.exists() and port.read_text().split(), 60.0, "DevTools")
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
