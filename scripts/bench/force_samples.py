#!/usr/bin/env python3
"""Measure the error of the force of the sound on a body by number of samples and summation rule.

python scripts/bench/force_samples.py [SCENE ...] [--times 4] [--lit 4] [--accuracy 0.0035 0.006] [--rows PAGE]

SCENE is a name in mjcf/scenes, or "box": a cube in place of the hand. The force, and the torque about the origin of the
body, are computed at some times of the scene: for the focus of the stimulus at that time, for foci at --lit places of
the lit side, and for foci 10 and 30 mm in front of these places and 20 mm behind them. The reference has each face
split into sixteen. Samples are those of the key force_accuracy. Rows contain the root mean square and the maximum over
the foci of a scene: of the force in per cent of the force, and of the torque in per cent of the force times the root
mean square arm. With --rows they are written to the folder data next to a page. The table has the worst scene of each
accuracy and place.
"""

import argparse
from pathlib import Path

import numpy as np
from trimesh.creation import box
from trimesh.remesh import subdivide

from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.data import folder
from palmfield.hand.force_samples import A_FACE, CELLS_m, sample_mesh
from palmfield.hand.subdivide import EDGE_m, with_short_edges
from palmfield.hand.triangles import face_samples
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frame_at
from palmfield.studies.bench.table import cells, keep_rows
from palmfield.types import Complex, Float, Int

SCENES = folder("mjcf") / "scenes"
DEFAULT = ["palm_am200", "palm_circle", "approach_withdraw", "follow_fingertip", "hover_explore", "trace_shape", "box"]
BOX_m = 0.06
"""Edge of the cube that replaces the hand of the first scene in the row "box"."""
OFF_m = {"on the lit side": 0.0, "10 mm in front": -0.01, "30 mm in front": -0.03, "20 mm behind": 0.02}
"""Foci by their distance from places of the lit side, along the axis of the arrays."""
HEAD = [
    "| scene | foci | number | force_accuracy | samples | force rms [%] | largest | torque rms [%] | largest |",
    "|---|---|---|---|---|---|---|---|---|",
]
Samples = tuple[Float, Float, Float]
"""Points [m], outward normals there, and the area of each as a vector [m2], all (n, 3)."""


def of_faces(vertices: Float, faces: Int) -> Samples:
    """Return one sample per face."""
    samples = face_samples(vertices, faces)
    return samples.centroids, samples.normals, samples.areas[:, None] * samples.normals


def resultant(posed: PosedScene, samples: Samples, drive: Complex, law: object, origin: Float) -> tuple[Float, Float]:
    """Return force [N] and torque [N m] about a point."""
    points, normals, pushes = samples
    arp = SurfaceArp(posed.arrays.field, len(points), law).evaluate(points, normals, drive).arp  # type: ignore[arg-type]
    push = -arp.astype(np.float64)[:, None] * pushes
    return push.sum(axis=0), np.cross(points - origin, push).sum(axis=0)


def measure(scene: str, times: int, lit: int, accuracies: list[float]) -> list[str]:
    """Return the rows of a scene."""
    sim = load(SCENES / f"{DEFAULT[0] if scene == 'box' else scene}.xml", device="cpu", accuracy=0.5)
    random = np.random.default_rng(1)
    errors: dict[str, list[tuple[float, float]]] = {}
    counts: dict[str, int] = {}
    for share in np.arange(times) / times:
        sim.start_at(float(share * sim.duration_s))
        model, posed = sim.runtime.model, sim.runtime.posed
        part, body = model.stimuli[0], posed.bodies[0]
        vertices, faces, origin = body.vertices_in_array, body.faces, body.frame.position
        if scene == "box":
            cube = box((BOX_m,) * 3)
            vertices, faces, _ = with_short_edges(
                cube.vertices + part.first_focus + (0, 0, BOX_m / 2), cube.faces, EDGE_m
            )
            # Each vertex once
            vertices, numbers = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
            faces = numbers.reshape(-1)[faces]
        points, normals, _ = of_faces(vertices, faces)
        own = posed.focal_points(part, 0).at(frame_at(part.config, sim.time).focus)
        arm = np.sqrt(((points - origin) ** 2).sum(axis=1).mean())
        looking = points[normals[:, 2] < -0.6]
        chosen = looking[random.integers(0, len(looking), lit)]
        foci = [("of the scene", own)]
        foci += [(where, focus + off * np.eye(3)[2]) for where, off in OFF_m.items() for focus in chosen]
        drives = [array_drives(model, posed.arrays)[0].unit_drive(focus).amplitudes for _, focus in foci]
        law = model.skins[0].spec.arp_law
        exact = of_faces(*subdivide(*subdivide(vertices, faces)))
        expected = [resultant(posed, exact, drive, law, origin) for drive in drives]
        for accuracy in accuracies:
            mesh = sample_mesh(vertices, faces, accuracy)
            samples, name = of_faces(mesh.points, mesh.corners), f"{100 * accuracy:g} %"
            counts[name] = len(samples[0])
            for (where, _), drive, true_force in zip(foci, drives, expected, strict=True):
                found = resultant(posed, samples, drive, law, origin)
                off, turned = (float(np.linalg.norm(a - b)) for a, b in zip(found, true_force, strict=True))
                force = float(np.linalg.norm(true_force[0]))
                errors.setdefault(f"{name}|{where}", []).append((off / force, turned / (force * arm)))
        if scene == "box":
            break
    lines = []
    for key, values in errors.items():
        name, where = key.split("|")
        off = 100.0 * np.array(values)
        rms, most = np.sqrt((off**2).mean(axis=0)), off.max(axis=0)
        lines.append(
            f"| {scene} | {where} | {len(off)} | {name} | {counts[name]} | {rms[0]:.2f} | {most[0]:.2f} | "
            f"{rms[1]:.2f} | {most[1]:.2f} |"
        )
        print(lines[-1], flush=True)
    return lines


def worst(rows: list[str]) -> list[str]:
    """Return a table of the worst scene for each accuracy and place of the foci."""
    lines = [
        "| force_accuracy | foci | force error [%]: rms, largest | torque error [%]: rms, largest |",
        "|---|---|---|---|",
    ]
    found = [cells(row) for row in rows]
    for name, where in dict.fromkeys((row[3], row[1]) for row in found):
        some = np.array([row[5:] for row in found if row[3] == name and row[1] == where], float).max(axis=0)
        lines.append(f"| {name} | {where} | {some[0]:.2f}, {some[1]:.2f} | {some[2]:.2f}, {some[3]:.2f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=DEFAULT)
    parser.add_argument("--times", type=int, default=4)
    parser.add_argument("--lit", type=int, default=4)
    parser.add_argument("--accuracy", type=float, nargs="*", default=[0.0015, A_FACE, *CELLS_m])
    parser.add_argument("--rows", type=Path, metavar="PAGE")
    arguments = parser.parse_args()
    rows = []
    for scene in arguments.scenes:
        rows += measure(scene, arguments.times, arguments.lit, arguments.accuracy)
    if arguments.rows:
        keep_rows(arguments.rows, [*HEAD, *rows])
    print("\n".join(worst(rows)))


if __name__ == "__main__":
    main()
