"""Write mjcf/hands/<preset>.xml for the presets named on the command line (default: open_men_p50)."""

import sys

from palmfield.data import folder
from palmfield.hand.mjcf import hand_mjcf
from palmfield.hand.preset import load_preset

for name in sys.argv[1:] or ["open_men_p50"]:
    target = folder("mjcf") / "hands" / f"{name}.xml"
    target.write_text(hand_mjcf(load_preset(name)), encoding="utf-8")
    print(target)
