"""A page in a browser without a screen: Chromium, told what to do through a pipe (the DevTools protocol)."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions", "--mute-audio"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars", "--remote-debugging-pipe"),
)
_KEYS = {"Enter": (13, "\r"), "Tab": (9, ""), "ArrowRight": (39, ""), "ArrowLeft": (37, ""), " ": (32, " ")}


class Browser:
    """A browser with one page. What goes wrong in it, and what it asks for outside of the page, is kept."""

    def __init__(self) -> None:
        assert CHROMIUM is not None
        self._folder = tempfile.mkdtemp()
        commands, self._to = os.pipe()
        self._from, answers = os.pipe()
        # Chromium looks for its pipe at 3 and 4, which may be something else here
        line = f'exec {{own}}<&{commands} {{told}}>&{answers}; exec "$0" "$@" 3<&$own 4>&$told'
        words = ["bash", "-c", line, CHROMIUM, *_FLAGS, f"--user-data-dir={self._folder}", "about:blank"]
        none = subprocess.DEVNULL
        self._process = subprocess.Popen(words, pass_fds=(commands, answers), stdin=none, stdout=none, stderr=none)
        os.close(commands)
        os.close(answers)
        self._kept, self._number, self._session = b"", 0, None
        self.wrong: list[str] = []
        self.asked: list[str] = []
        (target,) = [own for own in self.call("Target.getTargets")["targetInfos"] if own["type"] == "page"]
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.until("document.readyState === 'complete'")  # the empty page: what is asked before it is there gets lost

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(20)
        os.close(self._to)
        os.close(self._from)
        shutil.rmtree(self._folder, ignore_errors=True)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What the browser answers."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            found = self._next(60)
            if found.get("id") == self._number:
                assert "error" not in found, (method, found["error"])
                return found["result"]
            self._hear(found)

    def _next(self, seconds: float) -> dict[str, Any]:
        end = time.monotonic() + seconds
        while b"\0" not in self._kept:
            ready, _, _ = select.select([self._from], [], [], max(end - time.monotonic(), 0))
            assert ready, "the browser does not answer"
            part = os.read(self._from, 1 << 20)
            assert part, "the browser has gone"
            self._kept += part
        first, _, self._kept = self._kept.partition(b"\0")
        return json.loads(first)

    def _hear(self, event: dict[str, Any]) -> None:
        told = event.get("params", {})
        if event["method"] == "Runtime.exceptionThrown":
            own = told["exceptionDetails"]
            self.wrong.append(own.get("exception", {}).get("description", own["text"]))
        elif event["method"] == "Log.entryAdded":
            self.wrong.append(told["entry"]["text"])
        elif event["method"] == "Network.requestWillBeSent":
            self.asked.append(told["request"]["url"])

    def open(self, path: Path, width: int = 800, height: int = 900) -> None:
        """A page, in a window of so many pixels; returns when it has drawn what it draws by itself."""
        self.resize(width, height)
        self.wrong.clear()
        self.asked.clear()
        assert not self.call("Page.navigate", url=path.resolve().as_uri()).get("errorText")
        self.until("document.readyState === 'complete' && document.querySelector('#table .content > *')")
        self.settle()

    def resize(self, width: int, height: int) -> None:
        """Of the page."""
        phone = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **phone)

    def value(self, expression: str) -> Any:
        """Of a JavaScript expression; promises are waited for."""
        how = {"returnByValue": True, "awaitPromise": True}
        found = self.call("Runtime.evaluate", expression=expression, **how)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, expression: str, seconds: float = 60) -> None:
        """Wait until it is true."""
        end = time.monotonic() + seconds
        while not self.value(f"Boolean({expression})"):
            assert time.monotonic() < end, f"never: {expression}"
            time.sleep(0.05)

    def settle(self) -> None:
        """Until every chart is drawn, and nothing waits to be."""
        self.until("typeof charts === 'undefined' || charts.every((own) => own.drawn)")
        self.value("new Promise((done) => setTimeout(() => requestAnimationFrame(done), 50))")

    def press(self, key: str, times: int = 1) -> None:
        """A key, where the focus is."""
        code, text = _KEYS[key]
        for _ in range(times):
            own = {"key": key, "code": "Space" if key == " " else key, "windowsVirtualKeyCode": code}
            self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **own)
            self.call("Input.dispatchKeyEvent", type="keyUp", **own)

    def type(self, text: str) -> None:
        """Letters, where the focus is."""
        self.call("Input.insertText", text=text)

    def picture(self, path: Path, whole: bool = True) -> None:
        """What is seen; all of the page, or as much as the window shows."""
        found = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))
