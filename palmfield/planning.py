"""What a scene needs to be modelled, what is left out and why, and what it costs; decided before anything runs."""

import io
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from palmfield.acoustics import validity
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import LAWS
from palmfield.foresight import SHARE, STILL, factor_s
from palmfield.obstacle import BODY_SOUNDS
from palmfield.report import RATIO, PUBLISHED_P0_Pa_m, compares_with_finer, p0_band, p0_given
from palmfield.rig import Rig
from palmfield.scene import Scene
from palmfield.skin.from_config import cutoff_Hz, sheets_in_words
from palmfield.skin.materials.material import shear_wave
from palmfield.stimulus.schedule import frame_at, frame_rates, main_frequencies

# Measured on two cores of a server CPU (docs/bench/): pairs a second with gradient.
PAIRS_PER_S = 5e8
START_AND_PICTURES_S = 12.0
# One solution of the boundary elements, docs/bench/scattering.md: 20 iterations of all pairs of elements, and set-up
SCATTER_PAIR_S = 2e-8
SCATTER_ELEMENT_S = 1e-4


@dataclass(frozen=True)
class Row:
    """One decision. size: what it amounts to (resolution, error bound or cost); why: the reason, in words."""

    what: str
    size: str
    why: str


@dataclass(frozen=True)
class Plan:
    """Decisions for a scene. seconds: expected wall time of `palmfield run` on two CPU cores, pictures included."""

    scene: str
    modelled: tuple[Row, ...]
    left_out: tuple[Row, ...]
    error: tuple[Row, ...]
    seconds: float
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        stream = io.StringIO()
        console = Console(file=stream, width=130)
        console.print(f"Plan for {self.scene}", highlight=False)
        for title, rows in (
            ("Modelled", self.modelled),
            ("Left out", self.left_out),
            ("Expected error of the skin displacement", self.error),
        ):
            grid = Table("what", "size", "why", title=title, title_justify="left")
            for row in rows:
                grid.add_row(row.what, row.size, row.why)
            console.print(grid)
        for warning in self.warnings:
            console.print(f"Warning: {warning}", highlight=False)
        console.print(f"Expected time on two CPU cores: {self.seconds:.0f} s", highlight=False)
        return stream.getvalue()


def plan(scene: Scene) -> Plan:
    """Decide what to model, from the scene's stimulus, surface and accuracy; simulates nothing.

    Raises SceneError where the skin patch cannot be made.
    """
    rig = scene.skin.rig
    substeps = round(scene.duration_s / rig.sizes[4])
    dofs = rig.dofs
    pairs = _points_a_step(rig) * len(rig.array) * scene.duration_s / rig.timestep_s
    seconds = START_AND_PICTURES_S + _estimate_s(rig, dofs) + rig.choice.seconds + pairs / PAIRS_PER_S
    seconds += _solutions(scene) * _scatter_s(rig)
    return Plan(
        str(scene.path), _modelled(rig, dofs, substeps), _left_out(rig), _errors(rig), seconds, tuple(warnings(scene))
    )


def warnings(scene: Scene) -> list[str]:
    """What a user should know before the run, in words."""
    skin = scene.skin
    rig = skin.rig
    pose = skin.pose()
    focus = np.atleast_2d(skin.to_array(frame_at(rig.stimulus, rig.stimulus.start_s).focus))[0]
    nodes = pose.points(rig.posed(pose).nodes[0])
    distance = float(np.linalg.norm(nodes - focus, axis=1).min())
    found = []
    if distance > max(rig.spot_fwhm_m, 2 * rig.sizes[1]):
        found.append(f"the focus is {1e3 * distance:.0f} mm away from the skin layer, which then hardly moves")
    if rig.skin_path is not None:
        assert rig.surface is not None
        path = rig.skin_path.positions(rig.skin_path.arc_m, rig.surface.vertices, rig.surface.faces)
        apart = cKDTree(rig.mesh.nodes[: rig.mesh.surface_nodes]).query(path)[0]
        beyond = apart > 2.0 * rig.sizes[1]
        if beyond.any():
            first = 1e3 * rig.skin_path.arc_m[beyond.argmax()]
            found.append(
                f"{100 * beyond.mean():.0f} % of the path's points, from {first:.0f} mm on, have no skin layer under "
                "them: necks narrower than its coarse edges are left out; set element_m smaller, or another patch_site"
            )
    drive, _ = rig.unit_drive(rig.reference_focus)
    pressure = rig.reference_emitter.pressure64(rig.reference_focus[None], drive)
    if rig.skin.body_sound == "scattering" and _can_move(scene):
        found.append(
            f"body_sound scattering on body '{rig.skin.body}', which can move: each pose takes about "
            f"{_scatter_s(rig):.2g} s, {_solutions(scene)} poses {_solutions(scene) * _scatter_s(rig):.0f} s"
        )
    cutoff = cutoff_Hz(rig.skin, rig.sheets, float(np.median(rig.patch.depth)))
    low = [f for f in main_frequencies(rig.stimulus) if cutoff is not None and f < cutoff]
    if low:
        found.append(
            f"no waves are promised at {', '.join(f'{f:g}' for f in low)} Hz: the skin layer carries none below its "
            f"cut-off c_s/4h = {cutoff:.0f} Hz, so that the motion stays near the focus"
        )
    return found + validity.warnings(rig.array, rig.reference_focus, pressure, rig.air)


def _can_move(scene: Scene) -> bool:
    """Whether body or arrays have degrees of freedom or are moved as mocap bodies, or lie on a body that is."""
    model = scene.model
    bodies = {scene.skin.body, *(int(model.site_bodyid[site]) for site in scene.skin.sites)}
    for numbers in scene.skin.transducers:
        bodies |= {int(body) for body in model.site_bodyid[numbers]}
    for body in bodies:
        while body > 0:
            if model.body_dofnum[body] > 0 or model.body_mocapid[body] >= 0:
                return True
            body = int(model.body_parentid[body])
    return False


def _solutions(scene: Scene) -> int:
    """Solutions by boundary elements in a run: one a pose, the loudest again, and a disc's other mesh in the report."""
    rig = scene.skin.rig
    if rig.skin.body_sound != "scattering":
        return 0
    poses = round(scene.duration_s / rig.timestep_s) + 1 if _can_move(scene) else 1
    return poses + (rig.skin.shape == "disc")


def _scatter_s(rig: Rig) -> float:
    """Seconds of one solution by boundary elements on two CPU cores."""
    if rig.skin.body_sound != "scattering":
        return 0.0
    elements = len(rig.posed(rig.reference_pose).boundary_mesh[1])
    return SCATTER_PAIR_S * elements**2 + SCATTER_ELEMENT_S * elements


def _estimate_s(rig: Rig, dofs: int) -> float:
    """Seconds of the run's error estimate (palmfield/report.py)."""
    more = RATIO**3
    low, high = (dofs, more * dofs) if compares_with_finer(rig, dofs) else (dofs / more, dofs)
    # A complex factorisation counts twice; the time step's own is left out where a small model steps.
    edge = 0 if rig.skin.shape == "disc" else 2
    step = 2 if rig.choice.name == "full" else 0
    return (3 + step + edge) * factor_s(low) + 3 * factor_s(high)


def _points_a_step(rig: Rig) -> float:
    skin = 6 * len(rig.mesh.surface_triangles6)
    body = 0 if rig.surface is None else len(rig.surface.faces)
    moving = rig.stimulus.path != "point" and not frame_rates(rig.stimulus)
    changes = round(rig.timestep_s / rig.sizes[4]) if moving else 1
    return changes * (skin + rig.mesh.surface_nodes) + body


def _modelled(rig: Rig, dofs: int, substeps: int) -> tuple[Row, ...]:
    fine, coarse, _, fractions, step, radius = rig.sizes
    surface = f"{6 * len(rig.mesh.surface_triangles6)} skin points"
    if rig.surface is not None:
        surface += f", {len(rig.surface.faces)} faces of the surface for the force"
    depth = rig.patch.depth
    speed, _ = shear_wave(rig.material, rig.max_frequency_Hz)
    drive = rig.unit_drive(rig.reference_focus)[1]
    return (
        Row(
            "sound field",
            f"{len(rig.array)} transducers, {surface}",
            f"pressure and gradient where the surface is, no volume; {_directivity(rig)}; air absorption",
        ),
        Row("drive", f"amplitude {drive:.3f} of full", f"device {rig.device.name}: {rig.device.description}"),
        Row("ARP", f"law {rig.skin.arp_law}", LAWS[rig.skin.arp_law]),
        Row("sound at the body", f"body_sound {rig.skin.body_sound}", BODY_SOUNDS[rig.skin.body_sound]),
        *_rings(rig),
        Row(
            "skin layer",
            f"radius {1e3 * radius:.0f} mm, {1e3 * depth.min():.1f}-{1e3 * depth.max():.1f} mm deep",
            f"the part of the surface where waves matter at this accuracy{_thinned(rig)}; sides "
            f"{rig.skin.side}, base {'on a foundation' if rig.skin.foundation else rig.skin.base}; of "
            + sheets_in_words(rig.sheets),
        ),
        Row(
            "elements",
            f"{len(rig.mesh.elements)} quadratic wedges, {dofs} unknowns, edge {1e3 * fine:.1f}-{1e3 * coarse:.1f} mm, "
            f"{len(fractions) - 1} through the depth",
            f"spot {1e3 * rig.spot_fwhm_m:.1f} mm wide, shear wave {1e3 * speed / rig.max_frequency_Hz:.0f} mm long at "
            f"{rig.max_frequency_Hz:.0f} Hz",
        ),
        Row(
            "error estimate",
            f"about {_estimate_s(rig, dofs):.0f} s",
            f"the same load on elements {RATIO} x smaller or larger, static and harmonic",
        ),
        Row(
            "time",
            f"{substeps} steps of {1e3 * step:.3g} ms in MuJoCo steps of {1e3 * rig.timestep_s:.3g} ms",
            "the sound or the pose changes, so a static answer will not do",
        ),
        _solver(rig),
    )


def _solver(rig: Rig) -> Row:
    chosen = rig.choice
    if chosen.name == "full":
        return Row("skin solver full", f"about {chosen.seconds:.0f} s", f"wedges, factorised once; {chosen.why}")
    limit = STILL * rig.skin.accuracy * rig.spot_fwhm_m
    return Row(
        "skin solver reduced",
        f"about {chosen.seconds:.0f} s, full about {chosen.full_s:.0f} s",
        f"{chosen.why}; made for this stimulus, to {100 * SHARE * rig.skin.accuracy:.2g} %, while body, arrays and "
        f"focus move by less than {1e6 * limit:.0f} um; beyond, "
        + ("the run ends" if rig.skin.solver == "reduced" else "the whole layer goes on"),
    )


def _directivity(rig: Rig) -> str:
    """What the transducers are off their axes, in words."""
    words = []
    for kind in rig.reference_emitter.kinds:
        if kind.array.directivity_table is not None:
            words.append("measured directivity")
        elif kind.array.piston_radius_m == 0.0:
            words.append("point sources")
        else:
            words.append(f"pistons of {1e3 * kind.array.piston_radius_m:g} mm radius")
    return " and ".join(words)


def _qualities(rig: Rig) -> str:
    return "Q " + " and ".join(f"{q:g}" for q in sorted({board.config.quality for board in rig.boards}))


def _rings(rig: Rig) -> list[Row]:
    heard = rig.response
    if not heard.on:
        return []
    late = f", flight times spread over {1e3 * heard.spread_s:.2f} ms" if heard.delays_s.any() else ""
    return [
        Row(
            "transducers' ring-up",
            f"one pole each, {_qualities(rig)}{late}",
            f"without, the pressure would be off by {heard.ring}, measured on samples of the drive"
            + (f"; without the flight times by {heard.late}" if late else ""),
        )
    ]


def _thinned(rig: Rig) -> str:
    share = rig.patch.report.get("share_thinned", 0.0)
    return f", thinner than asked at {100 * share:.0f} % of its vertices (curved rims and webs)" if share > 0 else ""


def _left_out(rig: Rig) -> tuple[Row, ...]:
    far = np.linalg.norm(rig.array.positions - rig.reference_focus, axis=1)
    drive, _ = rig.unit_drive(rig.reference_focus)
    pressure = abs(rig.reference_emitter.pressure64(rig.reference_focus[None], drive)[0])
    shock = validity.shock_distance_m(pressure, rig.air, rig.array.frequency_Hz)
    rows = _sound_left_out(rig)
    rows += [
        Row(
            "nonlinear sound",
            f"focal distance / shock distance {far.mean() / shock:.2f}",
            f"a plane wave of the focus's {pressure:.0f} Pa; beyond 0.3 expect less than this linear field gives",
        ),
        Row("large strain", "not estimated", "linear elasticity; micrometres on a layer of millimetres"),
        *_cutoff_row(rig),
    ]
    if rig.surface is not None:
        rows.append(Row("skin elsewhere", "not modelled", "only the resultant force acts on the rest of the body"))
    return tuple(rows)


def _cutoff_row(rig: Rig) -> list[Row]:
    depth = float(np.median(rig.patch.depth))
    cutoff = cutoff_Hz(rig.skin, rig.sheets, depth)
    if cutoff is None:
        return []
    rigid = rig.skin.base == "bonded" and rig.skin.foundation is None
    return [
        Row(
            "waves below the cut-off",
            f"c_s/4h = {cutoff:.0f} Hz" + ("" if rigid else " at most"),
            f"h {1e3 * depth:.1f} mm, the median; a layer bonded to rigid bone guides no wave below this, motion there "
            "stays local" + ("" if rigid else "; the springs below it lower it"),
        )
    ]


def _sound_left_out(rig: Rig) -> list[Row]:
    rows = []
    if rig.skin.body_sound == "none":
        rows.append(
            Row("cast shadows", "nothing on the open hand there", "one part of the body does not shade another")
        )
    if rig.skin.body_sound != "scattering":
        rows.append(
            Row(
                "scattered sound",
                "4 % of the ARP on an open hand, 8 % on a finger, 16 % in a cup, more than half on skin turned away",
                "relative L2, face by face, on the bodies of docs/bench/scattering.md, not on this one: the law takes "
                "the wall as locally flat and rigid; no echo between parts, or between hand and array",
            )
        )
    heard = rig.response
    if not heard.on:
        rows.append(
            Row(
                "transducers' ring-up",
                f"{heard.ring} of the pressure",
                f"measured on samples of the drive; one pole, {_qualities(rig)}: a delay of "
                f"{1e3 / heard.pole.damping.min():.2f} ms",
            )
        )
    if not heard.delays_s.any():
        rows.append(
            Row(
                "spread of the flight time",
                f"{heard.late} of the pressure",
                f"measured on samples of the drive; {1e3 * heard.spread_s:.3f} ms between the first and the last "
                "transducer's sound",
            )
        )
    middle = 0.5 * np.ptp(np.linalg.norm(rig.array.positions - rig.reference_focus, axis=1))
    late = (np.linalg.norm(rig.array.positions - rig.reference_focus, axis=1).min() + middle) / sound_speed(rig.air)
    if rig.setting.moves or rig.hand is not None:
        rows.append(
            Row(
                "the hand's own acceleration",
                "rho a h of shear on the base: 11 Pa for 1 m/s^2 on 10 mm",
                "not modelled: displacements are in the moving frame, and its load is as slow as the motion",
            )
        )
    if rig.hand is not None:
        rows.append(
            Row(
                "skin bent by joints",
                "not estimated",
                "the layer keeps its resting shape, the sound meets the bent one",
            )
        )
    rows.append(Row("common flight time", f"{1e3 * late:.2f} ms", "shifts results in time"))
    return rows


def _errors(rig: Rig) -> tuple[Row, ...]:
    rows = [
        Row(
            "mesh and time step",
            f"{100 * rig.skin.accuracy:g} % wanted",
            "sizes follow a convergence study on a disc (docs/bench/skin_c0.md); the run estimates what was reached",
        ),
        *(
            Row("material", "of the order of 50 %", f"{sheet.material.name}: {sheet.material.source}")
            for sheet in rig.sheets
        ),
    ]
    band = p0_band(rig)
    if rig.stimulus.arp_peak_Pa is not None:
        rows.append(Row("p0", "none", "arp_peak_Pa sets the level"))
    elif band is not None:
        published = "{:g} to {:g} Pa m".format(*PUBLISHED_P0_Pa_m)
        rows.append(
            Row(
                "p0",
                f"x {band[0]:.2f} to x {band[1]:.2f}",
                "displacement goes with p0 squared; the given range"
                if p0_given(rig)
                else f"displacement goes with p0 squared; where no range is given, published values: {published}",
            )
        )
    return tuple(rows)
