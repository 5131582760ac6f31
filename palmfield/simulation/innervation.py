"""Afferents of a skin layer: places drawn by density, and the operator to the motion at their endings."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from palmfield.config.skin import OF_SHAPES, SkinConfig
from palmfield.errors import SceneError
from palmfield.hand.regions import part_of, regions_at
from palmfield.hand.triangles import face_samples
from palmfield.perception.afferents import AFFERENTS, largest_under_probe
from palmfield.perception.populations import DENSITIES_PER_CM2
from palmfield.skin.fem.below_surface import below_surface
from palmfield.skin.mesh.element import barycentric
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float, Int


class Endings(NamedTuple):
    """Places of the afferents of a layer.

    names: class of each, (n,); positions: point of the surface above each, body frame at rest [m], (n, 3)
    triangles, local: triangles of the surface above each, (n,), and xi and eta there, (n, 2)
    """

    names: NDArray[np.str_]
    positions: Float
    triangles: Int
    local: Float


class Innervation(NamedTuple):
    """Afferents of a layer.

    names: class of each unit, (n,); positions: point of the surface above each, body frame at rest [m], (n, 3)
    operator: from unknowns of the layer to the motion of the probe with the same effect [m], csr, (n, ndof)
    """

    names: NDArray[np.str_]
    positions: Float
    operator: sparse.csr_matrix


def endings_of(layer: SceneLayer) -> Endings:
    """Draw the afferents of a layer by its keys `receptor_...`; equal keys and meshes give equal places.

    Needs no matrices. Raises SceneError for skin of unknown density, and for a layer with less than one afferent.
    """
    mesh, config = layer.mesh, layer.config
    corners = mesh.nodes[mesh.surface_triangles6[:, :3]]
    centroids, _, areas_m2 = face_samples(mesh.nodes, mesh.surface_triangles6[:, :3])
    areas_cm2 = 1e4 * areas_m2
    with layer.named:
        densities = _densities(config, centroids)
    random = np.random.default_rng(config.receptor_seed)
    found: list[tuple[Any, ...]] = []
    for number, name in enumerate(AFFERENTS):
        expected = densities[number] * areas_cm2
        if not (count := round(expected.sum())):
            continue
        triangles = np.sort(random.choice(len(expected), size=count, p=expected / expected.sum())).astype(np.int32)
        local = random.random((count, 2))
        local = np.where(local.sum(axis=1, keepdims=True) > 1.0, 1.0 - local, local)
        positions = np.einsum("pi,pic->pc", barycentric(local), corners[triangles])
        found.append((np.full(count, name), positions, triangles, local))
    if not found:
        with layer.named:
            raise SceneError(f"the layer of {areas_cm2.sum():.2g} cm2 has less than one afferent: enlarge it")
    return Endings(*map(np.concatenate, zip(*found, strict=True)))


def innervation_of(layer: SceneLayer) -> Innervation:
    """Return the afferents of a layer. Raises SceneError like `endings_of`, and if an ending is below the layer."""
    operators, config, endings = list[sparse.csr_matrix](), layer.config, endings_of(layer)
    for number, (name, afferent) in enumerate(AFFERENTS.items()):
        own = endings.names == name
        if not own.any():
            continue
        depth_m = config.receptor_depths_m[number] if config.receptor_depths_m else afferent.depth_m
        with layer.named:
            moved, pressed = below_surface(
                layer.mesh, layer.system, endings.triangles[own], endings.local[own], depth_m
            )
        chosen = pressed if afferent.quantity == "strain" else moved
        operators.append(chosen / largest_under_probe(afferent))
    return Innervation(endings.names, endings.positions, sparse.csr_matrix(sparse.vstack(operators)))


def _densities(config: SkinConfig, points: Float) -> Float:
    """Return the units per cm2 of each class at points of the surface [m], shape (classes, n)."""
    if config.receptor_densities_per_cm2:
        return np.repeat(np.array([config.receptor_densities_per_cm2]).T, len(points), axis=1)
    if config.shape not in OF_SHAPES["hand"]:
        raise SceneError(
            f"shape '{config.shape}' has no regions with known densities of afferents: give the three densities "
            f"of {', '.join(AFFERENTS)}",
            setting="receptor_densities_per_cm2",
        )
    parts = [part_of(region) for region in regions_at(config.hand, points)]
    if set(parts) == {None}:
        raise SceneError(
            "no densities are known for hairy skin: put patch_site on the palm or a finger, or give the three "
            f"densities of {', '.join(AFFERENTS)}",
            setting="receptor_densities_per_cm2",
        )
    known = [DENSITIES_PER_CM2[part] if part else dict.fromkeys(AFFERENTS, 0.0) for part in parts]
    return np.array([[one[name] for one in known] for name in AFFERENTS])
