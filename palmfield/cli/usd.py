"""What `palmfield usd` does with its options."""

from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.outputs.store import RESULT, open_result
from palmfield.outputs.usd.quantities import QUANTITIES
from palmfield.outputs.usd.shown import Shown
from palmfield.outputs.usd.validation import validate_usd
from palmfield.outputs.usd.write import write_usd
from palmfield.terminal import bars


def list_quantities(as_json: bool) -> None:
    """Print what skins can be coloured by."""
    if as_json:
        print_json({name: {"unit": one.unit, "sign": one.sign} for name, one in QUANTITIES.items()})
        return
    for name, one in QUANTITIES.items():
        print(f"{name:20} [{one.unit}] {one.sign}")


def write_scene(run: Path, out: Path | None, shown: Shown, *, check: bool, quiet: bool, as_json: bool) -> int:
    """Write the scene and say so; returns how many findings its check has."""
    file = run / RESULT if run.is_dir() else run
    path = out or file.parent / "scene.usdc"
    with open_result(file) as result, bars(not quiet) as bar:
        task = bar.add_task("writing frames", total=None)
        write_usd(result, path, shown, on_frame=lambda done, of: bar.update(task, completed=done, total=of))
    findings = validate_usd(path) if check else []
    if as_json:
        print_json({"usd": str(path), "bytes": path.stat().st_size, "findings": findings if check else None})
    else:
        print(f"wrote {path}: {path.stat().st_size / 1e6:.2f} MB")
        for line in findings:
            print(line)
        if check and not findings:
            print("USD's validators find nothing")
    return len(findings)
