"""What `palmfield compare` does with its options."""

from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.outputs.scan_files import write_scan
from palmfield.studies.compare.run import FILES, compare


def compare_scan(
    run: Path,
    measured: Path,
    *,
    instrument: Path | None,
    skin: str | None,
    fiducials: Path | None,
    as_placed: bool,
    most_delay_s: float,
    mode_Hz: float | None,
    source_m: tuple[float, float, float] | None,
    source_radius_m: float,
    out: Path,
    as_uff: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Compare, print what it says, and where its files are."""
    done = compare(
        run, measured, instrument=instrument, skin=skin, fiducials=fiducials, onto_surface=not as_placed,
        most_delay_s=most_delay_s, mode_Hz=mode_Hz, source_m=source_m, source_radius_m=source_radius_m,
        out=out, overwrite=overwrite,
    )  # fmt: skip
    if as_uff:
        write_scan(out / "computed.uff", done.computed)
    if as_json:
        print_json(done.as_dict())
        return
    print(done)
    for name in () if quiet else (*FILES, *(["computed.uff"] if as_uff else [])):
        print(f"wrote {out / name}")
