"""Compilation of Warp's kernels in threads."""

import errno
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import filelock
import numpy as np
import pytest
import warp as wp

import palmfield
from palmfield import device
from warp_kernels import EXACT, mesh_query

SCENE = str(Path(palmfield.__file__).parents[1] / "mjcf" / "scenes" / "palm_am200.xml")


def kernel_of_its_own(name, native="out.data[0] = 3;"):
    """A kernel that no cache holds, in a module of its own."""

    @wp.func_native(f"// {name} {time.time_ns()}\n{native}")
    def write(out: wp.array(dtype=wp.int32)): ...

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(out: wp.array(dtype=wp.int32)):
        write(out)

    return kernel


@pytest.fixture
def usual_folder(tmp_path, monkeypatch):
    """A folder for kernels of this test; the present one is restored."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setenv(device.KERNELS, str(tmp_path))
    return tmp_path


def compilations(monkeypatch):
    """The folders in which kernels are compiled from now on."""
    tried, build = [], wp._src.build.build_cpu

    def noted(path, *words, **options):
        tried.append(Path(path))
        return build(path, *words, **options)

    monkeypatch.setattr(wp._src.build, "build_cpu", noted)
    return tried


def no_room(monkeypatch, number, *folders):
    """No file can be written in these folders, whatever free space their disk states."""
    plain = Path.write_bytes

    def write_bytes(path, data):
        if set(folders) & set(path.parents):
            raise OSError(number, os.strerror(number))
        return plain(path, data)

    monkeypatch.setattr(device.Path, "write_bytes", write_bytes)


def launched(name):
    out = wp.zeros(1, dtype=wp.int32, device="cpu")
    device.run_kernel(kernel_of_its_own(name), 1, [], [out], device="cpu")
    return out.numpy()[0]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_kernels_that_cannot_be_stored_are_compiled_elsewhere(number, usual_folder, monkeypatch, caplog):
    tried = compilations(monkeypatch)
    no_room(monkeypatch, number, usual_folder)
    assert launched("full") == launched("full too") == 3
    assert [usual_folder in path.parents for path in tried] == [False, False]
    (line,) = caplog.messages
    assert f"folder {usual_folder} for compiled kernels is not writable ({os.strerror(number)})" in line
    assert "each run compiles them again; set WARP_CACHE_PATH to a writable folder with free space" in line
    assert os.environ[device.KERNELS] == wp.config.kernel_cache_dir != str(usual_folder)
    assert not list(usual_folder.iterdir())


def test_without_room_for_a_temporary_folder_the_error_says_so(usual_folder, monkeypatch):
    no_room(monkeypatch, errno.ENOSPC, Path("/"))
    with pytest.raises(
        palmfield.PalmfieldError, match=r"is not writable \(No space.*, nor is a temporary folder.*; set"
    ):
        launched("full")


def test_kernels_are_read_from_a_folder_that_takes_no_more(usual_folder, monkeypatch):
    module = kernel_of_its_own("stored").module
    device.load_kernels(module, "cpu")
    (name,) = os.listdir(usual_folder)
    assert device.absent.count(name) == 1
    tried = compilations(monkeypatch)
    no_room(monkeypatch, errno.EROFS, usual_folder)
    module.unload()
    device._load(module, "cpu", 1)
    assert device.absent.count(name) == 1
    assert tried == [] and wp.config.kernel_cache_dir == str(usual_folder)


def test_two_processes_at_once_compile_a_module_once(tmp_path):
    code = f"""
import os, time
from pathlib import Path
import warp as wp
from palmfield import device
from warp_kernels import mesh_query
folder, build = Path({str(tmp_path)!r}), wp._src.build.build_cpu
def noted(*words, **options):
    with open(folder / "builds", "a") as file:
        file.write("one ")
    while len(list(folder.glob("begun-*"))) < 2:
        time.sleep(0.01)
    return build(*words, **options)
wp._src.build.build_cpu = noted
(folder / f"begun-{{os.getpid()}}").touch()
device.load_kernels(mesh_query, "cpu")
print(mesh_query.__name__)
"""
    environment = os.environ | {device.KERNELS: str(tmp_path / "kernels")}
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert [process.communicate()[0] for process in both] == ["warp_kernels.mesh_query\n"] * 2
    assert (tmp_path / "builds").read_text() == "one "
    assert not list(tmp_path.rglob("*.lock"))


def test_a_process_that_ends_does_not_wait_for_the_compiler_of_another(tmp_path):
    name = wp.get_module(mesh_query.__name__).get_module_identifier(block_dim=1)
    (tmp_path / wp.__version__).mkdir()
    code = "from palmfield import device\nfrom warp_kernels import mesh_query\ndevice.load_ahead([mesh_query], 'cpu')"
    code += "\nwhile not device.absent: pass"
    with filelock.FileLock(tmp_path / wp.__version__ / f"{name}.lock"):
        assert run(code, tmp_path).returncode == 0
    assert not list(tmp_path.rglob("*.o"))


def test_kernels_of_another_processor_compiler_or_warp_are_not_used(usual_folder, monkeypatch):
    tried, module = compilations(monkeypatch), kernel_of_its_own("made before").module
    module.options |= EXACT

    def compiled():
        module.unload()
        wp.load_module(module, device="cpu")
        return len(tried)

    assert [compiled(), compiled()] == [1, 1]
    for name, value in (("_get_cpu_feature_set", {"other"}), ("_get_cpu_toolchain_version", "0")):
        with monkeypatch.context() as other:
            other.setattr(wp._src.context, name, lambda value=value: value)
            before = compiled()
            assert before == len(tried) == compiled()
    assert [compiled(), len(tried)] == [3, 3]
    code = "import warp as wp, palmfield.device; print(wp.config.kernel_cache_dir)"
    assert run(code, usual_folder).stdout == f"{usual_folder / wp.__version__}\n"


def test_a_module_loaded_ahead_is_compiled_once_and_not_by_the_caller(monkeypatch):
    kernel, out, compiled = kernel_of_its_own("ahead"), wp.zeros(1, dtype=wp.int32, device="cpu"), []
    build = wp._src.build.build_cpu

    def noted(*words, **options):
        compiled.append(threading.current_thread())
        return build(*words, **options)

    monkeypatch.setattr(wp._src.build, "build_cpu", noted)
    device.load_ahead([kernel.module], "cpu")
    device.run_kernel(kernel, 1, [out], device="cpu")
    device.recorded(kernel, 1, [out], "cpu")()
    assert out.numpy()[0] == 3
    assert [thread.name for thread in compiled] == ["palmfield-kernels"]


def test_what_the_compiler_raises_comes_where_the_kernel_is_launched(capfd):
    kernel, out = kernel_of_its_own("bad", "this is no C;"), wp.zeros(1, dtype=wp.int32, device="cpu")
    device.load_ahead([kernel.module], "cpu")
    for _ in range(2):
        with pytest.raises(Exception, match="CPU kernel build failed"):
            device.run_kernel(kernel, 1, [out], device="cpu")
    good = kernel_of_its_own("good")
    device.run_kernel(good, 1, [out], device="cpu")
    assert out.numpy()[0] == 3
    assert "error" in capfd.readouterr().err


def test_what_is_waited_for_comes_next(monkeypatch):
    loaded, begun, go, load = [], threading.Event(), threading.Event(), wp.load_module

    def slow(module, **options):
        begun.set()
        assert go.wait(60.0)
        loaded.append(module)
        return load(module, **options)

    monkeypatch.setattr(wp, "load_module", slow)
    modules = [kernel_of_its_own(f"turn {i}").module for i in range(4)]
    device.load_ahead(modules, "cpu")
    assert begun.wait(60.0)
    waiting = threading.Thread(target=device.load_kernels, args=(modules[3], "cpu"))
    waiting.start()
    waits = device._load_of(modules[0], "cpu", 1)[0].waiting
    until = time.monotonic() + 30.0
    while waits[0][1].args[0] is not modules[3] and time.monotonic() < until:
        time.sleep(0.001)
    go.set()
    waiting.join(60.0)
    assert loaded.index(modules[3]) == 1


def run(code, folder):
    env = os.environ | {"WARP_CACHE_PATH": str(folder), "PALMFIELD_CACHE": "off"}
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)


def test_the_kernels_loaded_ahead_for_a_scene_are_launched(tmp_path):
    code = f"""
import warp as wp, palmfield
from palmfield import device
from palmfield.simulation import build
ahead, launched, load, launch = set(), set(), device.load_ahead, wp.launch
def noted(modules, where):
    ahead.update(m if isinstance(m, wp.Module) else wp.get_module(m.__name__) for m in modules)
    load(modules, where)
def seen(kernel, *words, **options):
    launched.add(kernel.module)
    return launch(kernel, *words, **options)
wp.launch = seen
import palmfield.skin.fem.assembly
build.load_ahead = palmfield.skin.fem.assembly.load_ahead = noted
palmfield.Simulation({SCENE!r}).run(0.001)
print(len(ahead), sorted(module.name for module in ahead - launched))
"""
    told = run(code, tmp_path)
    assert told.returncode == 0, told.stderr
    assert told.stdout.splitlines()[-1] == "7 []"


def test_a_process_that_ends_waits_for_the_compiler_alone(tmp_path):
    began = time.perf_counter()
    told = run(
        "from palmfield import device\nfrom warp_kernels import bem, mesh_query, transfer, wedge, selfcross, skinning\n"
        "device.load_ahead([mesh_query, transfer, wedge, selfcross, skinning, bem], 'cpu')",
        tmp_path,
    )
    assert (told.returncode, told.stderr) == (0, "")
    assert len(list(tmp_path.rglob("*.o"))) <= 2, time.perf_counter() - began


def test_kernels_are_launched_where_modules_are_loaded_in_threads():
    """A launch by Warp itself would compile a second time what a thread compiles, with headers of its own."""
    root = Path(palmfield.__file__).parent
    found = [path for path in root.rglob("*.py") if "wp.launch(" in path.read_text()]
    assert found == [root / "device.py"]


def test_a_forked_process_loads_kernels():
    kernel, out = kernel_of_its_own("fork"), wp.zeros(1, dtype=wp.int32, device="cpu")
    device.load_kernels(kernel_of_its_own("before").module, "cpu")
    child = os.fork()
    if child == 0:
        status = 1
        try:
            device.run_kernel(kernel, 1, [out], device="cpu")
            status = int(not np.array_equal(out.numpy(), [3]))
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
