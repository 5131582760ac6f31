"""Write mjcf/hands/<preset>.xml and the articulated hand articulated_<preset without open_>.xml.

python scripts/make_hand_mjcf.py [PRESET ...]    default: open_men_p50
"""

import sys

from hands.preset_mjcf import articulated_mjcf, hand_mjcf

from palmfield.data import folder
from palmfield.hand.preset import load_preset

for name in sys.argv[1:] or ["open_men_p50"]:
    preset = load_preset(name)
    for target, text in (
        (name, hand_mjcf(preset)),
        (f"articulated_{name.removeprefix('open_')}", articulated_mjcf(preset)),
    ):
        path = folder("mjcf") / "hands" / f"{target}.xml"
        path.write_text(text, encoding="utf-8")
        print(path)
