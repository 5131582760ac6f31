"""What `palmfield prepare` makes, and that runs find it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = Path(__file__).parents[2] / "mjcf" / "scenes" / "phantom_am200.xml"


def begun(folder, *words, **variables):
    env = (
        os.environ | {"WARP_CACHE_PATH": str(folder / "kernels"), "PALMFIELD_CACHE": str(folder / "cache")} | variables
    )
    line = [sys.executable, "-m", "palmfield", *map(str, words)]
    return subprocess.Popen(line, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)


def done(folder, *words, **variables):
    process = begun(folder, *words, **variables)
    said, errors = process.communicate()
    assert process.returncode == 0, errors
    return said, errors


def compiled(folder):
    return {path.name for path in folder.rglob("*.o")}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A folder in which two processes have prepared all kernels at once, and what they said."""
    folder = tmp_path_factory.mktemp("prepared")
    both = [begun(folder, "prepare", "--kernels") for _ in range(2)]
    return folder, sorted(process.communicate()[0] for process in both)


def test_two_at_once_compile_once(prepared):
    folder, (second, first) = prepared
    assert first.startswith(f"compiled {len(compiled(folder))} kernel modules and stored 0 cache entries")
    assert second == "all data are already in the cache\n"


def test_a_prepared_scene_makes_nothing_again_and_its_run_compiles_nothing(prepared):
    folder, _ = prepared
    before = compiled(folder)
    said, _ = done(folder, "prepare", SCENE)
    assert "compiled 0 kernel modules" in said and "known-load-" in said
    assert done(folder, "prepare", SCENE)[0] == "all data are already in the cache\n"
    done(folder, "run", SCENE, "--out", folder / "out", "--duration", "0.002")
    assert compiled(folder) == before and (folder / "out" / "scene.png").exists()


def test_a_cache_that_cannot_be_written_is_said(prepared):
    said, errors = done(prepared[0], "prepare", SCENE, PALMFIELD_CACHE="/dev/null/cache")
    assert "continuing without a cache" in errors and "already in the cache" in said


def test_something_is_to_be_prepared(tmp_path):
    process = begun(tmp_path, "prepare")
    _, errors = process.communicate()
    assert process.returncode == 2 and "needs a scene or --kernels" in errors
