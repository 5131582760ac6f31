#!/usr/bin/env python3
"""Compare the mesh of a scene's skin with a much finer one, for spots at places over its region of foci.

Gaussian spots of the scene's width load the layer of the first skin: in its middle, and on two rings. The
displacement under each spot, at rest and at frequencies up to the highest, is compared with that on a mesh with edges
of `--finer` times the size and three more rows. The estimate of a run compares with a coarser mesh instead; its value
for this mesh is listed too. It prints a row for each mesh and frequency: errors in percent, by place.
"""

import argparse
import math

import numpy as np

import palmfield
from palmfield.blas import one_blas_thread
from palmfield.data import folder
from palmfield.estimate.cost import COARSER
from palmfield.estimate.numerics.mesh_error import COARSE_ORDER
from palmfield.skin.approximation.richardson import error_of_finer
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import Krylov
from palmfield.skin.reduction.reducer import SHIFT
from palmfield.skin.scene_layer import SceneLayer
from palmfield.studies.bench.table import processor
from palmfield.types import Complex, Float

RINGS_M = ((0.0, 1), (0.009, 4), (0.018, 6))
"""Radius and number of places on each ring around the middle of the layer."""
VECTORS = 20
"""Number of vectors of the reduced model for each spot."""


def places_on(layer: SceneLayer) -> Float:
    """Return the places of the spots on the skin, body frame [m], shape (11, 3)."""
    near = layer.patch.vertices[np.linalg.norm(layer.patch.vertices - layer.centre_m, axis=1) < 0.03]
    first, second, _ = np.linalg.svd(near - near.mean(axis=0))[2]
    places = []
    for radius, count in RINGS_M:
        turns = 2.0 * np.pi * (np.arange(count) + 0.3) / count
        places += [layer.centre_m + radius * (np.cos(turn) * first + np.sin(turn) * second) for turn in turns]
    return SurfaceProbe(layer.mesh, np.array(places), layer.system).closest


def displacements(layer: SceneLayer, places: Float, frequencies_Hz: list[float]) -> Complex:
    """Return the normal displacement under a spot at each place, shape (frequencies, places)."""
    quadrature, system = layer.quadrature, layer.system
    width = layer.demand.spot_fwhm_m
    spots = [np.exp(-4.0 * math.log(2.0) * ((quadrature.points - at) ** 2).sum(axis=1) / width**2) for at in places]
    forces = np.stack([quadrature.operator @ spot for spot in spots], axis=1)
    dynamics = DynamicStiffness(system, system.elimination_order())
    krylov = Krylov(dynamics, SHIFT * 2.0 * math.pi * layer.demand.max_frequency_Hz, forces)
    with one_blas_thread:
        while krylov.order < VECTORS * len(places) and krylov.grow():
            pass
    read, vectors = SurfaceProbe(layer.mesh, places, system).operator, krylov.vectors
    result = np.empty((len(frequencies_Hz), len(places)), complex)
    for place in range(len(places)):
        one = Projection(
            krylov.projected, dynamics.materials, vectors.T @ forces[:, place : place + 1], read[place] @ vectors
        )
        result[:, place] = [one.harmonic(f_Hz)[0] for f_Hz in frequencies_Hz]
    system.matrices.forget()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default="palm_am200")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--finer", type=float, default=0.45)
    chosen = parser.parse_args()
    keys = dict(one.split("=", 1) for one in chosen.set)
    sim = palmfield.Simulation(folder("mjcf") / "scenes" / f"{chosen.scene}.xml", device="cpu", keys=keys)
    layer = sim.runtime.model.skins[0].layer
    rows = len(layer.sizes.depth_fractions) - 1
    frequencies = [0.0, 100.0, 200.0, layer.demand.max_frequency_Hz]
    places = places_on(layer)
    print(processor())
    finest = layer.resized(chosen.finer, rows + 3)
    other = layer.resized(COARSER, rows)
    own, coarse, truth = (displacements(each, places, frequencies) for each in (layer, other, finest))
    names = (("error", own, truth), ("of the coarser mesh", coarse, truth), ("stated", coarse, own))
    print(f"{chosen.scene}: {layer.system.ndof} unknowns, coarser {other.system.ndof}, finer {finest.system.ndof}")
    for what, one, reference in names:
        scale = error_of_finer(1.0, COARSER, COARSE_ORDER) if what == "stated" else 1.0
        for number, f_Hz in enumerate(frequencies):
            found = 100.0 * scale * np.abs(one[number] - reference[number]) / np.abs(reference[number])
            each = " ".join(f"{value:5.1f}" for value in found)
            rms = np.sqrt(np.mean(found**2))
            print(f"{what:20s} {f_Hz:5.0f} Hz  median {np.median(found):5.2f}  rms {rms:5.2f}  {each}")


if __name__ == "__main__":
    main()
