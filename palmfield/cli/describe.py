"""A scene in words: what `palmfield info` prints."""

import io

from rich.console import Console
from rich.table import Table

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.arp import LAWS
from palmfield.scene import Scene
from palmfield.skin.materials.material import complex_shear


def describe(scene: Scene) -> str:
    """What `palmfield info` prints."""
    rig = scene.skin.rig
    c = sound_speed(rig.air)
    modulus = complex_shear(rig.material, 200.0)
    drive = rig.unit_drive(rig.reference_focus)[1]
    array, material = rig.array, rig.material
    rows = [
        ("scene", f"{scene.path}, {scene.duration_s:g} s in steps of {1e3 * rig.timestep_s:g} ms"),
        (
            "array",
            f"{array.name}: {len(array)} transducers, {array.frequency_Hz / 1e3:g} kHz, p0 {array.p0_Pa_m:g} Pa m",
        ),
        (
            "air",
            f"{rig.air.temperature_C:g} C, {rig.air.humidity_percent:g} %, {rig.air.pressure_Pa:g} Pa: c {c:.1f} m/s, "
            f"rho {density(rig.air):.3f} kg/m3, absorption {absorption_Np_m(rig.air, rig.array.frequency_Hz):.3f} Np/m",
        ),
        ("stimulus", ", ".join(f"{k} {v}" for k, v in rig.stimulus.model_dump(exclude_none=True).items())),
        ("drive", f"{rig.device.name}; amplitude {drive:.4f} of full at the first focus"),
        ("surface", f"{rig.skin.shape} on body '{rig.skin.body}'"),
        (
            "material",
            f"{material.name}: rho {material.density_kg_m3:g} kg/m3, "
            f"G*(200 Hz) {modulus.real:.0f}{modulus.imag:+.0f}i Pa",
        ),
        ("material source", material.source),
        ("ARP law", LAWS[rig.skin.arp_law].about),
        (
            "conventions",
            "e^{-i w t}, pressure as complex peak; ARP positive into the surface; displacement positive outward",
        ),
    ]  # fmt: skip
    stream = io.StringIO()
    grid = Table(show_header=False)
    for name, text in rows:
        grid.add_row(name, text)
    Console(file=stream, width=130).print(grid)
    return stream.getvalue()
