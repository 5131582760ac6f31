"""Sound of several drives at points on a device against the float64 reference; here on the CPU, whose kernels are the
same source."""

import numpy as np
import pytest
import warp as wp
from rigid_sphere import geodesic
from scipy.spatial.transform import Rotation

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import LAWS
from palmfield.acoustics.occlusion import Occlusion, distance_to_arrays
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.point_sound import DriveTable, Surface, Transducers, fill_table, sound_calls
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.config import ArrayConfig
from palmfield.device import SharedArray, SharedBlock, replayed
from palmfield.transforms import IDENTITY, Placement, Transform
from palmfield.types import Complex, Float, Float32

HERE = Placement.of(IDENTITY)
TURN = Rotation.from_euler("y", -40, degrees=True).as_matrix()
TILTED = Transform(np.array([0.25, 0.0, 0.05]), TURN)
ARRAYS: dict[str, list[dict[str, object]]] = {
    "a board": [{"layout": "uhev1"}],
    "faults": [{"layout": "uhev1", "dead": (3, 200), "inverted": (7,)}],
    "two boards": [{"layout": "uhev1"}, {"layout": "uhev1"}],
    "two directivities": [{"layout": "uhev1"}, {"layout": "sonicsurface", "directivity": "point"}],
}


def phased(name: str, tilted: Transform = TILTED) -> PhasedArray:
    places = [HERE, Placement.of(tilted)][: len(ARRAYS[name])]
    configs = [ArrayConfig.model_validate(keys) for keys in ARRAYS[name]]
    return PhasedArray([ArrayInstance(*pair) for pair in zip(configs, places, strict=True)], places, "cpu")


def surface(count: int, seed: int = 0) -> tuple[Float, Float]:
    """Points of a bumpy patch over the first array and its normals, most of which face the array."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.03, 0.03, (count, 3)) * [1.0, 1.0, 0.3] + [0.0, 0.0, 0.2]
    normals = rng.normal(size=(count, 3)) * 0.5 - [0.0, 0.0, 1.0]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def drives_of(array: PhasedArray, count: int, seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    shape = count, len(array)
    return rng.uniform(0.5, 1.0, shape) * np.exp(2j * np.pi * rng.uniform(size=shape))


class Bench:
    """A table, points and their sound, ready to be launched."""

    def __init__(self, array: PhasedArray, points: Float, normals: Float, drives: int, sums: int, surfaces=None):
        self.transducers = Transducers(array, "cpu")
        self.block = SharedBlock(DriveTable.parts(drives, sums, len(array)), "cpu")
        self.points, self.normals = (
            wp.array(values.astype(np.float32)[None], dtype=wp.vec3, device="cpu") for values in (points, normals)
        )
        self.result = SharedArray((sums, len(points)), wp.float32, "cpu")
        surfaces = surfaces or [Surface(slice(0, len(points)), "default", None)]
        table = DriveTable(*self.block.arrays.values())
        self.calls = sound_calls(self.transducers, table, self.points, self.normals, surfaces, array, self.result.array)

    def arp(self, drives: Complex, levels: Complex | None = None) -> Float32:
        counts, table, weights = self.block.hosts.values()
        fill_table((counts[0], table, weights), self.transducers.strengths(drives), levels)
        for call in self.calls:
            call()
        return self.result.host[: len(drives if levels is None else levels)].copy()


def expected(array: PhasedArray, points: Float, normals: Float, drive: Complex, law: str) -> Float:
    """ARP in float64, NaN where the flow through the surface is too small beyond float32 to tell its side."""
    p, g = np.zeros(len(points), complex), np.zeros((len(points), 3), complex)
    for group in array.groups:
        part = pressure64(points, group.array, drive[group.chosen], array.air, gradient=True, normals=normals)
        p, g = p + part[0], g + part[1]
    s = g * sound_speed(array.air) / (2.0 * np.pi * array.array.frequency_Hz)
    across = np.einsum("ij,ij->i", s, normals)
    along2 = (np.abs(s) ** 2).sum(axis=1) - np.abs(across) ** 2
    scale, kind = 1.0 / (density(array.air) * sound_speed(array.air) ** 2), LAWS[law]
    value = scale * (kind.pressure * np.abs(p) ** 2 - kind.along * along2 + kind.across * np.abs(across) ** 2)
    flow = (p.conj() * across).imag
    result = np.where(flow < 0.0, value, 0.0)
    result[np.abs(flow) < 1e-3 * np.abs(p).max() ** 2] = np.nan
    return result


def apart(one: Float | Float32, other: Float) -> float:
    """Largest difference, relative to the largest value."""
    return float(np.nanmax(np.abs(one - other)) / np.nanmax(np.abs(other)))


@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("name", list(ARRAYS))
def test_each_drive_by_itself_against_the_reference(name: str, law: str) -> None:
    array = phased(name)
    points, normals = surface(70)
    drives = drives_of(array, 6)
    bench = Bench(array, points, normals, 6, 6, [Surface(slice(0, 70), law, None)])
    for found, drive in zip(bench.arp(drives), drives, strict=True):
        assert apart(found, expected(array, points, normals, drive, law)) < 5e-5


def test_sums_are_those_of_the_drives() -> None:
    array = phased("two boards")
    points, normals = surface(50)
    units = drives_of(array, 2)
    units[0, 256:] = units[1, :256] = 0.0
    levels = drives_of(array, 5, seed=1)[:, :2]
    found = Bench(array, points, normals, 2, 5).arp(units, levels)
    for mine, level in zip(found, levels, strict=True):
        assert apart(mine, expected(array, points, normals, level @ units, "default")) < 5e-5


def test_fewer_drives_than_there_is_room_for_leave_nothing_of_the_last_ones() -> None:
    array = phased("a board")
    points, normals = surface(40)
    drives = drives_of(array, 9)
    bench = Bench(array, points, normals, 9, 9)
    bench.arp(drives)
    few = bench.arp(drives[2:5])
    np.testing.assert_array_equal(few, Bench(array, points, normals, 9, 9).arp(drives[2:5]))
    assert apart(few[0], expected(array, points, normals, drives[2], "default")) < 5e-5


def test_equal_input_gives_equal_bits_in_any_company() -> None:
    array = phased("two directivities")
    points, normals = surface(60)
    drives = drives_of(array, 8)
    bench = Bench(array, points, normals, 8, 8)
    first = bench.arp(drives)
    bench.arp(drives[::-1])
    np.testing.assert_array_equal(bench.arp(drives), first)
    np.testing.assert_array_equal(bench.arp(drives[3:4]), first[3:4])


def test_surfaces_have_laws_of_their_own() -> None:
    array = phased("a board")
    points, normals = surface(60)
    drive = drives_of(array, 1)
    both = [Surface(slice(0, 25), "alpha", None), Surface(slice(25, 60), "default", None)]
    found = Bench(array, points, normals, 1, 1, both).arp(drive)[0]
    for own, law, *_ in both:
        assert apart(found[own], expected(array, points[own], normals[own], drive[0], law)) < 5e-5


def test_arrays_that_move_take_their_sound_along() -> None:
    before = phased("two boards", Transform(np.array([0.4, 0.0, 0.0]), np.eye(3)))
    after = phased("two boards")
    points, normals = surface(50)
    drive = drives_of(after, 1)
    bench = Bench(before, points, normals, 1, 1)
    bench.arp(drive)
    bench.transducers.move(after)
    assert apart(bench.arp(drive)[0], expected(after, points, normals, drive[0], "default")) < 5e-5


def test_shadows_are_those_of_rays_along_the_flow() -> None:
    """A sphere in front of half the points; the flow and the rays by the functions that scenes use on the CPU."""
    array = phased("two boards")
    points, normals = surface(300)
    vertices, faces = geodesic(0.015, 4)
    vertices += [0.015, 0.0, 0.16]
    drive = np.ones(len(array), complex)
    occlusion = Occlusion(vertices, faces, "cpu")
    found = Bench(array, points, normals, 1, 1, [Surface(slice(0, 300), "default", occlusion.mesh)]).arp(drive[None])
    sound = SurfaceArp(array.field, 300).evaluate(points, normals, drive, flux=True)
    assert sound.flux is not None
    lit = occlusion.lit(points, sound.flux, distance_to_arrays(points, sound.flux, array))
    assert np.count_nonzero(sound.arp[~lit]) > 30 and np.count_nonzero(sound.arp[lit]) > 30
    assert apart(found[0], np.where(lit, sound.arp, 0.0)) < 5e-5


def test_a_captured_graph_does_the_same_and_reads_what_is_put_in_later() -> None:
    array = phased("a board")
    points, normals = surface(40)
    drives = drives_of(array, 5)
    bench, other = (Bench(array, points, normals, 5, 5) for _ in range(2))
    bench.arp(drives[:1])
    bench.calls = [replayed(bench.calls, "cpu")]
    bench.result.host[:] = np.nan
    np.testing.assert_array_equal(bench.arp(drives), other.arp(drives))
    np.testing.assert_array_equal(bench.arp(drives[3:]), other.arp(drives[3:]))


def test_no_points_take_no_launch() -> None:
    assert Bench(phased("a board"), np.zeros((0, 3)), np.zeros((0, 3)), 1, 1).calls == []
