"""The share of the issue ceiling in scripts/check_gpu.py belongs to the kernels that were counted, and to no others."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from palmfield.studies.bench.processes import ROOT


@pytest.fixture
def check_gpu() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_gpu", ROOT / "scripts" / "check_gpu.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_counts_are_dropped_when_the_kernels_change(
    check_gpu: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_gpu, "COUNTED", check_gpu.digest())
    assert check_gpu.counted()
    assert "1.22 T pairs/s, or 0.67 T pairs/s with the gradient" in check_gpu.ceilings(30e12)
    (tmp_path / "warp_kernels").mkdir()
    for name in check_gpu.KERNELS:
        source = (ROOT / "warp_kernels" / name).read_bytes()
        (tmp_path / "warp_kernels" / name).write_bytes(source + b"\n")
    monkeypatch.setattr(check_gpu, "ROOT", tmp_path)
    assert not check_gpu.counted()
    assert "of these kernels were not counted" in check_gpu.ceilings(30e12)
    assert "instructions, or" not in check_gpu.ceilings(30e12)
