"""Suites and a training for the tests, small enough to be played in seconds."""

from __future__ import annotations

import shlex
from typing import Any

import pytest

from uavaou_cli.main import main

TRAIN = (
    "train --algorithm mappo-paper --scenario tiny --quiet --slots 96 --set algorithm.missions=8 "
    "--set algorithm.rollout_slots=12 "
    "--set algorithm.batch_rows=240 --set algorithm.evaluation_missions=2 --set algorithm.hidden=[8]"
)
OWN = """
description: Everything that can happen to a point
scenario: tiny
axis: {label: minimum rate, unit: kbit/s}
points:
  - {label: "150", x: 150}
  - {label: "100", x: 100, set: {rate_min_bit_s: 100000}}
  - {label: other devices, x: 1, set: {devices: 3}}
  - {label: off the grid, x: 2, set: {cds_m: [[50, 0], [0, 0]]}}
  - {label: no time, x: 3, set: {flight_time_budget_s: 1}}
  - {label: no link, x: 4, set: {rate_min_bit_s: 10000000}}
  - {label: new layouts, x: 5, set: {layout: resample}}
"""
POINT = {"label": "a", "x": 1}
GOOD: dict[str, Any] = {"description": "d", "axis": {"label": "x"}, "points": [POINT]}


def call(capsys: pytest.CaptureFixture[str], command: str) -> tuple[int, str, str]:
    code = main(shlex.split(command))
    said = capsys.readouterr()
    return code, said.out, said.err
