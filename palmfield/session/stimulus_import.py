"""Import a table of foci, an STM file or a pattern of Adaptics: write the table, and a scene that plays it."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from palmfield.config.stimulus import AM_KEYS, PATH_KEYS
from palmfield.errors import OutputError, SceneError, did_you_mean, naming
from palmfield.files import whole, writing
from palmfield.session.open_scene import compiled, instances_of, no_scene, opened
from palmfield.session.scene_edit import Edit, edited, indent_of, tag_of, without
from palmfield.session.scene_text import Element, elements_of
from palmfield.session.stimulus_export import KINDS
from palmfield.stimulus.adaptics import Sampling, read_adaptics
from palmfield.stimulus.autd3_stm import read_foci_stm, table_of_stm
from palmfield.stimulus.focus_table import FocusTable
from palmfield.stimulus.focus_table_file import focus_table, read_focus_table, write_focus_table
from palmfield.transforms import Transform

ARRAY, STIMULUS, SKIN = "palmfield.array", "palmfield.stimulus", "palmfield.skin"
REPLACED = (
    "path", "path_on", "on_skin", "focus_m", "foci_m", "foci_arp", "frame", "modulation", "burst_window",
    "burst_length_s", "burst_period_s", "burst_count", *PATH_KEYS, *AM_KEYS,
)  # fmt: skip
"""Keys for position and modulation of the focus, which the table replaces. Level, start and end are kept."""


@dataclass(frozen=True)
class Imported:
    """Result of an import. scene, table: the written files; keys: new keys; dropped: removed keys"""

    scene: Path
    table: Path
    stimulus: str
    keys: dict[str, str]
    dropped: tuple[str, ...]
    foci: int
    rows: int
    length_s: float
    rate_Hz: float


def read_stimulus(path: Path, sampling: Sampling | None = None) -> tuple[FocusTable, bool]:
    """Read a table (.csv), or convert an STM (.json) or a pattern (.adaptics). Return it, and whether it repeats.

    sampling: only for a pattern
    Raises SceneError for an unknown suffix, and the errors of `read_focus_table`, `read_foci_stm`, `table_of_stm` and
    `read_adaptics`.
    """
    kind = path.suffix.lower()
    if kind == ".adaptics":
        return read_adaptics(path, sampling), False
    if sampling is not None and kind in KINDS:
        raise SceneError(f"{path}: --rate, --duration and --set-parameter apply only to .adaptics; omit them")
    match kind:
        case ".csv":
            return read_focus_table(path), False
        case ".json":
            stm = read_foci_stm(path)
            with naming(f"{path}"):
                return table_of_stm(stm), stm.loop == "infinite"
    raise SceneError(f"{path}: the kind of the file is '{path.suffix}'; allowed: {', '.join(KINDS.values())}")


def import_stimulus(
    file: Path,
    scene: Path,
    out: Path | None = None,
    *,
    stimulus: str | None = None,
    site: str | None = None,
    repeat: bool = False,
    overwrite: bool = False,
    sampling: Sampling | None = None,
) -> Imported:
    """Write a scene whose stimulus plays a file, and write the table to the same folder.

    out: new scene, in the folder of the old scene; default SCENE_FILE.xml
    stimulus: instance, needed if the scene has several
    site: site whose frame is used by a table with frame `skin`
    repeat: whether the table restarts at its end (an STM without end always does)
    overwrite: whether existing files may be replaced; sampling: for a pattern of Adaptics
    Raises SceneError for an invalid file or scene, for a moving array with a table in the world frame, and for errors
    of the new scene; OutputError if a file may not be replaced.
    """
    if not scene.is_file():
        raise SceneError(no_scene(scene))
    table, again = read_stimulus(file, sampling)
    target = scene.with_name(f"{scene.stem}_{file.stem}.xml") if out is None else out
    if target.resolve().parent != scene.resolve().parent:
        raise OutputError(f"--out has value {target}; allowed: a file in {scene.resolve().parent}, because "
                          "included files are relative to that folder")  # fmt: skip
    table_file = target.with_name(f"{target.stem}_foci.csv")
    for one in (target, table_file):
        if one.exists() and not overwrite:
            raise OutputError(f"{one} exists and would be replaced; give another file by --out, or --overwrite")
    name = _instance(scene, stimulus)
    if table.frame == "world":
        table = _in_array(table, scene, name)
    elif table.frame == "skin":
        site = _site(scene, site)
    elif site is not None:
        raise SceneError(f"--site has value '{site}', but the frame of the table is '{table.frame}'; omit --site")
    keys = {"path": "file", "path_file": table_file.name}
    keys |= {"path_end": "jump"} if again or repeat else {}
    keys |= {"frame": site} if table.frame == "skin" and site is not None else {}
    data, dropped = _rewritten(scene, name, keys)
    with tempfile.TemporaryDirectory() as folder:
        # The new scene is checked before any file is written
        trial = Path(folder) / "foci.csv"
        write_focus_table(trial, table)
        changes: dict[str, object] = {f"{name}.{key}": None for key in dropped if key not in keys}
        changes |= {f"{name}.{key}": value for key, value in keys.items()} | {f"{name}.path_file": str(trial)}
        compiled(scene, keys=changes)
    write_focus_table(table_file, table)
    with writing(target), whole(target) as part:
        part.write_bytes(data)
    return Imported(target, table_file, name, keys, dropped, table.foci, len(table.samples), table.length_s,
                    table.rate_Hz)  # fmt: skip


def _instance(scene: Path, stimulus: str | None) -> str:
    names = [one.name for one in instances_of(scene, {})[0] if one.plugin == STIMULUS]
    if stimulus is None and len(names) == 1:
        return names[0]
    if stimulus in names:
        return str(stimulus)
    what = "has several stimuli" if stimulus is None else f"has no stimulus '{stimulus}'{did_you_mean(stimulus, names)}"
    raise SceneError(f"{scene} {what}; give --stimulus, one of: {', '.join(names)}")


def _site(scene: Path, site: str | None) -> str:
    """Return the site for a table with frame `skin`: the requested one, or the only one on the body of a skin."""
    spec = opened(scene).spec
    bodies = {one.keys.get("body") for one in instances_of(scene, {})[0] if one.plugin == SKIN}
    sites = [one.name for one in spec.sites if one.parent.name in bodies]
    if site is None and len(sites) == 1:
        return sites[0]
    names = [one.name for one in spec.sites if one.name]
    if site in names:
        return str(site)
    what = "is not given" if site is None else f"has value '{site}'{did_you_mean(site, names)}"
    raise SceneError(
        f"the frame of the table is 'skin', but --site {what}; allowed: a site of the hand in {scene}: "
        f"{', '.join(sites or names)}"
    )


def _in_array(table: FocusTable, scene: Path, stimulus: str) -> FocusTable:
    """Transform a table from the world frame to that of the first array of the stimulus."""
    listed = instances_of(scene, {})[0]
    named = next(one.keys.get("arrays", "") for one in listed if one.name == stimulus).split()
    array = next(one for one in listed if one.plugin == ARRAY and (not named or one.name == named[0]))
    _, model, data = compiled(scene)
    mujoco.mj_kinematics(model, data)
    site = model.site(array.keys.get("site", "array"))
    body = int(site.bodyid[0])
    if model.body_weldid[body] != 0 or model.body_mocapid[body] >= 0:
        raise SceneError(
            f"the frame of the table is 'world', but array '{array.name}' of {scene} can move and has no fixed "
            "pose there; give a table with frame array"
        )
    frame = Transform(data.site_xpos[site.id].copy(), data.site_xmat[site.id].reshape(3, 3).copy())
    places = frame.inverse_points(table.positions.reshape(-1, 3)).reshape(table.positions.shape)
    return replace(
        focus_table(
            table.times, np.round(places, 12), table.intensities, rate_Hz=table.rate_Hz, quantity=table.quantity,
            between=table.between,
        ),
        frame="array",
    )  # fmt: skip


def _rewritten(scene: Path, stimulus: str, keys: dict[str, str]) -> tuple[bytes, tuple[str, ...]]:
    """Return the scene file with changed keys of a stimulus, and the names of the removed keys."""
    data, elements = scene.read_bytes(), elements_of(scene)
    instance = next((e for e in elements if e.tag == "instance" and _is(e, stimulus)), None)
    if instance is None:
        raise SceneError(f"{scene} includes the file that defines stimulus '{stimulus}'; import into that file")
    own = [e for e in elements if e.parent is instance and e.tag == "config"]
    replaced = [e for e in own if e.attributes.get("key") in REPLACED]
    edits = [without(data, element) for element in replaced]
    lines = [f"<config key={quoteattr(key)} value={quoteattr(value)}/>" for key, value in keys.items()]
    start = tag_of(data, instance)
    indent = indent_of(data, own[0]) if own else b""
    text = b"".join(indent + line.encode() for line in lines)
    if start[0].endswith(b"/>"):
        edits.append(Edit(start.end() - 2, start.end(), b">" + text + b"</instance>"))
    else:
        edits.append(Edit(start.end(), start.end(), text))
    return edited(data, edits), tuple(e.attributes["key"] for e in replaced)


def _is(element: Element, name: str) -> bool:
    plugin = element.within("plugin")
    return element.attributes.get("name") == name and plugin is not None and plugin.attributes.get("plugin") == STIMULUS
