"""A package that is not palmfield adds a module by an entry point, as its users would."""

import os
import subprocess
import sys

PACKAGE = """
from typing import ClassVar
import mujoco
from pydantic import Field
from palmfield.config import Config
from palmfield.engine.host import Module, register

class MeterConfig(Config):
    plugin: ClassVar[str] = "thirdparty.meter"
    about: ClassVar[str] = "Integrates the time for which sound pushes a body."
    renamed: ClassVar[dict[str, str]] = {"limit_N": "threshold_N"}
    threshold_N: float = Field(0.0, ge=0)

class Meter(Module):
    name = "thirdparty.meter"
    config = MeterConfig
    sensor = True

    @classmethod
    def state_size(cls, settings, model):
        return 1

    @classmethod
    def sensor_size(cls, settings, model, sensor):
        return 1

    def advance(self):
        skin = next(m for m in self.world.modules.values() if m.name == "palmfield.skin")
        if (skin.applied @ skin.applied) ** 0.5 > self.settings.threshold_N:
            self.world.state(self.instance)[0] += self.world.model.timestep

    def sense(self):
        for *_, data in self.world.sensors(self.instance):
            data[0] = self.world.state(self.instance)[0]

def register_all():
    register(Meter)
"""


def test_a_module_from_another_package(small_scene, tmp_path):
    site = tmp_path / "site"
    info = site / "thirdparty-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "thirdparty.py").write_text(PACKAGE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: thirdparty\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[mujoco.plugins]\nthirdparty = thirdparty:register_all\n")
    path = small_scene(stimulus={"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None})
    sensor = '<plugin name="meter" plugin="thirdparty.meter" instance="meter" objtype="body" objname="pad"/></sensor>'
    text = path.read_text().replace("</sensor>", sensor)
    text = text.replace(
        "</extension>",
        '<plugin plugin="thirdparty.meter"><instance name="meter"><config key="threshold_N" value="THRESHOLD"/>'
        '</instance></plugin></extension>',
    )  # fmt: skip
    path.write_text(text.replace("THRESHOLD", "1e-6"))
    bad = path.with_name("bad.xml")
    bad.write_text(text.replace("THRESHOLD", "-1"))
    old = path.with_name("old.xml")
    old.write_text(text.replace("threshold_N", "limit_N"))
    code = (
        "import mujoco\n"
        f"m = mujoco.MjModel.from_xml_path({str(path)!r})\nd = mujoco.MjData(m)\n"
        "for _ in range(4): mujoco.mj_step(m, d)\n"
        "mujoco.mj_forward(m, d)\nprint(d.sensor('meter').data[0])\n"
        f"for scene in ({str(bad)!r}, {str(old)!r}):\n"
        "  try: mujoco.MjModel.from_xml_path(scene)\n"
        "  except ValueError as e: print(e)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env=environment, check=True
    )
    first, *rest = done.stdout.splitlines()
    assert float(first) == 0.004
    assert "key 'threshold_N' has value '-1'; allowed: finite number >= 0" in " ".join(rest)
    assert "key 'limit_N' is renamed: use threshold_N" in " ".join(rest)
