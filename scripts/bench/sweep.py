"""Measure the cost of a sweep of 1,000 stimuli on one palm, of the whole sweep or of a sample of its points.

    python scripts/bench/sweep.py [--points 1000] [--workers 2]
    python scripts/bench/sweep.py --sample 64 [--profile FILE]

The points are Sobol points of `palm_am200`: a focus within 10 mm, the modulation depth, 50 to 300 Hz. The first form
runs the sweep with its workers and prints the wall time; modes come from the cache, or the first worker makes them. The
second form computes a sample in this process, in batches as a worker does. It prints processor times and the predicted
time of all points: the first batch, which loads or makes the modes, once for each worker, the others per point.
"""

import argparse
import cProfile
import tempfile
import time
from pathlib import Path

from palmfield import threads
from palmfield.studies import sweeps
from palmfield.studies.bench.table import processor
from palmfield.studies.sweeps.batch import MOST_IN_BATCH, Failed, Task, run_batch
from palmfield.studies.sweeps.design import Range
from palmfield.studies.sweeps.groups import groups_of
from palmfield.studies.sweeps.keys import scene_keys
from palmfield.studies.sweeps.overview import overview
from palmfield.studies.sweeps.whole_sweep import _Points

SCENE = Path(__file__).resolve().parents[2] / "mjcf/scenes/palm_am200.xml"
DURATION_S = 0.1
RANGES = {
    "stimulus.focus_m[0]": Range(-0.01, 0.01),
    "stimulus.focus_m[1]": Range(-0.01, 0.01),
    "stimulus.am_depth": Range(0.2, 1.0),
    "stimulus.am_frequency_Hz": Range(50.0, 300.0),
}


def sample(design: sweeps.Design, count: int, workers: int, profile: Path | None) -> None:
    """Compute `count` points as one worker does, and print the predicted time of all points on `workers` cores."""
    marks = [time.process_time()]
    keys = scene_keys(SCENE, design, {})
    view = overview(SCENE, design, keys, device=None, accuracy=None, duration_s=DURATION_S)
    groups = groups_of(SCENE, design, keys, None, None)
    points = _Points(range(design.count), groups, design, keys, MOST_IN_BATCH)
    task = Task(SCENE, None, None, DURATION_S, view.times, False, 1)
    marks.append(time.process_time())
    print(f"groups: {len(groups)}, {marks[1] - marks[0]:.1f} CPU s")
    numbers = [number for batch in points.batches(workers) for number in batch.points][:count]
    size = len(points.batches(workers)[0].points)
    profiler = cProfile.Profile()
    for start in range(0, count, size):
        part = numbers[start : start + size]
        if start and profile:
            profiler.enable()
        group = points.group(part[0])
        results = run_batch(task, group.base, group.shared, [points.point(number) for number in part])
        profiler.disable()
        for number, result in zip(part, results, strict=True):
            if isinstance(result, Failed):
                raise SystemExit(f"point {number}: {result.reason}")
        marks.append(time.process_time())
        print(f"batch of {len(part)}: {marks[-1] - marks[-2]:.2f} CPU s", flush=True)
    if profile:
        profiler.dump_stats(profile)
    point_s = (marks[-1] - marks[2]) / (count - size)
    whole = marks[1] + (marks[2] - marks[1]) * workers + point_s * (design.count - size * workers)
    print(f"{point_s:.3f} CPU s a point; about {whole / workers:.0f} s for {design.count} points on {workers} cores")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--sample", type=int, help="number of points computed in this process")
    parser.add_argument("--profile", type=Path, help="with --sample: file for the profile of later batches")
    options = parser.parse_args()
    print(f"{processor()}, {threads.cores()} cores")
    design = sweeps.sobol(RANGES, options.points)
    if options.sample:
        sample(design, options.sample, options.workers, options.profile)
        return
    with tempfile.TemporaryDirectory() as out:
        began = time.perf_counter()
        done = sweeps.sweep(SCENE, design, out, workers=options.workers, duration_s=DURATION_S, yes=True)
        wall = time.perf_counter() - began
    print(f"{done.done} of {done.points} points in {wall:.0f} s")


if __name__ == "__main__":
    main()
