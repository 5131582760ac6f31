"""Puts the scenes and hand presets, which lie beside the package, into it while a wheel is built."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
FOLDERS = ("mjcf", "hand_models")
TOLERANCES = "tolerances.toml"


class BuildWithData(build_py):
    """build_py that copies the data folders to palmfield/_data in the build, never in the source tree."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:  # the package stays in the clone, beside its data
            return
        for name in FOLDERS:
            target = Path(self.build_lib) / "palmfield" / "_data" / name
            shutil.rmtree(target, ignore_errors=True)  # an earlier build may have left files that are gone by now
            shutil.copytree(ROOT / name, target)
        gallery = Path(self.build_lib) / "palmfield" / "_data" / "gallery"
        gallery.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / "docs" / "gallery" / TOLERANCES, gallery / TOLERANCES)


setup(cmdclass={"build_py": BuildWithData})
