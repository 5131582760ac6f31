"""Loading a scene and stepping it leave BLAS threads alone, which wait for each other on small products."""

import subprocess
import sys

import pytest

RUN = """
import os, time
import numpy, scipy.linalg
from threadpoolctl import ThreadpoolController

for library in ThreadpoolController().lib_controllers:
    library.set_num_threads(8)
square = numpy.ones((800, 800))
square @ square
scipy.linalg.blas.dgemm(1.0, square, square)
own = [task for task in os.listdir("/proc/self/task") if task != str(os.getpid())]

def worked_s():
    return sum(int(open(f"/proc/self/task/{task}/schedstat").read().split()[0]) for task in own) / 1e9

last = -1.0
while worked_s() > last:  # threads turn for a while after their last product
    last = worked_s()
    time.sleep(0.3)

import palmfield
from palmfield.data import folder

spent = [worked_s()]
keys = {"skin.accuracy": 0.5, "skin.max_frequency_Hz": 300}
sim = palmfield.load(folder("mjcf") / "scenes" / "hover_explore.xml", keys=keys, device="cpu")
spent.append(worked_s())
for count in (1, 20):
    sim.step(count)
    spent.append(worked_s())
print(len(own), *numpy.diff(spent))
"""
MOST_s = 0.1


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what each thread has worked")
def test_no_blas_thread_works_in_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALMFIELD_CACHE", "off")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "8")
    run = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=True)
    threads, *spent_s = map(float, run.stdout.split())
    assert threads >= 7
    assert max(spent_s) < MOST_s
