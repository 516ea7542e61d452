"""Whatever a command inherits: a notebook's variables, a console of few letters, names in any script."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest


def command(place: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Run ``uavaou`` in a process of its own, in a folder, with variables of the environment."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), **variables}
    process = [sys.executable, "-m", "uavaou", *arguments]
    return subprocess.run(process, cwd=place, env=environment, capture_output=True, check=False)


@pytest.mark.slow
def test_the_backend_of_a_notebook_does_not_matter(tmp_path: Path) -> None:
    fly = ("fly", "tiny", "--policy", "greedy", "--quiet", "--out", "out")
    done = command(tmp_path, *fly, MPLBACKEND="module://nowhere.backend_inline")
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "out" / "mission-10000-map.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stem", "encoding", "shown"),
    [
        ("поле", "cp1252", rb"\u043f\u043e\u043b\u0435"),
        ("поле", "utf-8", "поле".encode()),
        (os.fsdecode(b"f\xe9ld"), "utf-8", b"f?ld"),  # written where names are Latin-1
    ],
)
def test_a_name_that_the_console_cannot_print(stem: str, encoding: str, shown: bytes, tmp_path: Path) -> None:
    (tmp_path / f"{stem}.yaml").write_text("base: tiny\n", encoding="utf-8")
    words = shlex.split(f"eval --policy greedy --scenario {stem}.yaml --episodes 2 --quiet --out {stem}.csv")
    done = command(tmp_path, *words, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(shown + b": 2 missions")
    assert (tmp_path / f"{stem}.csv").is_file()
    refused = command(tmp_path, "audit", f"{stem}.yml", PYTHONIOENCODING=encoding)
    assert (refused.returncode, refused.stdout, refused.stderr.count(b"\n")) == (2, b"", 1)
