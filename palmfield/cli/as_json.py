"""What commands print with --json: names are stable and carry units, nothing else goes to standard output."""

import json
from typing import Any

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.estimate.summary import array_numbers
from palmfield.outputs.netcdf import plain
from palmfield.session.preview import Preview
from palmfield.skin.materials.material import complex_shear


def print_json(facts: dict[str, Any]) -> None:
    """One JSON object on standard output."""
    print(json.dumps(facts, indent=2, default=plain, allow_nan=False))


def scene_facts(view: Preview) -> dict[str, Any]:
    """What a scene contains, as `palmfield info` tells it. Keys of plugins have the names that scenes set.

    Of each array p0 [Pa m] and quality, with range and kind, as they count, whether its keys set them or not.

    Moduli are storage and loss at 200 Hz.
    """
    from palmfield.cli.describe import SOFTNESS_Hz

    model = view.runtime.model
    spec, air, carrier_Hz = model.spec, model.arrays.air, model.arrays.array.frequency_Hz
    known = array_numbers(model)
    arrays = [
        {
            "name": array.name,
            "layout": part.name,
            "transducers": len(part),
            "carrier_Hz": part.frequency_Hz,
            **known[array.name],
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
            "temperature_C": air.temperature_C,
            "humidity_percent": air.humidity_percent,
            "pressure_Pa": air.pressure_Pa,
            "sound_speed_m_s": sound_speed(air),
            "density_kg_m3": density(air),
            "absorption_Np_m": absorption_Np_m(air, carrier_Hz),
        },
        "arrays": arrays,
        "stimuli": stimuli,
        "skins": skins,
    }
