"""What packages below the scene must not know, by their syntax trees."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import palmfield
from palmfield.config import CONFIGS
from palmfield.skin.explicit_layer import OWN
from palmfield.skin.solver_choice import WHERE

FOLDER = Path(palmfield.__file__).parent
BELOW = ("acoustics", "skin", "drive", "stimulus", "hand", "motion", "perception", "device.py", "transforms.py")
"""Packages and modules that serve scenes and know nothing of them."""
KEYS = sorted({key for config in CONFIGS for key in config.model_fields})
OF_SCENES = re.compile(rf"plugin '|instance '|\bkeys? '|\bkeys? \(?(?:{'|'.join(KEYS)})\b|</?[a-z]+[ />]")


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of all texts of a module that are no docstrings, those of f-strings without their values."""
    told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told:
            yield node.lineno, node.value


def test_a_text_that_knows_scenes_is_found() -> None:
    for known in (
        "plugin 'x'",
        "of instance 'x'",
        "key 'x'",
        "by key dither",
        "(keys depth_m, x)",
        "give <body name=.../>",
    ):
        assert OF_SCENES.search(known)
    for free in ("key 3", "a <= b", "<p^2>", "the key is lost", "set dither"):
        assert not OF_SCENES.search(free)
    assert list(texts(ast.parse('"""key \'a\'"""\nx = f"key \'{y}\'"'))) == [(2, "key '"), (2, "'")]


def test_messages_below_the_scene_name_no_keys_nor_elements() -> None:
    """They name a setting in a field of the error, which `palmfield.config.base.naming_keys` puts in words."""
    files = [
        file for part in BELOW for file in ([FOLDER / part] if part.endswith(".py") else (FOLDER / part).rglob("*.py"))
    ]
    assert len(files) > 200
    assert [
        f"{file.relative_to(FOLDER)}:{line}: {text}"
        for file in sorted(files)
        for line, text in texts(ast.parse(file.read_text(encoding="utf-8")))
        if OF_SCENES.search(text)
    ] == []


SOLVERS = {*OWN, *WHERE}


def compared(tree: ast.AST) -> Iterator[int]:
    """Lines of a module on which something is compared with, or looked up by, the name of a skin solver."""
    for node in ast.walk(tree):
        parts: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
        elif isinstance(node, ast.Subscript) and ast.unparse(node.value) != "Literal":
            parts = [node.slice]
        elif isinstance(node, ast.MatchValue):
            parts = [node.value]
        parts += [each for part in parts if isinstance(part, ast.Tuple | ast.List | ast.Set) for each in part.elts]
        if any(isinstance(part, ast.Constant) and part.value in SOLVERS for part in parts):
            yield node.lineno if isinstance(node, ast.expr) else node.value.lineno  # type: ignore[attr-defined]


def test_a_comparison_with_a_solvers_name_is_found() -> None:
    for known in ('a.name == "modal"', '"reduced" in names', 'a in ("x", "wedges")', 'seconds["wedges"]'):
        assert list(compared(ast.parse(known))) == [1]
    assert list(compared(ast.parse('match a.solver:\n    case "particles":\n        pass'))) == [2]
    assert list(compared(ast.parse('a.solver == "auto"; b = "modal"'))) == []


def test_nobody_outside_the_skin_branches_on_a_solvers_name() -> None:
    """A solver says by attributes what others need (`palmfield.skin.explicit_layer.LayerSolver`, `SkinStepper`)."""
    files = [file for file in sorted(FOLDER.rglob("*.py")) if FOLDER / "skin" not in file.parents]
    assert len(files) > 400
    assert [
        f"{file.relative_to(FOLDER)}:{line}"
        for file in files
        for line in compared(ast.parse(file.read_text(encoding="utf-8")))
    ] == []
