"""The share of the issue ceiling in scripts/check_gpu.py belongs to the kernels that were counted, and to no others."""

import hashlib
import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from palmfield.bench.processes import ROOT


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
    source = (ROOT / "warp_kernels" / "pressure.py").read_bytes()
    monkeypatch.setattr(check_gpu, "COUNTED", hashlib.sha256(source).hexdigest()[:12])
    assert check_gpu.counted()
    assert "A pair takes 25.5 instructions, with gradient 48.7: at most 1.18 and 0.62 T pairs/s." in (
        check_gpu.ceilings(30e12)
    )
    kernels = tmp_path / "warp_kernels" / "pressure.py"
    kernels.parent.mkdir()
    kernels.write_bytes(source + b"\n")
    monkeypatch.setattr(check_gpu, "ROOT", tmp_path)
    assert not check_gpu.counted()
    assert "were not counted for these kernels" in check_gpu.ceilings(30e12)
    assert "25.5" not in check_gpu.ceilings(30e12)
