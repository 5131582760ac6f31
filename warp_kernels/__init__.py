"""Warp kernels and device functions. This package imports warp but not palmfield."""

from typing import Any

EXACT: dict[str, Any] = {"enable_backward": False, "cpu_compiler_flags": "-march=native"}
"""Options that round each product and sum. On the CPU Warp parses its headers once for each set of flags (1.1 s).
Default flags inline more: compilation took up to five times as long, and pictures a sixth less, with equal bits."""
FUSED = EXACT | {"max_unroll": 1, "cpu_compiler_flags": "-march=native -ffp-contract=fast"}
"""Options with which LLVM may fuse multiply and add across calls of Warp and vectorise loops, which stay rolled."""
