"""Measure the frame rate of the live view's page, and by how much it slows the simulation.

Intervals with the page and without it alternate in one run at full speed. Without it, the process of the page and its
client are stopped, so that they use no processor time. A client in its own process receives the pictures in place of a
browser. Writes docs/bench/view.md:

    python scripts/verification/check_view.py                        # the demo on the CPU
    python scripts/verification/check_view.py --device cuda:0        # and on a GPU: another table of the page
    python scripts/verification/check_view.py mjcf/scenes/hover_explore.xml --live     # a hand from another process
"""

import argparse
import math
import os
import platform
import signal
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from page_client import PageClient, is_picture

from palmfield.motion import live_hand
from palmfield.motion.tracking import write_stream
from palmfield.session.preview import preview
from palmfield.studies.bench.table import keep_rows
from palmfield.studies.trial.latency import scene_stream
from palmfield.studies.view.link import Link
from palmfield.studies.view.messages import Address, FromSimulation, Moment, Notice, Pace
from palmfield.studies.view.run import GPU_RATE_Hz, RATE_Hz, SceneSource, ShownScene

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "mjcf" / "scenes" / "palm_am200.xml"
PAGE = ROOT / "docs" / "bench" / "view.md"
WARM_s = 2.0


class Stretch(NamedTuple):
    """An interval of the measurement.

    steps_s: MuJoCo steps per second; cpu_us: processor time of the simulation per step; pictures_s: received pictures
    per second; page_share: share of a core that the process of the page uses; load: load of the machine over a minute
    """

    steps_s: float
    cpu_us: float
    page_share: float
    pictures_s: float
    load: float


class Measured(NamedTuple):
    """Intervals with the page and without it, alternating."""

    scene: str
    device: str
    rate_Hz: float
    shown: list[Stretch]
    alone: list[Stretch]

    @property
    def slower(self) -> float:
        """Return the median relative slow-down of an interval with the page from the previous one without it."""
        return 1.0 - statistics.median(a.steps_s / b.steps_s for a, b in zip(self.shown, self.alone, strict=True))

    @property
    def more_cpu(self) -> float:
        """Return the median relative increase of processor time per step with the page; other load affects it less."""
        return statistics.median(a.cpu_us / b.cpu_us for a, b in zip(self.shown, self.alone, strict=True)) - 1.0

    @property
    def pictures_s(self) -> float:
        return statistics.median(one.pictures_s for one in self.shown)


def count_pictures(address: str, talk: Connection) -> None:
    """Process of the client: sends its number of pictures on request, and at the end their times [s]."""
    with PageClient(address) as client:
        times: list[float] = []
        while True:
            pictures = sum(map(is_picture, client.received(0.05)))
            times += [time.monotonic()] * pictures
            if talk.poll():
                if talk.recv() == "end":
                    talk.send(times)
                    return
                talk.send(len(times))


def cpu_of(pid: int | None) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def requests_of(talk: Connection) -> int:
    """Return the number of pictures that the client has received."""
    talk.send("how many")
    count: int = talk.recv()
    return count


def measure(scene: Path, device: str | None, rate_Hz: float | None, stretches: int, stretch_s: float) -> Measured:
    """Step a scene with the page and without it, alternately."""
    sent: list[object] = []
    live = ShownScene(SceneSource(scene, device, None, None), {}, Path("out") / "view", sent.append)
    on = live.sim.runtime.spec.device
    rate = rate_Hz or (RATE_Hz if on == "cpu" else GPU_RATE_Hz)
    live.receive(Pace(math.inf))
    context = get_context("spawn")
    shown, alone = [], []
    with Link(Address("127.0.0.1", None, "", rate)) as link:
        live.send = lambda message: (
            sent.append(message) if isinstance(message, Notice) else None,
            link.send(message),
        )[1]
        live.show()
        talk, theirs = context.Pipe()
        client = context.Process(target=count_pictures, args=(link.address, theirs), daemon=True)
        client.start()
        others = [child for child in (link.pid, client.pid) if child]

        def steps(seconds: float, page: bool) -> Stretch:
            begun, began_s, began_cpu = live.sim.time, time.monotonic(), time.process_time()
            page_cpu, before = cpu_of(link.pid), requests_of(talk) if page else 0
            while time.monotonic() < began_s + seconds:
                if not page:
                    live.sim.step()
                    continue
                for message in link.received():
                    live.receive(message)
                live.go_on()
            took, cpu = time.monotonic() - began_s, time.process_time() - began_cpu
            count = max((live.sim.time - begun) / live.sim.model.opt.timestep, 1.0)
            pictures = (requests_of(talk) - before) / len(live.sim.skins) if page else 0
            own = (cpu_of(link.pid) - page_cpu) / took
            return Stretch(count / took, 1e6 * cpu / count, own, pictures / took, os.getloadavg()[0])

        steps(3.0 * WARM_s, True)
        for _ in range(stretches):
            while live.watching:
                live.go_on()
            for pid in others:
                os.kill(pid, signal.SIGSTOP)
            try:
                steps(0.5, False)
                alone.append(steps(stretch_s, False))
            finally:
                for pid in others:
                    os.kill(pid, signal.SIGCONT)
            steps(WARM_s, True)
            shown.append(steps(stretch_s, True))
            assert live.playing, sent
        talk.send("end")
        client.join(10.0)
    return Measured(scene.name, on, rate, shown, alone)


class Live(NamedTuple):
    """A view of a hand that another process sends.

    ages_s: age of the hand's pose when its picture is sent; ways_s: time from there to the client; speed: simulated
    seconds per second; pictures_s: pictures per second at the client
    """

    scene: str
    device: str
    rate_Hz: float
    speed: float
    pictures_s: float
    ages_s: list[float]
    ways_s: list[float]


def measure_live(scene: Path, device: str | None, rate_Hz: float | None, seconds: float) -> Live:
    """Step a scene in real time; another process sends its hand, with 90 samples a second of its script."""
    view = preview(scene, device="cpu")
    context = get_context("spawn")
    sent: list[tuple[float, float]] = []
    with TemporaryDirectory() as folder, ExitStack() as opened:
        file = Path(folder) / "hand.npz"
        write_stream(file, scene_stream(view, 90.0, 2.0 * view.duration_s))

        def begin(host: str, port: int) -> None:
            run = "from palmfield.cli.app import main; main()"
            words = ["track", "replay", str(file), "--to", f"{host}:{port}", "--repeat", "10000", "--stamp"]
            process = subprocess.Popen([sys.executable, "-c", run, *words], stdout=subprocess.DEVNULL)
            opened.callback(process.wait)
            opened.callback(process.kill)

        source = live_hand.Live(up="z", on_listening=begin)
        live = ShownScene(SceneSource(scene, device, None, None), {}, Path("out") / "view", lambda _: None, source)
        assert live.followed is not None
        opened.enter_context(live.followed)
        on = live.sim.runtime.spec.device
        rate = rate_Hz or (RATE_Hz if on == "cpu" else GPU_RATE_Hz)
        link = opened.enter_context(Link(Address("127.0.0.1", None, "", rate)))

        def send(message: FromSimulation) -> None:
            if isinstance(message, Moment) and message.hand_age_s is not None:
                sent.append((time.monotonic(), message.hand_age_s))
            link.send(message)

        live.send = send
        live.followed.wait(30.0)
        live.show()
        talk, theirs = context.Pipe()
        client = context.Process(target=count_pictures, args=(link.address, theirs), daemon=True)
        client.start()

        def steps(for_s: float) -> tuple[float, int]:
            began, begun = time.monotonic(), live.sim.time
            before = requests_of(talk)
            wait_s = 0.0
            while time.monotonic() < began + for_s:
                for message in link.received(wait_s):
                    live.receive(message)
                wait_s = live.go_on()
            return (live.sim.time - begun) / for_s, requests_of(talk) - before

        steps(3.0 * WARM_s)
        sent.clear()
        speed, pictures = steps(seconds)
        talk.send("end")
        times = np.array(talk.recv())
        client.join(10.0)
    at = np.searchsorted(times, [when for when, _ in sent])
    ways = [float(times[i]) - when for i, (when, _) in zip(at, sent, strict=True) if i < len(times)]
    ages = [age for _, age in sent if not math.isnan(age)]
    return Live(scene.name, on, rate, speed, pictures / len(live.sim.skins) / seconds, ages, ways)


def live_section(result: Live, command: str) -> str:
    """Return a section of the page on a tracked hand."""
    age, late = 1e3 * np.median(result.ages_s), 1e3 * np.percentile(result.ages_s, 95)
    return "\n".join(
        [
            f"## {result.scene} with a tracked hand on {'the CPU' if result.device == 'cpu' else 'a GPU'}", "",
            f"`{command}`, on {machine(result.device)}. Another process sent 90 samples of the hand a second. "
            f"{result.rate_Hz:g} pictures a second were requested, and **{result.pictures_s:.1f}** arrived; the scene "
            f"ran at **{result.speed:.2g}** times real time. When a picture was sent, the pose of its hand was "
            f"{age:.0f} ms old (95 %: {late:.0f} ms), counted from the arrival of the sample. The picture arrived at "
            f"the client {1e3 * np.median(result.ways_s):.0f} ms later (median).", "",
        ]
    )  # fmt: skip


def machine(device: str) -> str:
    """Describe the machine in words."""
    cores = f"{len(os.sched_getaffinity(0))} cores of {platform.processor() or platform.machine()}"
    if device == "cpu":
        return cores
    import warp

    return f"{warp.get_device(device).name} and {cores}"


def table(result: Measured, command: str, page: Path) -> str:
    """Return a section of the page; its intervals are stored in the folder data next to it."""
    rows = [
        "| stretch | steps/s without | with | slower by | CPU us a step without | with | more by | pictures/s | "
        "page's share of a core | load of the machine |",
        "",
    ]
    rows += [
        f"| {number} | {b.steps_s:.0f} | {a.steps_s:.0f} | {1.0 - a.steps_s / b.steps_s:+.1%} | {b.cpu_us:.0f} | "
        f"{a.cpu_us:.0f} | {a.cpu_us / b.cpu_us - 1.0:+.1%} | {a.pictures_s:.1f} | {a.page_share:.2f} | {a.load:.1f} |"
        for number, (a, b) in enumerate(zip(result.shown, result.alone, strict=True), 1)
    ]
    others = keep_rows(page, rows, f"view_{Path(result.scene).stem}_{result.device.partition(':')[0]}")
    return "\n".join(
        [
            f"## {result.scene} on {'the CPU' if result.device == 'cpu' else 'a GPU'}", "",
            f"`{command}`, on {machine(result.device)}. {result.rate_Hz:g} pictures a second were requested, "
            f"and **{result.pictures_s:.1f}** arrived. With the page, the simulation was **{result.slower:+.1%}** "
            f"slower and a step took **{result.more_cpu:+.1%}** more CPU time of its own process (medians; "
            f"{others}).", "",
        ]
    )  # fmt: skip


HEAD = """# Speed of the live view

For everyone who uses the live view. Made by `scripts/verification/check_view.py`. A picture is a new state of the skin
mesh, with its colours, that a client receives. The time for drawing in the browser is not included. On a busy machine,
the CPU time of a step is more reliable than the number of steps per second.

"""


def write(result: Measured | Live, command: str, path: Path) -> None:
    """Write a section into the page, in place of an earlier one of the same scene and kind of device."""
    new = live_section(result, command) if isinstance(result, Live) else table(result, command, path)
    heading = new.partition("\n")[0]
    old = path.read_text() if path.exists() else HEAD
    parts = old.split("\n## ")
    others = [part for part in parts[1:] if f"## {part.partition(chr(10))[0]}" != heading]
    sections = sorted([f"## {part.rstrip()}\n" for part in others] + [new])
    path.write_text(HEAD + "\n".join(sections))


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("scene", nargs="?", type=Path, default=DEMO)
    words.add_argument("--device", default=None)
    words.add_argument("--rate", type=float, default=None, help="pictures a second")
    words.add_argument("--stretches", type=int, default=9)
    words.add_argument("--seconds", type=float, default=4.0, help="of a stretch")
    words.add_argument("--page", type=Path, default=PAGE, help="page to write")
    words.add_argument("--live", action="store_true", help="the hand follows samples of another process")
    args = words.parse_args()
    result: Measured | Live
    if args.live:
        result = measure_live(args.scene, args.device, args.rate, args.stretches * args.seconds)
    else:
        result = measure(args.scene, args.device, args.rate, args.stretches, args.seconds)
    name = args.scene.resolve()
    shown = name.relative_to(ROOT) if name.is_relative_to(ROOT) else name
    command = f"python scripts/verification/check_view.py {shown}" + (f" --device {args.device}" if args.device else "")
    command += " --live" if args.live else ""
    write(result, command, args.page)


if __name__ == "__main__":
    main()
