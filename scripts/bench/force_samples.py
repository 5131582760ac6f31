#!/usr/bin/env python3
"""How exact the force of the sound on a body is, by how many samples it is added up from and by which rule.

python scripts/bench/force_samples.py [SCENE ...] [--times 4] [--lit 4] [--accuracy 0.006 0.0075] [--weighted]

SCENE is a name in mjcf/scenes, or "box": a cube in place of the hand. The force, and the torque about the body's
origin, on the body as it lies at some times of the scene and under foci where the stimulus is then, and at --lit places
of its lit side besides, are held against those of the same faces cut in sixteen. Samples are those that the key
force_accuracy gives; with --weighted also the same cells of faces with weights (vectors) that add up exactly what a
Gaussian kernel of a wavelength's length interpolates between their samples. The table gives the root mean square over
the foci of a scene, and the largest, of the force in per cent of it, and of the torque in per cent of the force times
the root mean square arm.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from trimesh.creation import box
from trimesh.remesh import subdivide

from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.data import folder
from palmfield.hand.force_samples import A_FACE, CELLS_m, sample_mesh
from palmfield.hand.posed_surface import face_samples
from palmfield.hand.subdivide import EDGE_m, with_short_edges
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frame_at
from palmfield.types import Complex, Float, Int

SCENES = folder("mjcf") / "scenes"
DEFAULT = ["palm_am200", "palm_circle", "approach_withdraw", "follow_fingertip", "hover_explore", "trace_shape", "box"]
BOX_m = 0.06
"""Edge of a cube that stands for the hand of the first scene in the row "box"."""
NEIGHBOURS, TURN_m, KERNEL_m, KERNEL_TURN = 16, 4e-3, 8e-3, 1.5
"""Of the interpolation: samples taken for a place, how far a normal's turn by 1 rad counts when the nearest are sought,
and the kernel's length, along the surface and between normals."""
Samples = tuple[Float, Float, Float]
"""Points [m] and outward normals there, and the area by which each pushes, as a vector [m2], all (n, 3)."""


def of_faces(vertices: Float, faces: Int) -> Samples:
    """One sample a face."""
    samples = face_samples(vertices, faces)
    return samples.centroids, samples.normals, samples.areas[:, None] * samples.normals


def weighted(samples: Samples, fine: Samples) -> Samples:
    """The same samples, pushing so that what is interpolated between them is added up over the fine ones."""
    (points, normals, _), (places, outwards, pushes) = samples, fine
    tree = cKDTree(np.concatenate([points, TURN_m * normals], axis=1))
    near = tree.query(np.concatenate([places, TURN_m * outwards], axis=1), NEIGHBOURS)[1]

    def kernel(one: Float, turned: Float, other: Float, as_turned: Float) -> Float:
        gaps, turns = ((one - other) ** 2).sum(axis=-1), ((turned - as_turned) ** 2).sum(axis=-1)
        return np.asarray(np.exp(-gaps / (2.0 * KERNEL_m**2) - turns / (2.0 * KERNEL_TURN**2)))

    here, facing = points[near], normals[near]
    system = np.zeros((len(places), NEIGHBOURS + 1, NEIGHBOURS + 1))
    system[:, :-1, :-1] = kernel(here[:, :, None], facing[:, :, None], here[:, None], facing[:, None])
    system[:, :-1, :-1] += 1e-8 * np.eye(NEIGHBOURS)
    system[:, -1, :-1] = system[:, :-1, -1] = 1.0
    wanted = np.ones((len(places), NEIGHBOURS + 1, 1))
    wanted[:, :-1, 0] = kernel(here, facing, places[:, None], outwards[:, None])
    shares = np.linalg.solve(system, wanted)[:, :-1, 0]
    rows = np.repeat(np.arange(len(places)), NEIGHBOURS)
    matrix = sparse.csr_array((shares.ravel(), (rows, near.ravel())), shape=(len(places), len(points)))
    return points, normals, matrix.T @ pushes


def resultant(posed: PosedScene, samples: Samples, drive: Complex, law: object, origin: Float) -> tuple[Float, Float]:
    """Force [N] and torque [N m] about a point."""
    points, normals, pushes = samples
    arp = SurfaceArp(posed.arrays.field, len(points), law).evaluate(points, normals, drive).arp  # type: ignore[arg-type]
    push = -arp.astype(np.float64)[:, None] * pushes
    return push.sum(axis=0), np.cross(points - origin, push).sum(axis=0)


def rules(vertices: Float, faces: Int, accuracies: list[float], weights: bool) -> Iterator[tuple[str, Samples]]:
    for accuracy in accuracies:
        mesh = sample_mesh(vertices, faces, accuracy)
        samples = of_faces(mesh.points, mesh.corners)
        yield f"{100 * accuracy:g} %", samples
        if weights and accuracy > A_FACE:
            yield f"{100 * accuracy:g} %, weighted", weighted(samples, of_faces(*subdivide(vertices, faces)))


def measure(scene: str, times: int, lit: int, accuracies: list[float], weights: bool) -> None:
    """Print a scene's rows."""
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
            vertices, faces = with_short_edges(cube.vertices + part.first_focus + (0, 0, BOX_m / 2), cube.faces, EDGE_m)
            # Each vertex once
            vertices, numbers = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
            faces = numbers.reshape(-1)[faces]
        points, normals, _ = of_faces(vertices, faces)
        own = posed.focal_points(part, 0).at(frame_at(part.config, sim.time).focus)
        arm = np.sqrt(((points - origin) ** 2).sum(axis=1).mean())
        looking = points[normals[:, 2] < -0.6]
        foci = [own, *(looking[i] for i in random.integers(0, len(looking), lit))]
        drives = [array_drives(model, posed.arrays)[0].unit_drive(focus).amplitudes for focus in foci]
        law = model.skins[0].spec.arp_law
        exact = of_faces(*subdivide(*subdivide(vertices, faces)))
        expected = [resultant(posed, exact, drive, law, origin) for drive in drives]
        for name, samples in rules(vertices, faces, accuracies, weights):
            counts[name] = len(samples[0])
            for number, (drive, wanted) in enumerate(zip(drives, expected, strict=True)):
                found = resultant(posed, samples, drive, law, origin)
                off, turned = (float(np.linalg.norm(a - b)) for a, b in zip(found, wanted, strict=True))
                force = float(np.linalg.norm(wanted[0]))
                where = "its own" if number == 0 else "lit side"
                errors.setdefault(f"{name}|{where}", []).append((off / force, turned / (force * arm)))
        if scene == "box":
            break
    for key, values in errors.items():
        name, where = key.split("|")
        off = 100.0 * np.array(values)
        rms, most = np.sqrt((off**2).mean(axis=0)), off.max(axis=0)
        print(
            f"| {scene} | {where} | {len(off)} | {name} | {counts[name]} | {rms[0]:.2f}, {most[0]:.2f} | "
            f"{rms[1]:.2f}, {most[1]:.2f} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=DEFAULT)
    parser.add_argument("--times", type=int, default=4)
    parser.add_argument("--lit", type=int, default=4)
    parser.add_argument("--accuracy", type=float, nargs="*", default=[0.0015, A_FACE, *CELLS_m])
    parser.add_argument("--weighted", action="store_true")
    arguments = parser.parse_args()
    print("| scene | foci | of them | force_accuracy | samples | force, %: rms, most | torque, %: rms, most |")
    print("|---|---|---|---|---|---|---|")
    for scene in arguments.scenes:
        measure(scene, arguments.times, arguments.lit, arguments.accuracy, arguments.weighted)


if __name__ == "__main__":
    main()
