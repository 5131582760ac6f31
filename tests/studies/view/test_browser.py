"""The page in a real browser, headless, with WebGL on the CPU."""

import io
import os
import signal
import threading
import time

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

from headless_browser import Browser, found
from PIL import Image

from palmfield.studies.view.link import Link
from palmfield.studies.view.messages import Address
from palmfield.studies.view.run import Ending, SceneSource, ShownScene, run_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.wall_clock,
    pytest.mark.skipif(found() is None, reason="no Chromium is installed (Debian: apt-get install chromium)"),
]


def skin_pixels(browser, folder):
    """How many pixels over the array and beside the panels are as blue or as grey as the skin, as its body is not."""
    picture = np.asarray(Image.open(io.BytesIO(browser.picture(folder / "page.png"))).convert("RGB")).astype(int)
    height, width = picture.shape[:2]
    red, green, blue = picture[: int(0.45 * height), int(0.3 * width) : int(0.7 * width)].transpose(2, 0, 1)
    return int(((red + green + blue < 720) & (abs(red - green) < 40) & (blue > red - 15)).sum())


def test_a_browser_shows_the_scene_and_its_controls_reach_it(small_scene, tmp_path):
    sent = []
    live = ShownScene(SceneSource(small_scene(), "cpu", None, None), {}, tmp_path / "out", sent.append)
    end = Ending()
    # Slow, as a browser without a GPU takes its time to read a mesh
    with Link(Address("127.0.0.1", None, "", 4.0)) as link:
        live.send = link.send
        live.show()
        runner = threading.Thread(target=run_for, args=(live, link, end))
        runner.start()
        try:
            with Browser(tmp_path) as browser:
                browser.open(link.address)
                text = "document.body.innerText"
                browser.wait_for(f"{text}.includes('dB SL') && {text}.includes('times slower')")
                for words in ("Reset", "Record", "frequency [Hz]", "phase of each transducer"):
                    assert words in browser.value(text)
                time.sleep(3.0)
                seen = []
                for _ in range(8):
                    seen.append(skin_pixels(browser, tmp_path))
                # Some meshes are read while another is seen: there is no picture without a skin
                assert min(seen) > 0.5 * max(seen) > 200, seen
                browser.click("Pause")
                browser.wait_for(f"{text}.includes('paused')")
                assert not live.playing
                browser.click("Play")
                browser.wait_for(f"!{text}.includes('paused')")
                assert live.playing
                assert not browser.console
                # Dark and narrow, as on a telephone at night: the controls are below the skin, and their words are seen
                browser.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
                small = {"width": 360, "height": 640, "deviceScaleFactor": 1, "mobile": True}
                browser.ask("Emulation.setDeviceMetricsOverride", **small)
                browser.open(link.address)
                browser.wait_for(f"{text}.includes('times slower')")
                button = "[...document.querySelectorAll('button')].find(b => b.innerText.trim() === 'Pause')"
                assert browser.value(f"{button}.getBoundingClientRect().top") > 0.5 * 640
                assert browser.value(f"{button}.getBoundingClientRect().width") > 0.8 * 360
                words = "[...document.querySelectorAll('div')].filter(d => d.innerText.startsWith('shown: ')).pop()"
                light = f"getComputedStyle({words} || document.body).color.match(/[0-9]+/g).slice(0, 3).map(Number)"
                assert min(browser.value(light)) > 150
                # A server that is gone is said to be gone
                gone = "getComputedStyle(document.getElementById('palmfield-gone')).display"
                assert browser.value(gone) == "none"
                os.kill(link.pid, signal.SIGKILL)
                browser.wait_for(f"{gone} === 'block'", 10.0)
                assert "The view has ended" in browser.value(text)
        finally:
            end.requested = True
            runner.join()
