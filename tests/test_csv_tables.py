"""Tables of CSV files: what is read and written, and where an error points to."""

from pathlib import Path

import numpy as np
import pytest

from uavaou import InputError
from uavaou.csv_tables import number, read_csv, write_csv


def _file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "new" / "table.csv"
    rows = [['a, "b"', 3, 0.1234567, None], {"name": "line\nbreak", "whole": 4, "x": 12.0, "y": np.float64("nan")}]
    write_csv(path, ("name", "whole", "x", "y"), rows)  # type: ignore[arg-type]
    table = read_csv(path, ("x",))
    assert path.read_text().splitlines()[0] == "name,whole,x,y"
    assert table.text("name") == ['a, "b"', "line\nbreak"]
    assert table.integers("whole").tolist() == [3, 4]
    assert table.floats("x").tolist() == [0.123457, 12.0]
    assert np.isnan(table.floats("y", missing=True)).all()
    assert table.text("x") == ["0.123457", "12"]


def test_marks_spaces_blank_lines_and_a_last_line_cut_off_are_accepted(tmp_path: Path) -> None:
    table = read_csv(_file(tmp_path, "\ufeffx, y\n1, 2\n\n3, 4\n"), ("x", "y"), exact=True)
    assert table.integers("y").tolist() == [2, 4]
    assert table.where(table.floats("x") > 1).lines == [4]
    path = _file(tmp_path, "x,y\n1,2\n3,")
    assert len(read_csv(path, whole_lines=True)) == 1
    with pytest.raises(InputError, match="expected the columns x, y"):
        read_csv(_file(tmp_path, "y,x\n1,2\n"), ("x", "y"), exact=True)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y\n1,2\n\n3,abc\n", "line 4, column 'y': 'abc' is not a finite number"),
        ("x,y\n1,inf\n", "line 2, column 'y': 'inf' is not a finite number"),
        ("x,y\n1,\n", "line 2, column 'y': '' is not a finite number"),
        ("x,y\n1,5,2\n", "line 2: 3 values, expected 2"),
        ("x;y\n1;2\n", "not separated by commas"),
        ("x,z\n", "column 'y' is missing (header: 'x, z')"),
        ("", "column 'y' is missing"),
        ("x,y,y\n", "column 'y' is there twice"),
        ('y\n"' + "a" * 200_000, "not a CSV file"),
    ],
)
def test_an_error_names_file_line_and_column(tmp_path: Path, text: str, told: str) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(InputError) as refused:
        read_csv(path, ("y",)).floats("y")
    assert str(refused.value).startswith(str(path))
    assert told in str(refused.value)


@pytest.mark.parametrize("cell", ["1.5", "", "1e3", "9" * 30, "x" * 5000, "9" * 5000])
def test_a_cell_that_is_no_integer_is_refused_and_quoted_briefly(tmp_path: Path, cell: str) -> None:
    table = read_csv(_file(tmp_path, f"n,m,k\n{cell},,1\n"))
    with pytest.raises(InputError, match="is not an integer") as refused:
        table.integers("n")
    assert len(str(refused.value)) < len(str(tmp_path)) + 140
    assert table.integers("m", missing=-1).tolist() == [-1]


def test_a_table_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = _file(tmp_path, "x\n1\n")

    def rows() -> object:
        yield [2.0]
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_csv(path, ("x",), rows())  # type: ignore[arg-type]
    assert path.read_text() == "x\n1\n"
    with pytest.raises(InputError, match="cannot write"):
        write_csv(path / "below.csv", ("x",), [])


def test_a_number_has_six_digits_and_a_whole_number_all() -> None:
    values = (None, float("nan"), 12_345_678.0, 0.1234567, 1e20, -2.0)
    assert [number(value) for value in values] == ["", "", "12345678", "0.123457", "1e+20", "-2"]
    assert number(0.12345678) == "0.123457"
