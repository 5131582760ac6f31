"""File of a USD scene during writing: saved regularly, readable after a kill, complete at the end."""

import os
import re
import shutil
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdUtils

from palmfield.errors import OutputError, reason_of

SUFFIXES = (".usdc", ".usda", ".usdz")
SAVE_EVERY = 200
"""Number of frames after which the file is saved."""


def partial_of(path: Path) -> Path:
    """Return the path of the partial scene, which can be read during writing and after a kill."""
    return path.with_name(f"{path.stem}.partial.usdc")


def unfinished_scenes(folder: Path) -> list[tuple[Path, str]]:
    """Return files of an interrupted or running USD export in a folder, with their descriptions."""
    readable = "content of an interrupted USD scene: it can be opened; `palmfield usd` writes the complete scene"
    broken = "part of an interrupted USD scene: remove it if no program writes there"
    hidden = [path for kind in ("tmp.usdc", "copy.usdc", "whole.usd[az]") for path in folder.glob(f".*.{kind}")]
    inner = folder.glob("*.inner.usdc")
    return [(path, readable) for path in sorted(folder.glob("*.partial.usdc"))] + [
        (path, broken) for path in sorted([*hidden, *inner])
    ]


class StageFile:
    """A growing crate file that gets its final name at the end.

    USD saves into the file that it reads from. In a test, one of twenty kills during saving made this file unreadable.
    So saved data are copied, and the copy replaces the previous copy in one step.
    """

    def __init__(self, path: Path):
        """Open a new file.

        Raises OutputError for a suffix that is not in SUFFIXES, and for a folder that cannot be written.
        """
        self.path = path
        if path.suffix not in SUFFIXES:
            raise OutputError(f"cannot write {path}: give a file name that ends in {', '.join(SUFFIXES)}")
        self._growing = path.with_name(f".{path.stem}.tmp.usdc")
        self._copied = path.with_name(f".{path.stem}.copy.usdc")
        self._whole = path.with_name(f".{path.stem}.whole{path.suffix}")
        try:
            self._growing.unlink(missing_ok=True)
            self._growing.touch()
            self._growing.unlink()
            self.stage: Usd.Stage = Usd.Stage.CreateNew(str(self._growing))
        except (OSError, Tf.ErrorException) as error:
            raise unwritable_scene(path, error) from error

    def begin(self, per_second: float, fps: float) -> Usd.Prim:
        """Set units and axes; return the root. per_second, fps: time codes per second of the run, and of a player."""
        stage = self.stage
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(per_second)
        stage.SetFramesPerSecond(fps)
        root = UsdGeom.Xform.Define(stage, "/Scene").GetPrim()
        stage.SetDefaultPrim(root)
        return root

    def save(self, end_code: float | None) -> None:
        """Save all data up to a time code, free its memory, and make it readable."""
        if end_code is not None:
            self.stage.SetEndTimeCode(end_code)
        self.stage.Save()
        shutil.copyfile(self._growing, self._copied)
        os.replace(self._copied, partial_of(self.path))

    def finish(self) -> None:
        """Move the complete scene to its place."""
        self.stage.Save()
        whole = self._growing
        if self.path.suffix == ".usda":
            whole = self._whole
            if not Sdf.Layer.FindOrOpen(str(self._growing)).Export(str(whole)):
                raise OSError("USD could not save it")
        elif self.path.suffix == ".usdz":
            whole = self._whole
            # The package contains the name of the layer, which therefore needs its own name
            inner = self._growing.with_name(f"{self.path.stem}.inner.usdc")
            os.replace(self._growing, inner)
            try:
                if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inner)), str(whole), f"{self.path.stem}.usdc"):
                    raise OSError("USD could not save it")
            finally:
                inner.unlink(missing_ok=True)
        os.replace(whole, self.path)

    def clear(self) -> None:
        """Remove all files except the scene."""
        if self._growing.parent.is_dir():
            for left in (self._growing, self._copied, self._whole, partial_of(self.path)):
                left.unlink(missing_ok=True)


def unwritable_scene(path: Path, error: Exception) -> OutputError:
    """Return an error with its cause in one line, taken from the longer USD message (function and cause in quotes)."""
    if isinstance(error, OSError):
        cause = reason_of(error)
    else:
        quoted = re.findall("'([^']*)'", str(error))
        cause = quoted[1] if len(quoted) > 1 else "USD could not save it"
    return OutputError(f"cannot write {path}: {cause}; choose a folder on a disk with enough space")
