"""A headless Chromium, led by its DevTools protocol, for tests of a page."""

import base64
import json
import os
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self
from urllib.request import urlopen

from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--remote-debugging-port=0", "--hide-scrollbars",
    # Without a GPU WebGL is drawn on the CPU
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
)  # fmt: skip
STARTS_WITHIN_S = 60.0


def found() -> str | None:
    """The browser's program; None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name)) is not None), None)


class Browser:
    """One tab. Use as a context manager."""

    def __init__(self, folder: Path, size: tuple[int, int] = (1280, 800)) -> None:
        """folder: for the browser's own files"""
        program = found()
        assert program is not None
        log = folder / "chromium.log"
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                [program, *FLAGS, f"--user-data-dir={folder / 'profile'}", f"--window-size={size[0]},{size[1]}",
                 "about:blank"],
                stdout=subprocess.DEVNULL, stderr=file, start_new_session=True,
            )  # fmt: skip
        ends = time.monotonic() + STARTS_WITHIN_S
        while (told := re.search(r"ws://([^/]+)/", log.read_text(errors="replace"))) is None:
            assert self._process.poll() is None and time.monotonic() < ends, log.read_text(errors="replace")
            time.sleep(0.1)
        with urlopen(f"http://{told[1]}/json") as answer:
            pages = [one for one in json.load(answer) if one["type"] == "page"]
        self._talk = connect(pages[0]["webSocketDebuggerUrl"], max_size=None)
        self._number = 0
        self.console: list[str] = []
        self.ask("Page.enable")
        self.ask("Runtime.enable")

    def ask(self, method: str, **given: Any) -> dict[str, Any]:
        """What the browser answers to a method of its protocol."""
        self._number += 1
        self._talk.send(json.dumps({"id": self._number, "method": method, "params": given}))
        while True:
            message = json.loads(self._talk.recv(timeout=60.0))
            if message.get("id") == self._number:
                assert "error" not in message, message
                result: dict[str, Any] = message["result"]
                return result
            if message.get("method") == "Runtime.exceptionThrown":
                self.console.append(str(message["params"]["exceptionDetails"].get("text")))

    def open(self, address: str) -> None:
        self.ask("Page.navigate", url=address)

    def value(self, script: str) -> Any:
        """What a script comes to."""
        return self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)["result"].get(
            "value"
        )

    def wait_for(self, script: str, seconds: float = 60.0) -> Any:
        """The first value of a script that counts as true."""
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            if value := self.value(script):
                return value
            time.sleep(0.2)
        raise AssertionError(f"{script} did not become true; the page: {self.value('document.body.innerText')}")

    def click(self, label: str) -> None:
        """Click the first button with this text."""
        self.wait_for(
            f"(() => {{const b = [...document.querySelectorAll('button')].find(b => b.innerText.trim() === "
            f"{json.dumps(label)}); if (b) b.click(); return !!b}})()"
        )

    def picture(self, path: Path) -> bytes:
        """A screenshot, as PNG."""
        data = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        path.write_bytes(data)
        return data

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._talk.close()
        os.killpg(self._process.pid, 15)
        self._process.wait(10.0)
