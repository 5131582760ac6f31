"""`palmfield new`: write a scene that runs."""

import textwrap
from pathlib import Path
from typing import Annotated

import typer

from palmfield.data import folder
from palmfield.errors import OutputError, SceneError
from palmfield.files import made_folder, write_text

ARRAY, HAND = "arrays/uhev1.xml", "hands/open_men_p50.xml"

PLAIN = """<!-- {name}: an open hand, palm down, 200 mm over a 16x16 array. No plugins: opens in any MuJoCo. -->
<mujoco model="{name}_plain">
  <include file="{array}"/>
  <include file="{hand}"/>
  <statistic center="0 0 0.1" extent="0.4"/>
  <worldbody>
    <light pos="0.2 -0.4 0.6" dir="-0.3 0.5 -0.7"/>
  </worldbody>
</mujoco>
"""

HAPTIC = """<!-- {name}: run with `palmfield run {name}.xml`, or watch with `python -m mujoco.viewer`.
     `palmfield keys` lists every key; units are in the names. -->
<mujoco model="{name}">
  <include file="{name}_plain.xml"/>
  <option timestep="0.001"/>
  <custom>
    <numeric name="palmfield_duration_s" data="{duration}"/>
    <!-- Where fields are computed: auto, cpu or cuda:N. -->
    <text name="palmfield_device" data="auto"/>
  </custom>
  <extension>
    <plugin plugin="palmfield.array">
      <instance name="array">
        <config key="layout" value="{layout}"/>
        <!-- Peak pressure of one transducer at 1 m. The ARP and the motion are proportional to its square. For this
             layout, {p0} Pa m is {kind} (range {low} to {high}). After you have measured your array, use the first
             line with your calibration file, or the other lines with your numbers (docs/arrays.md).
        <config key="calibration" value="my_array.json"/>
        <config key="p0_Pa_m" value="{p0}"/>
        <config key="p0_low_Pa_m" value="{low}"/>
        <config key="p0_high_Pa_m" value="{high}"/>
        -->
      </instance>
    </plugin>
    <plugin plugin="palmfield.stimulus">
      <instance name="stimulus">
        <!-- The focus, in the array frame: z points out of the emitting face. A scene may have several arrays, stimuli
             and skins. Each is one more instance; results have its name. -->
        <config key="focus_m" value="0 0 0.2"/>
        {stimulus}
        <!-- The level: full drive unless you set drive_amplitude (0..1) or arp_peak_Pa. -->
      </instance>
    </plugin>
    <plugin plugin="palmfield.skin">
      <instance name="skin">
        <config key="body" value="hand"/>
        <config key="hand" value="open_men_p50"/>
        <!-- The skin layer is around this site of the hand, down to the bone or depth_m. -->
        <config key="patch_site" value="palm_centre"/>
        <config key="material" value="palm"/>
        <config key="accuracy" value="0.05"/>
      </instance>
    </plugin>
    <plugin plugin="palmfield.driver">
      <instance name="driver">
        <!-- ideal: any drive; sonicsurface: only drives that this board can play. -->
        <config key="board" value="ideal"/>
      </instance>
    </plugin>
  </extension>
  <sensor>
    <!-- ARP force (3), then normal displacement, velocity and ARP at the site. -->
    <plugin name="skin" plugin="palmfield.skin" instance="skin" objtype="site" objname="palm_centre"/>
  </sensor>
</mujoco>
"""

USUAL_S = 0.1
ABOUT_AM = "Amplitude modulation of the sound pressure by a sine; with am_quantity arp, of the radiation pressure."


def new(
    name: Annotated[str, typer.Argument(help="name of the scene; writes the folder NAME here")],
    stimulus: Annotated[
        str | None,
        typer.Option(
            help="a standard stimulus, see `palmfield stimulus standard` [default: AM at 200 Hz]", metavar="NAME"
        ),
    ] = None,
) -> None:
    """Write a commented scene that runs: a hand over an array and a 200 Hz focus on the palm, or another stimulus.

    NAME/NAME_plain.xml opens in any MuJoCo; NAME/NAME.xml adds the haptics and needs palmfield. The
    folder contains all files that they refer to, so that it can be moved and sent.

    Examples: palmfield new first && palmfield run first/first.xml

    palmfield new pressed --stimulus lm_small_steps
    """
    for path in write_scene(name, stimulus=stimulus):
        print(f"wrote {path}")
    print(f"next: palmfield run {Path(name) / name}.xml")


def write_scene(name: str, where: Path = Path(), stimulus: str | None = None) -> list[Path]:
    """Write the folder NAME with NAME.xml, NAME_plain.xml and the included array and hand; return the paths.

    stimulus: name of a standard stimulus (`palmfield.stimulus.standard`), whose duration is used too; None: AM at 200
    Hz The folder can be moved and sent, because its files refer only to each other.
    Raises SceneError for an invalid name and an unknown stimulus, OutputError if the folder exists or cannot be
    written.
    """
    from palmfield.acoustics.layouts import LAYOUTS
    from palmfield.stimulus.standard import standard

    if not name.replace("_", "").replace("-", "").isalnum():
        raise SceneError(f"scene name '{name}' is not usable; allowed: letters, digits, - and _")
    target = where / name
    if target.exists():
        raise OutputError(f"{target} already exists; choose another name, or move it")
    array, hand = (folder("mjcf") / file for file in (ARRAY, HAND))
    parts = {path.name: path.read_text(encoding="utf-8") for path in (array, hand)}
    names = {"name": name, "array": array.name, "hand": hand.name}
    p0 = LAYOUTS[array.stem].p0
    level = {"p0": f"{p0.value:g}", "low": f"{p0.low:g}", "high": f"{p0.high:g}", "kind": p0.kind}
    chosen = standard(stimulus or "am_200")
    comment = ABOUT_AM
    if stimulus is not None:
        comment = f"{chosen.name}: {chosen.about} {chosen.source} Published: {chosen.published}"
        comment += f" Chosen here: {chosen.assumed}" if chosen.assumed else ""
    keys = [f'<config key="{key}" value="{value}"/>' for key, value in chosen.texts().items()]
    wrapped = textwrap.fill(f"<!-- {comment} -->", 112, subsequent_indent="     ", break_on_hyphens=False)
    block = "\n".join([*wrapped.splitlines(), *keys]).replace("\n", "\n" + 8 * " ")
    duration = f"{USUAL_S if stimulus is None else chosen.duration_s:g}"
    haptic = HAPTIC.format(**names, **level, layout=array.stem, stimulus=block, duration=duration)
    texts = {f"{name}.xml": haptic, f"{name}_plain.xml": PLAIN.format(**names), **parts}
    made_folder(target)
    for file, text in texts.items():
        write_text(target / file, text)
    return [target / file for file in texts]
