"""Write docs/report_cards.md with its pictures docs/images/card_*.png and report_card_*.png.

It has report cards of the presets, of each fault of tests/hand/test_reportcard.py, of the meshes of
scripts/verification/foreign_hands.py, and of a glTF with joints.

python scripts/draw_cards.py [--commit NAME]
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from palmfield.errors import SceneError
from palmfield.hand.preset import load_preset, mirrored, preset_names
from palmfield.hand.reportcard import ReportCard, as_text, refused_facts, report_card
from palmfield.hand.surface import hand_surface
from palmfield.outputs.report_card_picture import directions, draw_card, draw_view
from palmfield.outputs.style import save, style
from palmfield.studies.bench.field import git_commit

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
# Faults that a picture shows, and the name of its file; the others leave nothing to see.
SEEN = {
    "holes": "report_card_hole",
    "open wrist": "report_card_open_wrist",
    "flipped faces": "report_card_flipped",
    "non-manifold edges": "report_card_fin",
    "self-intersections": "report_card_self_intersection",
    "several bodies": "report_card_two_bodies",
    "not finite vertices": "card_not_finite",
    "small holes": "card_small_hole",
}
# Meshes of other people whose cards are drawn by themselves.
FOREIGN_SEEN = ("quads", "unnamed", "crossed")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--commit", help="what to write as the commit where no git is")
    commit = options.parse_args().commit or git_commit()
    # The faults and the glTF are those that the tests judge; nothing of them is built twice.
    sys.path[:0] = [str(ROOT / "tests" / "hand"), str(ROOT / "scripts" / "verification")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        presets = preset_cards(folder)
        draw_presets(presets, IMAGES / "card_presets.png")
        lines = [
            "# Report cards",
            "",
            "[Your own mesh](user_meshes.md) explains the words. Written by `python scripts/draw_cards.py`, "
            f"commit {commit}.",
            "",
            "## The presets",
            "",
            "The meshes have edges of 3 mm. Each was written as PLY in millimetres and read again without a unit, "
            "which was inferred.",
            "Columns `1 mm` to `5 mm` have four values of a layer of this thickness: the 10th percentile of the "
            "thickness",
            "[%], the area where it is thinner [%], the volume relative to its integral [%], and the smallest scaled",
            "Jacobian. Left hands are listed only if they differ.",
            "",
            *preset_table(presets),
            "",
            "![The six presets from the palm and from the back](images/card_presets.png)",
            "",
            "## Faults",
            "",
            "Each fault was put into `open_men_p50` with edges of 4 mm. The table has the line of the report card "
            "for this fault, without the positions.",
            "",
            *fault_table(folder),
            "",
            *(f"![{fault}](images/{file}.png)" for fault, file in SEEN.items()),
            "",
            "## Hands of other people",
            "",
            "We made meshes like those of other programs and laboratories, and meshes of three objects that are not",
            "hands (`python scripts/verification/foreign_hands.py FOLDER`). No unit was given. The three objects were "
            "also",
            "examined in millimetres.",
            "",
            *foreign_table(folder),
            "",
            "![The ten hands, from the palm](images/card_foreign.png)",
            *(f"![{name}](images/card_{name}.png)" for name in FOREIGN_SEEN),
            "",
            "## A glTF with joints and weights",
            "",
            "The mesh is a hand with three joints, under a rotated and scaled armature, split along every face. Its "
            "lines on layers and scenes are left out here.",
            "",
            "```",
            gltf_text(folder).rstrip(),
            "```",
            "",
            "![a glTF hand](images/card_gltf.png)",
        ]
    (ROOT / "docs" / "report_cards.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def preset_cards(folder: Path) -> dict[str, ReportCard]:
    """Return cards of the right hands of the six presets, and of their mirror images under `<name>, left`."""
    from test_reportcard import written

    cards = {}
    for preset in map(load_preset, preset_names()):
        if preset.side == "left":
            continue
        for name, hand in ((preset.name, preset), (f"{preset.name}, left", mirrored(preset))):
            surface = hand_surface(hand).surface
            cards[name] = report_card(written(folder / f"{name}.ply", surface.vertices, surface.faces))
    return cards


def preset_table(cards: dict[str, ReportCard]) -> list[str]:
    first = next(iter(cards.values())).facts["layers"]
    heads = ["preset", "size, mm", "side (confidence)", *(f"{layer['asked_mm']:g} mm" for layer in first)]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, card in cards.items():
        facts = card.facts
        size = " x ".join(f"{v:.1f}" for v in facts["size_mm"])
        cells = [
            f"`{name}`",
            size,
            f"{facts['side']} ({facts['side_sureness']:.2f})",
            *map(layer_cell, facts["layers"]),
        ]
        row = f"| {' | '.join(cells)} |"
        # Left hands that differ from the right ones by their side alone
        if row.replace(", left`", "`").replace("| left ", "| right ") not in lines:
            lines.append(row)
    return lines


def layer_cell(layer: dict[str, Any]) -> str:
    if "error" in layer:
        return str(layer["error"])
    shares = (layer["p10_share"], layer["thinned_share"], layer["volume_share"])
    return ", ".join(f"{100 * share:.1f}" for share in shares) + f", {layer['least_quality']:.2f}"


def fault_table(folder: Path) -> list[str]:
    """Return a line for each fault, with a picture of some; also two faults without a mesh to examine."""
    from test_reportcard import FAULTS, hand, written

    lines = ["| fault | line of the report card |", "|---|---|"]
    for name, (build, _) in FAULTS.items():
        vertices, faces, _ = build()
        card = report_card(written(folder / f"{name.replace(' ', '_')}.ply", vertices, faces), "mm")
        lines.append(f"| {name} | {line_naming(as_text(card.facts), f' x {name}:').partition('; at (')[0]} |")
        if name in SEEN:
            draw_card(card, IMAGES / f"{SEEN[name]}.png")
    for name, unit, content in (("wrong unit", "m", None), ("unreadable", "mm", b"ply\nnothing else")):
        mesh = written(folder / f"{name.replace(' ', '_')}.ply", *hand())
        if content is not None:
            mesh.write_bytes(content)
        try:
            report_card(mesh, unit)
        except SceneError as error:
            text = as_text(refused_facts(mesh, unit, error)).replace(f"{folder}/", "")
            lines.append(f"| {name} | {line_naming(text, ' x not examined:')} |")
    return lines


def foreign_table(folder: Path) -> list[str]:
    """Return a line for each mesh of other people: unit, side, verdict and result of its card; draws their pictures."""
    from foreign_hands import HANDS, NO_HANDS, card_of

    lines = ["| mesh | unit, length | side (confidence) | verdict | why |", "|---|---|---|---|---|"]
    drawn = {}
    for foreign in HANDS + NO_HANDS:
        path = folder / foreign.file
        foreign.make(path)
        card, unit = card_of(path), ""
        if isinstance(card, SceneError):
            unit, card = "not inferred, ", report_card(path, "mm")
        elif path.stem in FOREIGN_SEEN:
            draw_card(card, IMAGES / f"card_{path.stem}.png")
        facts = card.facts
        if not unit:
            drawn[f"{foreign.file}\n{facts['verdict']}"] = card
        findings = [f for f in facts["findings"] if f["name"] not in ("long edges", "unused vertices")]
        found = [f"{f['outcome']} {f['count']} x {f['name']}" for f in findings if f["outcome"] != "noted"]
        side = f"{facts['side']} ({facts['side_sureness']:.2f})"
        size = f"{unit}{facts['unit']}, {max(facts['size_mm']):.0f} mm"
        why = "; ".join([*found, *(f"doubt: {doubt}" for doubt in facts["doubts"])]) or "nothing to mend"
        lines.append(f"| {foreign.habit} (`{foreign.file}`) | {size} | {side} | {facts['verdict']} | {why} |")
    draw_foreign(drawn, IMAGES / "card_foreign.png")
    return lines


def line_naming(text: str, name: str) -> str:
    return " ".join(next(line for line in text.splitlines() if name in line).split())


def gltf_text(folder: Path) -> str:
    from test_gltf import rigged

    path = folder / "hand.glb"
    rigged(path)
    card = report_card(path)
    draw_card(card, IMAGES / "card_gltf.png")
    lines = as_text(card.facts).replace(f"{folder}/", "").split("\n")
    return "\n".join(line for line in lines if not line.startswith(("layer ", "in a scene ")))


def draw_foreign(cards: dict[str, ReportCard], path: Path) -> None:
    """Draw the palmar side of each hand."""
    with style():
        figure = Figure(figsize=(15.0, 7.5), dpi=90, layout="constrained")
        for panel, (name, card) in zip(figure.subplots(2, len(cards) // 2).ravel(), cards.items(), strict=True):
            up, palm = directions(card)
            draw_view(panel, card, up, palm, name)
            panel.set_xlabel("")
        save(figure, path)


def draw_presets(cards: dict[str, ReportCard], path: Path) -> None:
    """Draw the palmar side and the back of each right hand at one scale."""
    shown = {name: card for name, card in cards.items() if card.facts["side"] == "right"}
    with style():
        figure = Figure(figsize=(15.0, 7.0), dpi=90, layout="constrained")
        panels = figure.subplots(2, len(shown), sharex=True, sharey=True)
        for column, (name, card) in enumerate(shown.items()):
            up, palm = directions(card)
            draw_view(panels[0, column], card, up, palm, f"{name}, palm")
            draw_view(panels[1, column], card, up, -palm, "back")
            panels[0, column].set_xlabel("")
        save(figure, path)


if __name__ == "__main__":
    main()
