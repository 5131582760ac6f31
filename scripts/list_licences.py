#!/usr/bin/env python3
"""List the licences of palmfield's dependencies, from the metadata of the installed packages.

python scripts/list_licences.py [--write docs/licences.md]

It lists the packages that `pip install palmfield` installs, with all indirect dependencies, the libraries in their
wheels, and the packages of each extra.
"""

import argparse
import re
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
HEAD = """# Licences of what palmfield needs

For everyone who redistributes palmfield. palmfield is under the Apache License 2.0. This page lists the licences of the
packages that it needs. `python scripts/list_licences.py` makes the page from the metadata of the installed packages. If
palmfield does not require a package itself, the last column names the package that does.

| package | licence | required by |
|---|---|---|
"""
BUNDLES = """
## What wheels bundle

The table lists the shared libraries in wheels for Linux on x86-64. In an installation without extras, the only
libraries under the GPL are the run-time libraries of GCC. Their licence has an exception for programs that use them.

Other code is linked into the wheels; their folders of licences list it. Code in the wheel of mujoco has permissive
licences, with two exceptions: Eigen is under the MPL, and the parser of Glslang, made by Bison, is under the GPL
with the exception of Bison. Code in the wheel of warp-lang has permissive licences, except NVIDIA's CUDA run time,
NVRTC and libmathdx. These three are proprietary. They may be passed on with Warp free of charge, and do nothing
without an NVIDIA GPU.

| wheel | libraries | licence |
|---|---|---|
"""
EXTRAS = """
## Extras

Extras are installed only if you name them (`pip install 'palmfield[sweep]'`). The table lists the packages of each
extra without their dependencies. Two extras have special licences:

- **`mkl`** installs Intel's libraries (mkl, intel-openmp, tbb). They are free of charge but not open source. They
  are the only proprietary packages of the extras.
- **`video`** installs PyAV (BSD), whose wheels bundle FFmpeg (LGPL) with x264 and x265 (GPL). The wheel of
  palmfield contains none of them. If you pass on an environment with this extra, you pass on software under the
  GPL.

| extra | package | licence |
|---|---|---|
"""
ABSENT = {
    "autd3": "MIT",
    "autd3-emulator": "MIT",
    "autd3-pattern": "MIT",
    "pylsl": "MIT License",
    "pypardiso": "BSD-3-Clause",
}
"""Metadata of the wheels of packages in extras that are not installed in the environment of the tests."""
LIBRARIES = {
    "SvtAv1Enc": "BSD-3-Clause-Clear",
    "Xau": "MIT",
    "aec": "BSD-2-Clause",
    "asound": "LGPL-2.1-or-later",
    "avcodec": "LGPL-3.0-or-later",
    "avdevice": "LGPL-3.0-or-later",
    "avfilter": "LGPL-3.0-or-later",
    "avformat": "LGPL-3.0-or-later",
    "avif": "BSD-2-Clause",
    "avutil": "LGPL-3.0-or-later",
    "brotlicommon": "MIT",
    "brotlidec": "MIT",
    "dav1d": "BSD-2-Clause",
    "drm": "MIT",
    "freetype": "FTL",
    "gfortran": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "gmp": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "gnutls": "LGPL-2.1-or-later",
    "harfbuzz": "MIT-Modern-Variant",
    "hdf5": "BSD-3-Clause",
    "hdf5_hl": "BSD-3-Clause",
    "hogweed": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "jpeg": "IJG AND BSD-3-Clause",
    "lcms2": "MIT",
    "lzma": "0BSD",
    "mp3lame": "LGPL-2.0-or-later",
    "nettle": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "opencore-amrnb": "Apache-2.0",
    "opencore-amrwb": "Apache-2.0",
    "openjp2": "BSD-2-Clause",
    "opus": "BSD-3-Clause",
    "png16": "libpng-2.0",
    "quadmath": "LGPL-2.1-or-later",
    "scipy_openblas": "BSD-3-Clause",
    "scipy_openblas64_": "BSD-3-Clause",
    "sharpyuv": "BSD-3-Clause",
    "swresample": "LGPL-3.0-or-later",
    "swscale": "LGPL-3.0-or-later",
    "sz": "BSD-2-Clause",
    "tbb": "Apache-2.0",
    "tiff": "libtiff",
    "unistring": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "usd_ms": "LicenseRef-TOST-1.0",
    "vpl": "MIT",
    "vpx": "BSD-3-Clause",
    "webp": "BSD-3-Clause",
    "webpdemux": "BSD-3-Clause",
    "webpmux": "BSD-3-Clause",
    "x264": "GPL-2.0-or-later",
    "x265": "GPL-2.0-or-later",
    "xcb": "MIT",
    "xcb-shape": "MIT",
    "xcb-shm": "MIT",
    "xcb-xfixes": "MIT",
    "zstd": "BSD-3-Clause",
}
"""Licences of libraries in wheels, by name. Those of FFmpeg are from `av._core.library_meta`."""
SHARED = re.compile(r"lib(.+?)-[0-9a-f]{8}(?:-[0-9a-f]{8})?\.so")


def licence(name: str) -> str:
    """Return the licence in a package's metadata: the expression, else its classifiers, else the field's first line."""
    try:
        about = distribution(name).metadata
    except PackageNotFoundError:
        return ABSENT[canonicalize_name(name)]
    if expression := about.get("License-Expression"):
        return str(expression)
    kinds = [line.rsplit(" :: ", 1)[1] for line in about.get_all("Classifier") or [] if line.startswith("License :: ")]
    kinds = [kind for kind in kinds if kind != "OSI Approved"]
    if kinds:
        return ", ".join(kinds)
    return str(about.get("License") or "not told").strip().splitlines()[0]


def needed() -> dict[str, str]:
    """Return all packages of a plain install, and for each the package that requires it, "" for palmfield."""
    found: dict[str, str] = {}
    waiting = [("palmfield", set[str]())]
    while waiting:
        asks, extras = waiting.pop()
        try:
            required = requires(asks) or []
        except PackageNotFoundError:
            continue
        for text in required:
            need = Requirement(text)
            places = [{"extra": extra} for extra in extras] or [{"extra": ""}]
            name = canonicalize_name(need.name)
            if name in found or (need.marker and not any(need.marker.evaluate(place) for place in places)):
                continue
            found[name] = "" if asks == "palmfield" else asks
            waiting.append((name, set(need.extras)))
    return found


def extras() -> dict[str, list[str]]:
    """Return the packages of each extra of palmfield, by its name."""
    found: dict[str, list[str]] = {}
    for text in requires("palmfield") or []:
        if extra := re.search(r"extra == ['\"](\w+)['\"]", text):
            found.setdefault(extra[1], []).append(Requirement(text).name)
    return found


def bundled(name: str) -> list[str]:
    """Return the names of the shared libraries that an installed wheel contains in its own folder."""
    files = distribution(name).files or []
    matches = (SHARED.match(file.name) for file in files if file.parts[0].endswith(".libs"))
    return sorted({match[1] for match in matches if match})


def by_licence(libraries: list[str]) -> list[tuple[str, str]]:
    """Return names of libraries with one licence, and that licence; each library under the GPL separately."""
    found: dict[str, list[str]] = {}
    for one in libraries:
        text = LIBRARIES[one]
        found.setdefault(f"{one}: {text}" if text.startswith("GPL") else text, []).append(one)
    return [(", ".join(names), LIBRARIES[names[0]]) for names in found.values()]


def page() -> str:
    rows = [f"| {name} | {licence(name)} | {through} |" for name, through in sorted(needed().items())]
    wheels = {name: bundled(name) for name in [*sorted(needed()), "av"]}
    libraries = [f"| {name} | {one} | {text} |" for name, found in wheels.items() for one, text in by_licence(found)]
    more = [
        f"| {extra} | {name} | {licence(name)} |"
        for extra, packages in sorted(extras().items())
        for name in sorted(set(packages) - {"palmfield"})
    ]
    parts = HEAD + "\n".join(rows), BUNDLES + "\n".join(libraries), EXTRAS + "\n".join(more)
    return "\n".join(parts) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    args = parser.parse_args()
    text = page()
    if args.write:
        args.write.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
