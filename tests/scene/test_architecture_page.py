"""The page docs/architecture.md against the tree that it describes."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_module_that_the_page_names_exists_and_every_one_at_the_top_is_named():
    page = (ROOT / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"`(?:transfer\.)?([\w/]+\.py)`", page))
    assert len(named) > 20
    for name in named:
        assert (ROOT / name).exists() or list((ROOT / "palmfield").rglob(name)), name
    for folder, modules in re.findall(r"`(palmfield/\w+/)` \(([^)]*)\)", page):
        for module in re.findall(r"`(\w+)`", modules):
            assert (ROOT / folder / f"{module}.py").exists(), folder + module
    top = {path.name for path in (ROOT / "palmfield").glob("*.py")} - {"__init__.py", "__main__.py"}
    assert top - {Path(name).name for name in named} <= {"device.py", "errors.py"}
