"""An experiment on the small scene, with an observer of known thresholds."""

from collections.abc import Callable
from pathlib import Path

import pytest

TEXT = """
name = "thresholds"
scene = "small.xml"
seed = 7
duration_s = 0.03
board = "autd3"

[varied]
key = "stimulus.drive_amplitude"

[task]
kind = "nafc"
gap_s = 0.02

[procedure]
kind = "staircase"
start = 0.5
steps = [6.0, 3.0]
low = 0.001
high = 1.0
reversals = 6
skipped = 2

[[conditions]]
name = "100 Hz"
keys = { "stimulus.am_frequency_Hz" = 100.0 }

[[conditions]]
name = "200 Hz"
keys = { "stimulus.am_frequency_Hz" = 200.0 }

[simulated]
threshold = -20.0
spread = 3.0
thresholds = { "200 Hz" = -26.0 }
"""
CONSTANT = """[procedure]
kind = "constant"
levels = [0.02, 0.035, 0.06, 0.1, 0.2, 0.4]
repeats = 30
"""

Written = Callable[..., Path]


@pytest.fixture
def experiment(small_scene, tmp_path) -> Written:
    """Writes the experiment's file; words are replaced by others, procedure by another part."""

    def write(*, procedure: str | None = None, **words: str) -> Path:
        small_scene()
        text = TEXT
        if procedure is not None:
            begin, end = text.index("[procedure]"), text.index("[[conditions]]")
            text = text[:begin] + procedure + "\n" + text[end:]
        for name, value in words.items():
            lines = [line for line in text.splitlines() if line.startswith(f"{name} = ")]
            assert lines, name
            text = text.replace(lines[0], f"{name} = {value}")
        path = tmp_path / "experiment.toml"
        path.write_text(text)
        return path

    return write
