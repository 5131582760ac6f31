"""A disc of 40 mm on a slide over an array, quick to step: the base of tests and malformed inputs."""

from pathlib import Path

ARRAYS = Path(__file__).resolve().parents[2] / "mjcf" / "arrays"

PLAIN = """
<mujoco model="small_plain">
  <include file="{arrays}/uhev1.xml"/>
  <worldbody>
    <body name="pad" pos="0 0 0.12" quat="0 1 0 0" gravcomp="1">
      <joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>
      <site name="centre" size="0.001"/>
      <geom type="cylinder" size="0.02 0.004" pos="0 0 -0.004" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""

HAPTIC = """
<mujoco model="small">
  <include file="plain.xml"/>
  <option timestep="0.001"/>
  <custom>
    <numeric name="palmfield_duration_s" data="{duration_s}"/>
    <text name="palmfield_device" data="{device}"/>
  </custom>
  <extension>
    <plugin plugin="palmfield.array"><instance name="array">{array}</instance></plugin>
    <plugin plugin="palmfield.stimulus"><instance name="stimulus">{stimulus}</instance></plugin>
    <plugin plugin="palmfield.skin"><instance name="skin">{skin}</instance></plugin>
    <plugin plugin="palmfield.driver"><instance name="driver">{driver}</instance></plugin>
  </extension>
  <sensor><plugin name="skin" plugin="palmfield.skin" instance="skin" objtype="site" objname="centre"/></sensor>
</mujoco>
"""

DEFAULTS: dict[str, dict[str, object]] = {
    "array": {},
    "stimulus": {
        "focus_m": "0 0 0.12", "modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200, "am_depth": 1,
    },
    "skin": {
        "body": "pad", "shape": "disc", "radius_m": 0.02, "thickness_m": 0.008, "material": "ecoflex_00-10",
        "side": "free", "element_m": 0.006, "step_s": 0.0005,
    },
    "driver": {"board": "ideal"},
}  # fmt: skip


def small_scene_texts(duration_s: float = 0.015, device: str = "cpu", **changes: dict[str, object]) -> tuple[str, str]:
    """Return the plain scene, to be saved as plain.xml, and the haptic scene that includes it.

    changes: by kind of plugin, changed keys (None removes a key), such as skin={"base": "free_slip"}
    """
    texts = {}
    for module, defaults in DEFAULTS.items():
        keys = defaults | changes.get(module, {})
        texts[module] = "".join(f'<config key="{k}" value="{v}"/>' for k, v in keys.items() if v is not None)
    return PLAIN.format(arrays=ARRAYS), HAPTIC.format(device=device, duration_s=duration_s, **texts)
