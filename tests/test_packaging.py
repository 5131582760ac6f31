"""Both distributions as users get them: a wheel, an editable install, an sdist; and the scripts on a bare Python."""

import email
import email.message
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

CLONE = Path(__file__).resolve().parents[1]
SOURCES = ("palmfield", "warp_kernels", "mjcf", "hand_models", "papers")
FILES = (
    "pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff",
    "CONTRIBUTING.md",
)  # fmt: skip
MOST_MB = 1050
"""Of a plain install without the interpreter's compiled files, which make it 1.2 GB."""
TOLERANCES = CLONE / "docs" / "gallery" / "tolerances.toml"
TELL = """
import palmfield.data
print(palmfield.data.__file__)
for name in ("mjcf", "hand_models"):
    print(palmfield.data.folder(name))
import warp_kernels
print(warp_kernels.__file__)
"""


def linked() -> list[Path]:
    """Files of the clone that the folder of the papers links to."""
    return [path.resolve() for path in (CLONE / "papers").rglob("*") if path.is_symlink()]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of the clone, so that building leaves nothing in the clone and finds nothing left from earlier builds."""
    copy = tmp_path_factory.mktemp("source") / "palmfield"
    copy.mkdir()
    for name in SOURCES:
        left = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
        shutil.copytree(CLONE / name, copy / name, symlinks=True, ignore=left)
    for name in (*FILES, *(str(path.relative_to(CLONE)) for path in linked())):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(CLONE / name, copy / name)
    (copy / "tests").mkdir()
    (copy / "tests" / "test_one.py").touch()
    return copy


def python(*arguments, cwd, path=None) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    done = subprocess.run([sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build(kind: str, source: Path, out: Path) -> Path:
    """What a front end makes of the source by its build backend: `wheel`, `editable` or `sdist`."""
    out.mkdir()
    python("-c", f"import setuptools.build_meta as b; b.build_{kind}({str(out)!r})", cwd=source)
    (built,) = out.iterdir()
    return built


def install(wheel: Path, site: Path) -> None:
    python(
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-compile",
        "--target",
        str(site),
        str(wheel),
        cwd=site.parent,
    )


def tree(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def wheel_of(source: Path, out: Path) -> Path:
    """As pip makes it."""
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(out))
    python("-m", "pip", "wheel", *options, str(source), cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory):
    return wheel_of(source, tmp_path_factory.mktemp("wheels"))


@pytest.fixture(scope="module")
def papers_wheel(source, tmp_path_factory):
    return wheel_of(source / "papers", tmp_path_factory.mktemp("wheels"))


def test_the_wheel_finds_its_data_without_the_clone(wheel, tmp_path):
    site = tmp_path / "site"
    install(wheel, site)
    told = python("-c", TELL, cwd=tmp_path, path=site).splitlines()
    assert told == [
        str(site / "palmfield" / "data.py"),
        str(site / "palmfield" / "_data" / "mjcf"),
        str(site / "palmfield" / "_data" / "hand_models"),
        str(site / "warp_kernels" / "__init__.py"),
    ]
    for name in ("mjcf", "hand_models"):
        assert tree(site / "palmfield" / "_data" / name) == tree(CLONE / name)
        assert tree(CLONE / name)


def test_the_wheel_holds_the_packages_the_licence_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = archive.read(next(name for name in names if name.endswith("METADATA"))).decode()
        entry_points = archive.read(next(name for name in names if name.endswith("entry_points.txt"))).decode()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"palmfield", "warp_kernels"}
    assert not any(
        part in name for name in names for part in ("tests", "scripts", "peers", "numba", "papers", "tolerances")
    )
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert "License-Expression: Apache-2.0" in metadata
    assert "palmfield = palmfield.cli.app:start" in entry_points
    assert "[mujoco.plugins]" in entry_points
    assert "palmfield/py.typed" in names
    modules = {name for name in names if name.endswith(".py")}
    assert modules == {
        str(path.relative_to(CLONE))
        for package in ("palmfield", "warp_kernels")
        for path in (CLONE / package).rglob("*.py")
    }


def test_the_wheel_of_the_papers_holds_their_package_and_the_tolerances(papers_wheel):
    with zipfile.ZipFile(papers_wheel) as archive:
        names = archive.namelist()
        entry_points = archive.read(next(name for name in names if name.endswith("entry_points.txt"))).decode()
        licence = archive.read(next(name for name in names if name.endswith("licenses/LICENSE")))
        assert archive.read("palmfield_papers/tolerances.toml") == TOLERANCES.read_bytes()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"palmfield_papers"}
    assert licence == (CLONE / "LICENSE").read_bytes()
    assert entry_points.split() == ["[palmfield.commands]", "papers", "=", "palmfield_papers.cli:papers"]
    told = metadata_of(papers_wheel)
    assert told["Name"] == "palmfield-papers" and told["License-Expression"] == "Apache-2.0"
    assert f"palmfield=={told['Version']}" in told.get_all("Requires-Dist")
    assert all(link.startswith("http") for link in links(told.get_payload(decode=True).decode()))
    package = CLONE / "papers" / "palmfield_papers"
    modules = {str(path.relative_to(package.parent)) for path in package.rglob("*.py")}
    assert {name for name in names if "/" in name and "dist-info" not in name} == {
        *modules, "palmfield_papers/py.typed", "palmfield_papers/tolerances.toml",
    }  # fmt: skip


def links(markdown: str) -> list[str]:
    """Where the links and pictures of a page lead."""
    html = MarkdownIt("commonmark").enable("table").render(markdown)
    return re.findall(r'(?:href|src)="([^"]*)"', html)


def metadata_of(wheel: Path) -> email.message.Message:
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith("METADATA"))
        return email.message_from_bytes(archive.read(name))


def test_the_description_leads_nowhere_beside_the_repository(wheel):
    """PyPI shows it on a page of its own, where a relative picture is a broken one."""
    told = metadata_of(wheel)
    text = told.get_payload(decode=True).decode()
    readme = (CLONE / "README.md").read_text()
    assert told["Description-Content-Type"] == "text/markdown"
    assert [link for link in links(readme) if not link.startswith("http")], "README.md leads beside itself"
    assert all(link.startswith("http") for link in links(text))
    for kept in (r"^#+ .*$", r"```.*?```", r"^\| `"):
        flags = re.DOTALL | re.MULTILINE if "```" in kept else re.MULTILINE
        assert re.findall(kept, text, flags) == re.findall(kept, readme, flags)
    assert "![" not in text and "](docs" not in text


def test_with_a_public_address_the_description_has_its_pictures(monkeypatch):
    monkeypatch.syspath_prepend(str(CLONE))
    spec = importlib.util.spec_from_file_location("palmfield_setup", CLONE / "setup.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = "![a hand](docs/a.png)\n\nsee [there](docs/a.md#b) and [PyPI](https://pypi.org)\n```\n[x](y)\n```\n"
    assert module.described(page, "https://example.org/palmfield/") == (
        "![a hand](https://example.org/palmfield/raw/HEAD/docs/a.png)\n\nsee "
        "[there](https://example.org/palmfield/blob/HEAD/docs/a.md#b) and [PyPI](https://pypi.org)\n```\n[x](y)\n```\n"
    )
    assert module.described(page, None) == "see there and [PyPI](https://pypi.org)\n```\n[x](y)\n```\n"


def test_what_pypi_shows_beside_the_description(wheel):
    told = metadata_of(wheel)
    assert told["Summary"] and len(told["Keywords"].split(",")) > 5
    classifiers = told.get_all("Classifier")
    assert "Operating System :: POSIX :: Linux" in classifiers and not any("License ::" in one for one in classifiers)
    cited = (CLONE / "CITATION.cff").read_text()
    assert f"version: {told['Version']}\n" in cited and f"license: {told['License-Expression']}\n" in cited


@pytest.mark.slow
def test_the_demo_runs_from_a_plain_install_elsewhere(wheel, papers_wheel, tmp_path):
    """An environment with nothing in it but what the wheel asks for, in a folder that is not the clone."""
    python("-m", "venv", "there", cwd=tmp_path)
    own = tmp_path / "there" / "bin"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def run(*command: object, code: int = 0) -> str:
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900)
        assert done.returncode == code, done.stdout[-2000:] + done.stderr[-3000:]
        return done.stdout if code == 0 else done.stderr

    run(own / "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", wheel)
    site = Path(run(own / "python", "-c", "import palmfield; print(palmfield.__path__[0])").strip()).parent
    assert site.is_relative_to(tmp_path)
    files = [path for path in site.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    size_MB = sum(path.stat().st_size for path in files) / 1e6
    assert size_MB <= MOST_MB
    # The demo's scene, briefly and on a small patch: what it shows is that nothing is missing, neither data nor
    # dependencies
    scene = site / "palmfield" / "_data" / "mjcf" / "scenes" / "palm_am200.xml"
    small = ("--accuracy", "0.5", "--set", "skin.patch_radius_m=0.02")
    told = run(own / "palmfield", "run", scene, "--out", "out", *small, "--duration", "0.005")
    assert "displacement" in told
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"result.nc", "summary.json", "scene.usdc", "pressure.png", "displacement.png", "scene.png"} <= names
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["peak_displacement_m"] > 1e-7
    # The papers are not there until they are installed too, which brings nothing else
    assert run(own / "palmfield", "papers", "--only", "M7a", code=2).endswith(": pip install palmfield-papers\n")
    run(own / "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", "--no-index", papers_wheel)
    assert json.loads(run(own / "palmfield", "papers", "--only", "M7a", "--quick", "--json"))["M7a"]["verdict"]


def test_building_leaves_no_data_in_the_source_tree(wheel, source):
    assert not (source / "palmfield" / "_data").exists()


def test_a_second_build_drops_data_that_is_gone(source, tmp_path):
    again = tmp_path / "source"
    shutil.copytree(source, again, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    (again / "mjcf" / "passing.xml").write_text("<mujoco/>")
    names = []
    for number in (1, 2):
        with zipfile.ZipFile(build("wheel", again, tmp_path / str(number))) as archive:
            names.append("palmfield/_data/mjcf/passing.xml" in archive.namelist())
        (again / "mjcf" / "passing.xml").unlink(missing_ok=True)
    assert names == [True, False]


def test_an_editable_install_finds_the_data_beside_its_source(source, tmp_path):
    site = tmp_path / "site"
    install(build("editable", source, tmp_path / "out"), site)
    # Without -S the interpreter of the tests would find its own editable install of the clone first.
    told = python("-S", "-c", f"import site; site.addsitedir({str(site)!r}){TELL}", cwd=tmp_path).splitlines()
    assert told == [
        str(source / "palmfield" / "data.py"),
        str(source / "mjcf"),
        str(source / "hand_models"),
        str(source / "warp_kernels" / "__init__.py"),
    ]


def test_an_editable_install_of_the_papers_reads_the_gallerys_tolerances(source, tmp_path):
    site = tmp_path / "site"
    install(build("editable", source / "papers", tmp_path / "out"), site)
    tell = "import palmfield_papers; print(palmfield_papers.__path__[0])"
    (told,) = python("-S", "-c", f"import site; site.addsitedir({str(site)!r}); {tell}", cwd=tmp_path).splitlines()
    assert Path(told) == source / "papers" / "palmfield_papers"
    assert (Path(told) / "tolerances.toml").resolve() == source / "docs" / "gallery" / "tolerances.toml"


def unpacked(sdist: Path, folder: Path) -> Path:
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (there,) = (path for path in folder.iterdir() if path.name.startswith("palmfield") and path.is_dir())
    return there


@pytest.mark.parametrize("distribution", ["palmfield", "papers"])
def test_the_sdist_can_build_the_same_wheel(distribution, source, wheel, papers_wheel, tmp_path):
    of, own = {"palmfield": (source, wheel), "papers": (source / "papers", papers_wheel)}[distribution]
    there = unpacked(build("sdist", of, tmp_path / "sdist"), tmp_path)
    assert not (there / "tests").exists(), "some of the tests, without what they need"
    assert not (there / "papers").exists() and not any(path.is_symlink() for path in there.rglob("*"))
    with zipfile.ZipFile(build("wheel", there, tmp_path / "wheel")) as mine, zipfile.ZipFile(own) as first:
        assert sorted(mine.namelist()) == sorted(first.namelist())


def test_the_licence_is_the_whole_apache_licence():
    text = (CLONE / "LICENSE").read_text()
    assert "Version 2.0, January 2004" in text
    assert "9. Accepting Warranty or Additional Liability" in text
    assert "END OF TERMS AND CONDITIONS" in text


@pytest.mark.parametrize("script", ["demo.py", "test.py"])
def test_help_needs_no_packages(script, tmp_path):
    told = python("-I", "-S", str(CLONE / "scripts" / script), "--help", cwd=tmp_path)
    assert "passed on" in told
    assert ".venv" in told
    assert not any(tmp_path.iterdir())


def script(name, monkeypatch):
    monkeypatch.syspath_prepend(str(CLONE / "scripts"))
    spec = importlib.util.spec_from_file_location(f"palmfield_script_{name}", CLONE / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("extra", ["", "test"])
def test_an_environment_has_both_distributions_by_one_command(extra, monkeypatch, tmp_path):
    setup = script("_setup", monkeypatch)
    commands = []
    monkeypatch.setattr(setup, "run", lambda command, mend: commands.append([str(part) for part in command]))
    monkeypatch.setattr(setup, "make_venv", lambda venv: venv.mkdir())
    monkeypatch.setattr(setup, "has_pip", lambda python: True)
    monkeypatch.setattr(setup, "LOWEST_VENV", tmp_path / "lowest")
    for venv in (tmp_path / "venv", setup.LOWEST_VENV):
        setup.environment(extra, venv)
    assert len(commands) == 2
    for command in commands:
        assert command[-4:] == ["--editable", ".[test]" if extra else ".", "--editable", "./papers"]
    assert "--constraint" in commands[1] and "--constraint" not in commands[0]


def test_an_environment_is_as_old_as_either_declaration(monkeypatch, tmp_path):
    setup = script("_setup", monkeypatch)
    (tmp_path / "papers").mkdir()
    files = ("pyproject.toml", "setup.py", "papers/pyproject.toml")
    for name in files:
        shutil.copy(CLONE / name, tmp_path / name)
    monkeypatch.setattr(setup, "ROOT", tmp_path)
    seen = [setup.fingerprint()]
    for name in files:
        (tmp_path / name).write_text((tmp_path / name).read_text() + "\n")
        seen.append(setup.fingerprint())
    assert len(set(seen)) == 4


def test_lowest_versions_are_those_of_pyproject(monkeypatch, tmp_path, capsys):
    setup = script("_setup", monkeypatch)
    project = tomllib.loads((CLONE / "pyproject.toml").read_text())["project"]
    pins = setup.lowest()
    assert len(pins) == len(project["dependencies"])
    assert all(dep.startswith(pin.replace("==", ">=")) for dep, pin in zip(project["dependencies"], pins, strict=True))
    monkeypatch.setattr(setup, "ROOT", tmp_path)
    for dependency in ("numpy", "numpy>2", "numpy<3", "numpy==2.0"):
        (tmp_path / "pyproject.toml").write_text(f'[project]\ndependencies = ["{dependency}"]')
        with pytest.raises(SystemExit) as stopped:
            setup.lowest()
        assert stopped.value.code == 1 and f"'{dependency}' has no lowest version" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("machine", "own", "other"),
    [
        ("x86_64", "SkylakeX", "Haswell"),
        ("AMD64", "Haswell", "Nehalem"),
        ("x86_64", "Zen", "Nehalem"),
        ("x86_64", "Nehalem", "Prescott"),
        ("x86_64", None, None),
        ("arm64", "neoversen1", None),
    ],
)
def test_numerics_run_on_kernels_that_are_not_this_machines_own(machine, own, other, monkeypatch, capsys):
    test = script("test", monkeypatch)
    monkeypatch.setattr(test.platform, "machine", lambda: machine)

    def cores(_, **variables):
        return [name for name in [variables.get("OPENBLAS_CORETYPE", own)] if name]

    monkeypatch.setattr(test, "cores", cores)
    assert test.another_core(Path("python")) == other
    assert ("numerics run once only" in capsys.readouterr().out) == (other is None)


@pytest.mark.parametrize("failing", [None, "ruff", "mypy", "lint-imports", "smoke", "whole", "wall_clock", "numerics"])
def test_any_stage_that_fails_is_the_exit_status_and_the_last(failing, monkeypatch):
    test = script("test", monkeypatch)
    ran = []

    def run(_, tool, *options, **variables):
        marked = [name for name in ("smoke", "wall_clock", "numerics") if name in options]
        stage = tool if tool != "pytest" else marked[0] if marked else "whole"
        ran.append(stage)
        return 3 if stage == failing else 0

    monkeypatch.setattr(test, "run", run)
    monkeypatch.setattr(test, "another_core", lambda _: "Haswell")
    monkeypatch.setattr(test._setup, "environment", lambda *_: Path("python"))
    monkeypatch.setattr(test._setup, "OLDEST", sys.version_info[:2])
    monkeypatch.setattr(sys, "argv", ["test.py"])
    assert test.main() == (0 if failing is None else 3)
    stages = [["ruff"], ["ruff"], ["mypy", "lint-imports", "smoke"], ["whole"], ["wall_clock"], ["numerics"]]
    last = next((n for n, together in enumerate(stages) if failing in together), len(stages))
    expected = [one for together in stages[: last + 1] for one in together]
    # Mypy comes before lint-imports, and the smoke tests at the same time
    assert sorted(ran) == sorted(one for one in expected if (failing, one) != ("mypy", "lint-imports"))
    assert [one for one in ran if one not in stages[2]] == [one for one in expected if one not in stages[2]]
    monkeypatch.setattr(sys, "argv", ["test.py", "-k", "name"])
    ran.clear()
    assert test.main() == (3 if failing in ("ruff", "mypy", "lint-imports", "whole") else 0)
    assert "smoke" not in ran and "numerics" not in ran
    monkeypatch.setattr(sys, "argv", ["test.py", "--quick"])
    ran.clear()
    assert test.main() == (3 if failing in ("ruff", "whole") else 0)
    assert ran == ["ruff", "whole"][: 1 if failing == "ruff" else 2]


def test_ci_calls_the_test_script():
    run = CLONE / ".ci" / "run"
    assert os.access(run, os.X_OK)
    assert "set -euo pipefail" in run.read_text()
    assert "python3 scripts/test.py" in run.read_text()
