"""The documentation site: built by mkdocs with warnings as errors, every public name described in it."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("palmfield", "palmfield.acoustics", "palmfield.skin", "palmfield.instruments", "palmfield.perception")


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_has_every_public_name(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    site = tmp_path / "site"
    for package in PACKAGES:
        page = (site / "api" / f"{package.removeprefix('palmfield.')}.html").read_text()
        for name in importlib.import_module(package).__all__:
            assert name.startswith("__") or f'id="{package}.{name}"' in page, f"{package}.{name}"
    index = (site / "index.html").read_text()
    assert 'href="skin.html"' in index and "images/front.png" in index
    assert "Drive your array" in index
    # Equations are MathML and nothing is fetched from elsewhere
    skin = (site / "concepts" / "skin_mechanics.html").read_text()
    assert skin.count("<math") > 20 and "equation0here" not in skin
    assert not re.search(r"(?:src|rel=\"stylesheet\" href)=\"https?:", index + skin)
