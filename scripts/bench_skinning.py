"""Measure the time of skinning a hand, and of copying its vertices in NumPy; writes docs/bench/skinning.md.

python scripts/bench_skinning.py [--device cuda:0]
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp

from palmfield.device import resolve
from palmfield.hand.articulated import bone_poses
from palmfield.hand.poses import named_pose, posed_surface
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[1]
EDGE_m = 0.00173
"""Edge length [m] with which the hand of the median man has about 17 000 vertices."""


def median_ms(run: Callable[[], object], repeats: int = 5, inner: int = 20) -> float:
    """Return the median over `repeats` of the mean time of `inner` runs [ms]."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(inner):
            run()
        times.append((time.perf_counter() - start) / inner)
    return 1e3 * statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "skinning.md")
    args = parser.parse_args()
    device = resolve(args.device)
    preset = load_preset("open_men_p50")
    SkinnedHand(preset, EDGE_m)
    start = time.perf_counter()
    hand = SkinnedHand(preset, EDGE_m, device)
    made_s = time.perf_counter() - start
    pose = named_pose(hand.hand, "pinch")
    bones = bone_poses(hand.hand, pose)

    def skin() -> None:
        hand.pose(*bones)
        wp.synchronize_device(device)

    order = np.argsort(-hand.weights, axis=1)[:, :4]
    shares, rest = np.take_along_axis(hand.weights, order, axis=1), hand.surface.vertices
    shifts = bones[0] - np.einsum("bij,bj->bi", bones[1], np.array([bone.origin for bone in hand.hand.bones]))

    def skin_in_numpy() -> np.ndarray:
        turns = np.einsum("nk,nkij->nij", shares, bones[1][order])
        return np.einsum("nij,nj->ni", turns, rest) + np.einsum("nk,nki->ni", shares, shifts[order])

    apart = float(np.abs(skin_in_numpy() - hand.posed(*bones)).max())
    rows = {
        "vertices and normals, not copied from the device": median_ms(skin),
        "only vertices, as a NumPy array (`posed`)": median_ms(lambda: hand.posed(*bones)),
        "bones from joint angles (`bone_poses`)": median_ms(lambda: bone_poses(hand.hand, pose)),
        f"for comparison: only vertices, in NumPy with float64 (positions differ by {1e9 * apart:.0f} nm)": median_ms(
            skin_in_numpy, 5, 5
        ),
        "for comparison: copy of the vertices in NumPy": median_ms(hand.surface.vertices.copy),
        "check of the skin for self-intersections (`posed_surface`)": median_ms(
            lambda: posed_surface(hand, pose), 5, 1
        ),
        "making a `SkinnedHand` from a cached mesh, once": 1e3 * made_s,
    }
    where = wp.get_device(device).name if device != "cpu" else f"{processor()}, {os.cpu_count()} cores seen, one used"
    lines = [
        "# Skinning a hand",
        "",
        "For developers. Skinning moves the vertices of a hand with its bones. `python scripts/bench_skinning.py "
        f"--device {args.device}`, {where}, commit {git_commit()}. The hand has {len(hand.surface.vertices)} vertices, "
        f"{len(hand.surface.faces)} faces and {len(hand.hand.bones)} bones, with at most four bones per vertex. It is "
        "computed in float32. Times are medians of 5 calls.",
        "",
        "| work | time [ms] |",
        "|---|---|",
        *(f"| {name} | {value:.3f} |" for name, value in rows.items()),
    ]
    text = "\n".join([*lines, ""])
    print(text)
    args.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
