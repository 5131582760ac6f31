"""The page docs/sweeps.md against what a sweep writes and takes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from palmfield.studies.sweeps.batch import MOST_IN_BATCH
from palmfield.studies.sweeps.store import variables

pytestmark = pytest.mark.usefixtures("kept_operators")

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "sweeps.md").read_text()
QUICK = {
    "np.linspace(50, 300, 6)": "np.linspace(150, 300, 2)",
    '"skin.accuracy": 0.2}': '"skin.accuracy": 0.5, "skin.patch_radius_m": 0.02}, workers=0, duration_s=0.02',
}
"""What the page says, and what is run in its place so that the test is quick."""


def test_the_table_has_every_variable_and_dimension():
    rows = PAGE.split("\n| variable |")[1].split("\n\n")[0].split("\n")[2:]
    told = {}
    for row in rows:
        _, names, dims, *_ = row.split("|")
        told |= {name: tuple(re.findall(r"`(\w+)`", dims)) for name in re.findall(r"`(\w+)`", names)}
    assert told == {name: variable.dims for name, variable in variables(True).items()}


def test_numbers_on_the_page_are_those_of_the_code():
    assert f"at most {MOST_IN_BATCH} of them" in PAGE


@pytest.mark.slow
def test_python_of_the_page_runs(tmp_path):
    code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
    for words, quick in QUICK.items():
        assert words in code, f"the page says '{words}' no longer: mend QUICK"
        code = code.replace(words, quick)
    (tmp_path / "mjcf").symlink_to(ROOT / "mjcf")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "4 of 4 points" in done.stdout and "dB SL" in done.stdout
