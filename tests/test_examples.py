"""The examples do what they say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.slow
def test_vdn_learns_the_switchboards() -> None:
    ended = subprocess.run(
        [sys.executable, str(EXAMPLES / "switchboards.py")], capture_output=True, text=True, check=True
    )
    before, after = (float(line.split()[1]) for line in ended.stdout.splitlines())
    assert before < 0.5
    assert after > 0.95
