"""Test whether modes depend on rotation or mirroring of a scene, or on the order of its arrays.

    python scripts/verification/check_turned.py [--accuracy 0.4 0.1]

The scenes are small and use the public interface. Two arrays are under a disc of skin: the whole scene is rotated,
moved by 0.1 um, and has its arrays in the other order. For each case the script prints the relative change of the
displacement over 20 ms, divided by the error estimate of the modes. The mirrored scene has another mesh, so there the
script compares modes with the whole layer on the same mesh, in both scenes.
"""

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np
from small_scene import small_scene_texts

from palmfield import Simulation
from palmfield.types import Float

PLAIN = """
<mujoco model="small_plain"><worldbody><frame quat="{turn}" pos="{shift} 0 0">
  <site name="array"/>
  <site name="second" pos="{side} 0.05 0.02" quat="0.9659258 0 {tilt} 0"/>
  <site name="aim" pos="{aim} 0.002 0.12"/>
  <body name="pad" pos="0 0 0.12" quat="0 1 0 0" gravcomp="1">
    <joint name="slide" type="slide" axis="0 0 1" stiffness="400" damping="10"/>
    <site name="centre" size="0.001"/>
    <geom type="cylinder" size="0.02 0.004" pos="0 0 -0.004" contype="0" conaffinity="0"/>
  </body></frame></worldbody></mujoco>
"""
SECOND = '<instance name="second"><config key="site" value="second"/></instance>'


def quaternion(axis: tuple[float, float, float], degrees: float) -> str:
    half = math.radians(degrees) / 2.0
    return " ".join(f"{x:.17g}" for x in (math.cos(half), *(math.sin(half) * a for a in axis)))


def moved(
    folder: Path,
    accuracy: float,
    turn: str = "1 0 0 0",
    mirror: float = 1.0,
    swapped: bool = False,
    shift: float = 0.0,
    solver: str = "modal",
    steps: int = 20,
) -> tuple[Float, float]:
    """Return the displacement of the skin in its body's frame, (t, S, 3), and the error estimate of the modes."""
    plain = PLAIN.format(
        turn=turn, side=-0.2 * mirror, tilt=0.258819 * mirror, aim=0.003 * mirror, shift=shift
    )  # fmt: skip
    stimulus = {"frame": "aim", "focus_m": "0 0 0"}
    skin = {"solver": solver, "accuracy": accuracy, "element_m": 0.004}
    _, haptic = small_scene_texts(0.02, stimulus=stimulus, skin=skin)
    first = '<instance name="array"></instance>'
    haptic = haptic.replace(first, SECOND + first if swapped else first + SECOND)
    (folder / "plain.xml").write_text(plain)
    (folder / "small.xml").write_text(haptic)
    sim = Simulation(folder / "small.xml")
    seen = []
    for _ in range(steps):
        sim.step()
        seen.append(sim.skin().displacement.copy())
    return np.array(seen), getattr(sim.runtime.model.begin[0].value, "error", 0.0)


def change(one: Float, other: Float) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, nargs="+", default=[0.4, 0.1])
    settings = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for accuracy in settings.accuracy:
            plain, error = moved(folder, accuracy)
            cases = {
                "turned by 90 degrees": {"turn": quaternion((0, 0, 1), 90)},
                "turned by 37 degrees": {"turn": quaternion((1, 0, 0), 37)},
                "nudged": {"shift": 1e-7},
                "arrays in the other order": {"swapped": True},
            }
            for words, keys in cases.items():
                gap = change(moved(folder, accuracy, **keys)[0], plain)
                print(
                    f"accuracy {accuracy:g}, stated {error:.3g}: {words}, changed by {gap / error:.2g} of it",
                    flush=True,
                )
            for mirror in (1.0, -1.0):
                modal, whole = (moved(folder, accuracy, mirror=mirror, solver=name)[0] for name in ("modal", "wedges"))
                print(f"accuracy {accuracy:g}, mirror {mirror:+g}: off the whole layer by {change(modal, whole):.4g}")


if __name__ == "__main__":
    main()
