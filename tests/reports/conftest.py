"""What the tests of figures share."""

from pathlib import Path
from typing import Any

import pytest

from uavaou.reports import style
from uavaou.statistics import aggregates


@pytest.fixture
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether bootstrap intervals are right is seen in tests/statistics."""
    monkeypatch.setattr(aggregates, "RESAMPLES", 100)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The figures by path; the files cost the time."""
    figures: dict[str, Any] = {}

    def keep(figure: Any, folder: Path, name: str) -> list[Path]:
        figures[f"{folder.name}/{name}"] = figure
        return [folder / name]

    monkeypatch.setattr(style, "save", keep)
    return figures
