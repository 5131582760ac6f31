"""Arrays from a CSV file."""

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.transducer_file import read_transducers
from palmfield.errors import SceneError

HEAD = "x_mm,y_mm,z_mm\n"


def written(tmp_path, text):
    path = tmp_path / "array.csv"
    path.write_text(text)
    return path


def test_a_known_board_as_a_file_is_that_board(tmp_path):
    board = layout("sonicsurface")
    lines = [",".join(f"{value:.17g}" for value in (*1e3 * place, n)) for n, place in enumerate(board.positions)]
    path = written(tmp_path, "x_mm,y_mm,z_mm,address\n" + "\n".join(lines))
    array = read_transducers(path).array(board.p0_Pa_m)
    np.testing.assert_allclose(array.positions, board.positions, atol=1e-15)
    np.testing.assert_array_equal(array.normals, board.normals)
    np.testing.assert_array_equal(array.address, board.address)
    assert array.gain is None and array.p0_Pa_m == board.p0_Pa_m


def test_directions_gains_and_phases_are_taken(tmp_path):
    text = "x_m,y_m,z_m,nx,ny,nz,gain,phase_deg\n0,0,0,0,0,2,1,0\n0.01,0,0,1,0,1,-1,0\n0,0.01,0,0,0,1,0.5,90\n"
    array = read_transducers(written(tmp_path, text)).array(2.0)
    np.testing.assert_allclose(array.normals[1], [2**-0.5, 0.0, 2**-0.5])
    np.testing.assert_allclose(array.gain, [1.0, -1.0, 0.5j], atol=1e-15)
    assert array.address is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the file is empty"),
        (HEAD, "has no transducers"),
        ("x,y,z\n0,0,0\n", "give x_m, y_m, z_m or x_mm"),
        ("x_mm,y_m,z_m\n0,0,0\n", "give x_m, y_m, z_m or x_mm"),
        ("x_mm,y_mm\n0,0\n", "column 'z_mm' is missing"),
        (HEAD + "0,0,0\n0,0,zero\n", "line 3, column z_mm: 'zero' is not a number"),
        (HEAD + "0,0,nan\n", "line 2, column z_mm: nan"),
        (HEAD + "0,0,0\n10,0,0\n0,0,0\n", "another transducer has the same position"),
        ("x_m,y_m,z_m\n0,0,0\n10.5,0,0\n", "line 3: 10.5 m from the origin of the array frame"),
        ("x_mm,y_mm,z_mm,nx,ny,nz\n0,0,0,0,0,0\n", "line 2, columns nx to nz: the vector has length 0"),
        ("x_mm,y_mm,z_mm,nx\n0,0,0,1\n", "column 'ny' is missing; nx, ny, nz must be given together; columns are: nx"),
        (
            "x_mm;y_mm;z_mm\n0;0;0\n",
            "columns are separated by semicolons; use commas between columns and decimal points",
        ),
        ("x_mm\ty_mm\tz_mm\n0\t0\t0\n", "columns are separated by tabs; use commas"),
        ("# my array\nx_mm,y_mm,z_mm\n0,0,0\n", "line 1 is a comment, '# my array'; begin with one line of"),
        ("x_mm,y_mm,z_mm,address\n0,0,0,1\n", "each number from 0 to 0 once"),
        ("x_mm,y_mm,z_mm,colour\n0,0,0,1\n", "column 'colour' is unknown; allowed"),
    ],
)
def test_a_bad_file_is_told_with_its_place(tmp_path, text, told):
    path = written(tmp_path, text)
    with pytest.raises(SceneError) as error:
        read_transducers(path)
    assert str(path) in str(error.value) and told in str(error.value)
