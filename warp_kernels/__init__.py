"""Warp kernels and device functions. This package imports warp but not palmfield."""

from typing import Any

EXACT: dict[str, Any] = {"enable_backward": False, "cpu_compiler_flags": "-march=native"}
"""Options where each product and sum is rounded. On the CPU Warp parses its headers once for each set of flags (1.1 s).
Its own flags inline more: the same bits took up to five times as long to compile, and a sixth less to draw pictures."""
FUSED = EXACT | {"max_unroll": 1, "cpu_compiler_flags": "-march=native -ffp-contract=fast"}
"""Options where LLVM may fuse multiply and add across Warp's calls, and vectorise loops, which Warp leaves rolled."""
