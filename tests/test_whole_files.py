"""A file is there whole, or what was there before."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest

from palmfield.errors import OutputError
from palmfield.files import whole
from palmfield.tables import write_table


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_what_was_there_before_stays_where_the_disk_is_full(tmp_path, error):
    file = tmp_path / "kept.txt"
    file.write_text("before")
    with pytest.raises(type(error)), whole(file) as part:
        part.write_text("half")
        raise error
    assert file.read_text() == "before" and os.listdir(tmp_path) == ["kept.txt"]
    with whole(file) as part:
        part.write_text("after")
    assert file.read_text() == "after" and os.listdir(tmp_path) == ["kept.txt"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the size of files as Linux does")
@pytest.mark.parametrize("name", ["table.csv", "table.npz"])
def test_a_table_that_does_not_fit_leaves_the_one_before(tmp_path, name):
    file = tmp_path / name
    write_table(file, ["a"], np.zeros((3, 1)))
    before = file.read_bytes()
    code = (
        "import resource, signal, sys, numpy as np\n"
        "from pathlib import Path\n"
        "from palmfield.tables import write_table\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "write_table(Path(sys.argv[1]), ['a'], np.random.default_rng(1).random((5000, 1)))\n"
    )
    done = subprocess.run([sys.executable, "-B", "-c", code, str(file)], capture_output=True, text=True, check=False)
    assert "OutputError" in done.stderr and "cannot write" in done.stderr
    assert file.read_bytes() == before and os.listdir(tmp_path) == [name]


def test_what_is_no_file_is_written_at_once(tmp_path):
    write_table(tmp_path / "t.csv", ["a"], np.zeros((1, 1)))
    with whole("/dev/null" if os.name == "posix" else "NUL") as part:
        part.write_text("gone")
    with pytest.raises(OutputError):
        write_table(tmp_path / "no" / "t.csv", ["a"], np.zeros((1, 1)))
