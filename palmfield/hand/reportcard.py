"""Report card of a user's mesh: unit, size, side, faults and possible skin layers."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.files import write_text
from palmfield.hand.chirality import Chirality, chirality
from palmfield.hand.holes import plane_axes
from palmfield.hand.joint_tree import named_side
from palmfield.hand.layer import inward_directions, unfolded
from palmfield.hand.meshfile import Examined, examine, refusal
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.repair import MOST_PLACES, Finding
from palmfield.hand.scene_layers import scene_layers
from palmfield.hand.selfcross import crossings
from palmfield.hand.subdivide import EDGE_m
from palmfield.hand.triangles import (
    corner_angles,
    edge_lengths,
    face_normals,
    largest_part,
    unique_edges,
    vertex_normals,
    volume,
)
from palmfield.hand.units import DIGITS, size_of_a_hand
from palmfield.hand.wholelayer import hand_layer, percentile
from palmfield.types import Float, Int, Surface

VERDICTS = ("accepted", "accepted with doubts", "refused")
HAND_SIZES = "hands are 130 to 260 mm long, forearms with a hand 360 to 560"
THIN_SHARE, THIN_FACES = 0.025, 2000
"""Smallest median thickness of a hand as a share of its length; approximate number of faces at which it is sampled."""
LAYERS_m = (0.001, 0.002, 0.003, 0.005)
LAYER_FACTS = {
    "p10_share": "p10_share",
    "thinned_share": "area_thinned",
    "least_quality": "quality_min",
    "volume_share": "volume_share",
}
"""Names of the values of a layer in the card -> names in the report of `hand_layer`."""
PALMAR_COSINE = 0.3


@dataclass(frozen=True)
class ReportCard:
    """Report on a mesh. facts: as in the JSON file; mesh: repaired mesh; refusal: reason, or None if it is accepted;
    doubts: reasons why the mesh may not be a hand or may have local errors
    """

    facts: dict[str, Any]
    mesh: Examined
    refusal: str | None
    doubts: tuple[str, ...]


def report_card(path: str | Path, unit: str = "auto") -> ReportCard:
    """Examine a mesh as `palmfield hand` does; see `palmfield.hand.meshfile.examine` for repairs and errors.

    facts: file, verdict (of VERDICTS), accepted, refusal, doubts (texts), unit, unit_source, size_mm, vertices, faces,
    joints, edges_mm (smallest, mean, largest), least_angle_deg, self_intersections, findings (name, count, outcome,
    places_mm, text); for closed meshes also side, side_sureness, side_reason, volume_cm3, area_cm2, layers (asked_mm,
    p10_share, thinned_share, least_quality, volume_share, or error), and scene_layers (see
    `palmfield.hand.scene_layers.scene_layers`)
    """
    mesh = examine(path, unit, EDGE_m)
    findings = list(mesh.findings)
    no = refusal(path, findings) if any(f.outcome == "refused" for f in findings) else None
    length = 1e3 * edge_lengths(mesh.vertices, mesh.faces)[1]
    facts: dict[str, Any] = {
        "file": str(path),
        "unit": mesh.unit.name,
        "unit_source": mesh.unit.source,
        "size_mm": [round(1e3 * float(v), 2) for v in np.ptp(mesh.vertices, axis=0)],
        "file_vertices": mesh.file_vertices,
        "file_faces": mesh.file_faces,
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "joints": 0 if mesh.rig is None else len(mesh.rig.joints.names),
        "edges_mm": [round(float(v), 3) for v in (length.min(), length.mean(), length.max())],
        "least_angle_deg": round(float(np.rad2deg(corner_angles(mesh.vertices, mesh.faces).min())), 2),
        "area_cm2": round(1e4 * float(face_normals(mesh.vertices, mesh.faces)[1].sum()), 2),
    }
    pairs = crossings(mesh.vertices, mesh.faces)
    if len(pairs):
        places = mesh.vertices[mesh.faces[pairs[:, 0]]].mean(axis=1)
        text = "pairs of faces intersect; results for sound and skin there are wrong"
        findings.append(Finding("self-intersections", len(pairs), "noted", places[:MOST_PLACES], text))
    facts["self_intersections"] = len(pairs)
    doubts = [f"{finding.count} x {finding.name}" for finding in findings if finding.outcome == "noted"]
    if no is None:
        facts["volume_cm3"] = round(1e6 * volume(mesh.vertices, mesh.faces), 2)
        named = "unknown" if mesh.rig is None else named_side(mesh.rig.joints.names)
        hand = chirality(mesh.vertices, mesh.faces, named)
        doubts += _hand_doubts(mesh, hand, named)
        facts |= {"side": hand.side, "side_sureness": round(hand.sureness, 2), "side_reason": hand.reason}
        facts["layers"] = palmar_layers(mesh.vertices, mesh.faces, hand)
        surface = Surface(mesh.vertices, mesh.faces, vertex_normals(mesh.vertices, mesh.faces))
        facts["scene_layers"] = scene_layers(surface, hand)
        findings += _folds(facts["layers"], len(pairs))
        no = refusal(path, findings) if any(f.outcome == "refused" for f in findings) else None
    verdict = VERDICTS[2 if no is not None else bool(doubts)]
    facts |= {"verdict": verdict, "accepted": no is None, "refusal": no, "doubts": doubts}
    facts["findings"] = [_finding_facts(finding) for finding in findings]
    return ReportCard(facts, mesh, no, tuple(doubts))


def _hand_doubts(mesh: Examined, hand: Chirality, named: str) -> list[str]:
    """Return reasons why a closed mesh may not be a hand, or not the declared one."""
    doubts = []
    if len(hand.tips) != DIGITS:
        doubts.append(f"fingertips: {len(hand.tips)}, not {DIGITS}")
    elif hand.side == "unknown":
        doubts.append("left or right hand could not be determined")
    if hand.side != "unknown" and named not in ("unknown", hand.side):
        doubts.append(f"its joints are named for a {named} hand, but its shape is that of a {hand.side} hand")
    handles = 1 - (len(mesh.vertices) - len(unique_edges(mesh.faces)[0]) + len(mesh.faces)) // 2
    if handles:
        holes = "1 through-hole" if handles == 1 else f"{handles} through-holes"
        doubts.append(f"the surface has {holes}, like a ring; fingers may be merged")
    length, breadth, _ = np.ptp(mesh.vertices @ plane_axes(mesh.vertices).T, axis=0)
    if not size_of_a_hand(float(length), float(breadth)):
        doubts.append(f"it is {1e3 * length:.0f} x {1e3 * breadth:.0f} mm long and broad; {HAND_SIZES}")
    thickness = _thickness(mesh.vertices, mesh.faces)
    if thickness < THIN_SHARE * length:
        doubts.append(
            f"half of its skin is {1e3 * thickness:.1f} mm thick or less, like a glove with an inner wall or a "
            "flat sheet; delete the inner wall and close the wrist"
        )
    return doubts


def _thickness(vertices: Float, faces: Int) -> float:
    """Return the median thickness of the body, weighted by area, along the inward face normals [m]."""
    unit, area = face_normals(vertices, faces)
    chosen = np.arange(0, len(faces), -(-len(faces) // THIN_FACES))
    middle = vertices[faces[chosen]].mean(axis=1)
    ways = exit_distances(vertices, faces, middle, -unit[chosen], float(np.ptp(vertices, axis=0).sum()))
    return percentile(ways, area[chosen], 50.0)


def _folds(layers: list[dict[str, Any]], crossing: int) -> list[Finding]:
    """Return a finding that refuses a mesh under which layers fold."""
    errors = [layer["error"] for layer in layers if "error" in layer]
    hint = "separate fingers that intersect or touch in the modelling program" if crossing else "smooth the skin there"
    text = f"{hint}: {errors[0]}" if errors else ""
    return [Finding("layers that fold", len(errors), "refused", np.zeros((0, 3)), text)] if errors else []


def refused_facts(path: str | Path, unit: str, error: SceneError) -> dict[str, Any]:
    """Return the facts of a mesh for which `report_card` raised `error`, for `as_text` and `write_card`.

    facts: file, verdict ("refused"), accepted (False), refusal, doubts (empty), unit_asked, findings (one, "not
    examined": wrong unit, or no mesh in the file)
    """
    finding = Finding("not examined", 1, "refused", np.zeros((0, 3)), str(error))
    return {
        "file": str(path),
        "verdict": VERDICTS[2],
        "accepted": False,
        "refusal": str(error),
        "doubts": [],
        "unit_asked": unit,
        "findings": [_finding_facts(finding)],
    }


def palmar_faces(vertices: Float, faces: Int, palm: Float) -> Int:
    """Return the largest connected part of the faces on the side of the palm, shape (k,)."""
    unit, area = face_normals(vertices, faces)
    chosen = np.flatnonzero(unit @ palm > PALMAR_COSINE)
    return chosen[largest_part(faces[chosen], area[chosen])].astype(np.int32)


def palmar_layers(vertices: Float, faces: Int, hand: Chirality) -> list[dict[str, Any]]:
    """Return thickness and quality of skin layers of 1, 2, 3 and 5 mm under the palmar side.

    Each has asked_mm (requested thickness), p10_share (10th percentile of obtained over requested thickness),
    thinned_share (share of the area thinned by more than 0.1 %), least_quality (scaled Jacobian of the wedges) and
    volume_share (wedges over exact volume), see `palmfield.hand.wholelayer.hand_layer`; or asked_mm and error.
    """
    vertices = unfolded(vertices, faces)
    surface, inward = Surface(vertices, faces, vertex_normals(vertices, faces)), inward_directions(vertices, faces)
    chosen = palmar_faces(vertices, faces, hand.palm)
    out: list[dict[str, Any]] = []
    for thickness_m in LAYERS_m:
        try:
            report = hand_layer(surface, thickness_m, chosen, inward=inward).report
        except SceneError as error:
            out.append({"asked_mm": 1e3 * thickness_m, "error": str(error)})
            continue
        shown = {key: round(report[name], 4) for key, name in LAYER_FACTS.items()}
        out.append({"asked_mm": 1e3 * thickness_m} | shown)
    return out


def as_text(facts: dict[str, Any]) -> str:
    """Return the card as lines of plain text; facts: as returned by `report_card` or `refused_facts`."""
    rows = _shape_rows(facts) if "size_mm" in facts else [("file", facts["file"]), ("unit", facts["unit_asked"])]
    for finding in facts["findings"]:
        at = "".join(f" ({x:.1f}, {y:.1f}, {z:.1f})" for x, y, z in finding["places_mm"][:3])
        where = f"; at{at}{' ...' if len(finding['places_mm']) > 3 else ''} mm" if at else ""
        rows.append((finding["outcome"], f"{finding['count']} x {finding['name']}: {finding['text']}{where}"))
    rows += [("doubt", doubt) for doubt in facts["doubts"]]
    rows.append(("verdict", facts["verdict"]))
    return "".join(f"{name:<12}{text}\n" for name, text in rows)


def _shape_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    low, mean, high = facts["edges_mm"]
    rows = [
        ("file", f"{facts['file']}: {facts['file_vertices']} vertices, {facts['file_faces']} faces"),
        ("unit", f"{facts['unit']} ({facts['unit_source']})"),
        ("size", " x ".join(f"{v:.1f}" for v in facts["size_mm"]) + " mm"),
        ("mesh", f"{facts['vertices']} vertices, {facts['faces']} faces, {facts['joints']} joints"),
        ("edges", f"{low:.2f} to {high:.2f} mm, mean {mean:.2f}; least angle {facts['least_angle_deg']:.1f} deg"),
        ("crossings", f"{facts['self_intersections']} pairs of faces"),
    ]
    if "side" in facts:
        side = f"{facts['side']} (confidence {facts['side_sureness']:.2f}: {facts['side_reason']})"
        rows += [("hand", side), ("volume", f"{facts['volume_cm3']:.1f} cm3, area {facts['area_cm2']:.1f} cm2")]
        rows += [(f"layer {layer['asked_mm']:g} mm", _layer_line(layer)) for layer in facts["layers"]]
        rows += [("in a scene", _scene_line(layer)) for layer in facts["scene_layers"]]
    return rows


def write_card(path: Path, facts: dict[str, Any]) -> None:
    """Write the card as a JSON file. Raises OutputError if that fails."""
    write_text(path, json.dumps(facts, indent=1, allow_nan=False) + "\n")


def fault_faces(vertices: Float, faces: Int, places: Float, reach_m: float) -> np.ndarray:
    """Return True for faces whose centre is within reach_m of a place or nearest to one, shape (m,)."""
    middle = vertices[faces].mean(axis=1)
    marked = cKDTree(places).query(middle)[0] < reach_m
    marked[cKDTree(middle).query(places)[1]] = True
    return marked


def _finding_facts(finding: Finding) -> dict[str, Any]:
    return {
        "name": finding.name,
        "count": finding.count,
        "outcome": finding.outcome,
        "places_mm": (1e3 * finding.places).round(2).tolist(),
        "text": finding.text,
    }


def _layer_line(layer: dict[str, Any]) -> str:
    if "error" in layer:
        return str(layer["error"])
    return (
        f"p10 of thickness {100 * layer['p10_share']:.0f} %, thinned {100 * layer['thinned_share']:.1f} % of the area, "
        f"least quality {layer['least_quality']:.2f}, volume {100 * layer['volume_share']:.1f} %"
    )


def _scene_line(layer: dict[str, Any]) -> str:
    at = f"{layer['place']}, {layer['radius_mm']:g} mm around ({', '.join(f'{x:.1f}' for x in layer['centre_mm'])}) mm"
    if "error" in layer:
        return f"{at}: {layer['error']}"
    return f"{at}: depth {layer['least_mm']:.1f} mm or more, p10 {layer['p10_mm']:.1f}, mean {layer['mean_mm']:.1f}"
