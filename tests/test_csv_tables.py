"""Tables of CSV files: what is read and written, and where an error points to."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uavaou import InputError
from uavaou.csv_tables import NUMBER, TEXT, WHOLE, cells, number, parse_table, read_table, write_table


def _file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["table.csv", "table.csv.gz"])
def test_what_is_written_is_read_back(name: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / name
    rows = [['a, "b"', 3, 0.1234567, None, np.nan], ["line\nbreak", 4, 12.0, 2.5, np.nan]]
    write_table(path, pd.DataFrame(rows, columns=["name", "whole", "x", "y", "empty"]))
    table = read_table(path, {"name": TEXT, "whole": WHOLE, "x": NUMBER, "y": NUMBER, "absent": NUMBER}, ("x",))
    assert table["name"].tolist() == ['a, "b"', "line\nbreak"]
    assert table["whole"].tolist() == [3, 4]
    assert table["x"].tolist() == [0.123457, 12.0]
    assert np.isnan(table["y"][0])
    assert table["absent"].isna().all()
    assert name.endswith("gz") or path.read_text().splitlines()[:2] == ["name,whole,x,y", '"a, ""b""",3,0.123457,']
    written = path.read_bytes()
    write_table(path, pd.DataFrame(rows, columns=["name", "whole", "x", "y", "empty"]))
    assert path.read_bytes() == written


def test_marks_spaces_blank_lines_and_a_last_line_cut_off_are_accepted(tmp_path: Path) -> None:
    table = parse_table(tmp_path, "\ufeffx, y\n1, 2 \n\n3, 4", ("x", "y"))
    assert cells(tmp_path, table["y"], WHOLE).tolist() == [2, 4]
    assert table.index.tolist() == [2, 4]
    path = _file(tmp_path, "x,y\n1,2\n3,")
    assert len(read_table(path, {"x": NUMBER, "y": NUMBER}, ("y",))) == 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y\n1,2\n\n3,abc\n", "line 4, column 'y': 'abc' is not a finite number"),
        ("x,y\n1,inf\n", "line 2, column 'y': 'inf' is not a finite number"),
        ("x,y\n1,nan\n", "line 2, column 'y': 'nan' is not a finite number"),
        ("x,y\n1,\n", "line 2, column 'y': '' is not a finite number"),
        ("x,y\n1,5,2\n", "line 2: 3 values, expected 2"),
        ("x,,y\n1,5,\n", "line 2: 3 values, expected 2"),
        ("x,y\n\n1\n", "line 3: 1 values, expected 2"),
        ("x;y\n1;2\n", "not separated by commas"),
        ("x,z\n", "column 'y' is missing (header: 'x, z')"),
        ("", "column 'y' is missing"),
        ("x,y,y\n", "column 'y' is there twice"),
        ('y\n"' + "a" * 200_000 + "\n", "not a CSV file"),
    ],
)
def test_an_error_names_file_line_and_column(tmp_path: Path, text: str, told: str) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(InputError) as refused:
        read_table(path, {"y": NUMBER}, ("y",))
    assert str(refused.value).startswith(str(path))
    assert told in str(refused.value)


@pytest.mark.parametrize("cell", ["1.5", "", "9" * 30, "x" * 5000, "9" * 5000])
def test_a_cell_that_is_no_whole_number_is_refused_and_quoted_briefly(tmp_path: Path, cell: str) -> None:
    path = _file(tmp_path, f"n,m\n{cell},1\n")
    with pytest.raises(InputError, match="is not a whole number") as refused:
        read_table(path, {"n": WHOLE}, ("n",))
    assert len(str(refused.value)) < len(str(tmp_path)) + 140


def test_a_table_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = _file(tmp_path, "x\n1\n")
    with pytest.raises(InputError, match="cannot write"):
        write_table(path / "below.csv", pd.DataFrame({"x": [2.0]}))
    assert path.read_text() == "x\n1\n"


def test_a_number_has_six_digits_and_a_whole_number_all() -> None:
    values = (None, float("nan"), 12_345_678.0, 0.1234567, 1e20, -2.0)
    assert [number(value) for value in values] == ["", "", "12345678", "0.123457", "1e+20", "-2"]
    assert number(0.12345678) == "0.123457"
