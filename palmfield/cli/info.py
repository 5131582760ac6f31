"""`palmfield info`: show the contents of a scene, as text or JSON."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from palmfield.cli.as_json import print_json
from palmfield.cli.options import Accuracy, AsJson, Device, Keys, SceneFile, parsed_keys

if TYPE_CHECKING:
    from palmfield.session.preview import Preview
    from palmfield.simulation.model import HapticModel, SkinModel
    from palmfield.types import Estimate

Rows = list[tuple[str, str]]
SOFTNESS_Hz = 200.0
"""Frequency at which the modulus of a material is reported."""


def info(
    scene: SceneFile, device: Device = None, accuracy: Accuracy = None, keys: Keys = None, as_json: AsJson = False
) -> None:
    """Show what a scene contains: arrays, air, stimuli, surfaces, skins, materials, laws and conventions.

    Example: palmfield info mjcf/scenes/phantom_step.xml
    """
    from palmfield.session.preview import preview

    view = preview(scene, device=device, accuracy=accuracy, keys=parsed_keys(keys))
    if as_json:
        print_json(scene_facts(view))
    else:
        print(describe(view), end="")


def scene_facts(view: "Preview") -> dict[str, Any]:
    """Return the contents of a scene for `palmfield info`. Keys of plugins have the same names as in scenes.

    For each array, p0 [Pa m] and quality are the values in effect, from keys or defaults, with range and kind. Moduli
    are the storage and loss modulus at 200 Hz.
    """
    from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
    from palmfield.estimate.summary import array_numbers
    from palmfield.skin.materials.material import complex_shear

    model = view.runtime.model
    spec, air, carrier_Hz = model.spec, model.arrays.air, model.arrays.array.frequency_Hz
    estimates = array_numbers(model)
    arrays = [
        {
            "name": array.name,
            "layout": part.name,
            "transducers": len(part),
            "carrier_Hz": part.frequency_Hz,
            **estimates[array.name],
            "keys": array.config.model_dump(),
        }
        for array, part in zip(spec.arrays, model.arrays.parts, strict=True)
    ]
    stimuli = [
        {
            "name": stimulus.spec.name,
            "arrays": [spec.arrays[number].name for number in stimulus.spec.arrays],
            "keys": stimulus.spec.config.model_dump(),
        }
        for stimulus in model.stimuli
    ]
    skins = []
    for skin in model.skins:
        sheets = []
        for sheet in skin.layer.sheets:
            modulus = complex_shear(sheet.material, SOFTNESS_Hz)
            sheets.append(
                {
                    "material": sheet.material.name,
                    "source": sheet.material.source,
                    "share_of_layer": sheet.thickness_m,
                    "density_kg_m3": sheet.material.density_kg_m3,
                    "shear_storage_200_Hz_Pa": modulus.real,
                    "shear_loss_200_Hz_Pa": -modulus.imag,
                }
            )
        skins.append(
            {
                "name": skin.spec.name,
                "solver": skin.choice.name,
                "solver_why": skin.choice.why,
                "sheets": sheets,
                "keys": skin.spec.config.model_dump(),
            }
        )
    return {
        "scene": view.name,
        "duration_s": view.duration_s,
        "timestep_s": spec.timestep_s,
        "device": spec.device,
        "board": model.board.name,
        "air": {
            **asdict(air),
            "sound_speed_m_s": sound_speed(air),
            "density_kg_m3": density(air),
            "absorption_Np_m": absorption_Np_m(air, carrier_Hz),
        },
        "arrays": arrays,
        "stimuli": stimuli,
        "skins": skins,
    }


def describe(scene: "Preview") -> str:
    """Describe a scene as a table: arrays, air, stimuli, skins, materials, laws and conventions."""
    from palmfield.terminal import printed, table

    model = scene.runtime.model
    spec = model.spec
    rows = [("scene", f"{scene.name}, {scene.duration_s:g} s in steps of {1e3 * spec.timestep_s:g} ms")]
    rows += _arrays(model)
    for number, stimulus in enumerate(model.stimuli):
        rows += _named(stimulus.spec.name, len(model.stimuli), _drive(model, number))
    for skin in model.skins:
        rows += _named(skin.spec.name, len(model.skins), _skin(skin))
    signs = "e^{-i w t}, pressure as complex peak; ARP positive into the surface; displacement positive outward"
    rows.append(("conventions", signs))
    return printed(table(rows), most=130)


def _named(name: str, count: int, rows: Rows) -> Rows:
    """Add the name of the instance to the rows if there are several instances of its kind."""
    return rows if count == 1 else [(f"{what} ({name})", text) for what, text in rows]


def _arrays(model: "HapticModel") -> Rows:
    from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
    from palmfield.simulation.model import array_instances

    rows: Rows = []
    count = len(model.spec.arrays)
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        about = f"{part.name}: {len(part)} transducers, {part.frequency_Hz / 1e3:g} kHz"
        rows += _named(array.name, count, [("array", about)])
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        uncertain = [("p0", instance.p0, " Pa m"), ("quality", instance.quality, "")]
        estimates = [(what, _estimate(one, unit)) for what, one, unit in uncertain]
        if instance.calibration is None:
            estimates[0] = estimates[0][0], f"uncalibrated: {estimates[0][1]}"
        rows += _named(array.name, count, estimates)
    air, carrier_Hz = model.arrays.air, model.arrays.array.frequency_Hz
    weather = (
        f"{air.temperature_C:g} C, {air.humidity_percent:g} %, {air.pressure_Pa:g} Pa: c {sound_speed(air):.1f} m/s, "
        f"rho {density(air):.3f} kg/m3, absorption {absorption_Np_m(air, carrier_Hz):.3f} Np/m"
    )
    device = f"fields are computed on {model.spec.device} (palmfield_device)"
    return [*rows, ("air", weather), ("device", device)]


def _estimate(one: "Estimate", unit: str) -> str:
    """Return a number with its range, kind and source."""
    return f"{one.value:g}{unit} ({one.low:g} to {one.high:g}), {one.kind}: {one.source}"


def _drive(model: "HapticModel", number: int) -> Rows:
    from palmfield.simulation.emission import array_drives

    stimulus = model.stimuli[number]
    keys = stimulus.spec.config.model_dump(exclude_none=True).items()
    rows = [("stimulus", ", ".join(f"{key} {value}" for key, value in keys if value != ()))]
    if len(model.spec.arrays) > 1:
        rows.append(("arrays driven", ", ".join(model.spec.arrays[i].name for i in stimulus.spec.arrays)))
    level = array_drives(model, model.arrays)[number].unit_drive(stimulus.first_focus).level
    return [*rows, ("drive", f"board {model.board.name}; amplitude {level:.4f} of full at the first focus")]


def _skin(skin: "SkinModel") -> Rows:
    from palmfield.skin.materials.material import complex_shear

    config = skin.spec.config
    rows = [("surface", f"{config.shape} on body '{config.body}'")]
    for sheet in skin.layer.sheets:
        material, modulus = sheet.material, complex_shear(sheet.material, SOFTNESS_Hz)
        share = "" if len(skin.layer.sheets) == 1 else f", {100 * sheet.thickness_m:.3g} % of the layer"
        described = f"{material.name}: rho {material.density_kg_m3:g} kg/m3, G*({SOFTNESS_Hz:g} Hz) "
        described += f"{modulus.real:.0f}{modulus.imag:+.0f}i Pa{share}"
        rows += [("material", described), ("material source", material.source)]
    return [
        *rows,
        ("solver", f"{skin.choice.name}: {skin.choice.why}"),
        ("ARP law", f"{config.arp_law}: {skin.spec.arp_law.about}"),
    ]
