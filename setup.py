"""Puts what lies beside the package, scenes and hand presets, into it while it is built, and describes it for PyPI."""

import re
import shutil
import tomllib
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
FOLDERS = ("mjcf", "hand_models")
FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r"!\[([^\]]*)\]\((?!https?://)([^)]+)\)\n*")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?://)([^)]+)\)")


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


def described(readme: str, source: str | None) -> str:
    """README.md for a page that is not beside the repository.

    Where pyproject.toml names a public address of the source (`[project.urls]` Source), pictures and links lead there;
    without one pictures are left out, and of links the words stay.
    """
    parts = FENCE.split(readme)
    for number in range(0, len(parts), 2):
        if source is None:
            parts[number] = LINK.sub(r"\1", PICTURE.sub("", parts[number]))
        else:
            at = source.rstrip("/")
            parts[number] = PICTURE.sub(rf"![\1]({at}/raw/HEAD/\2)\n\n", parts[number])
            parts[number] = LINK.sub(rf"[\1]({at}/blob/HEAD/\2)", parts[number])
    return "".join(parts)


if __name__ == "__main__":
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    setup(
        cmdclass={"build_py": BuildWithData},
        long_description=described(
            (ROOT / "README.md").read_text(encoding="utf-8"), project.get("urls", {}).get("Source")
        ),
        long_description_content_type="text/markdown",
    )
