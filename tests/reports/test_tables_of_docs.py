"""The tables of the documentation, and what is said beside them, are those of the committed results."""

from __future__ import annotations

import re

from tests.reports.test_sentences_of_docs import ROOT, speeds


def test_the_rates_of_the_page_on_speed_are_those_of_the_tables() -> None:
    page = (ROOT / "docs" / "speed.md").read_text(encoding="utf-8")
    tables = page[page.index("agent steps a second, medians of three") : page.index("**Limit.**")]
    cells = [cell.strip() for line in tables.splitlines() if line.startswith("|") for cell in line.split("|")[2:-1]]
    stated = [number for cell in cells for number in re.findall(r"\d{1,3}(?:,\d{3})+", cell)]
    rates = {f"{rate:,.0f}" for table in ("training", "stepping") for rate in speeds(table).values()}
    assert len(stated) == 20
    assert set(stated) <= rates
    ratios = re.findall(r"\*{0,2}(\d+\.\d)\*{0,2}", " ".join(cell for cell in cells if "," not in cell))
    found = speeds("training")
    assert len(ratios) == 10
    tables = {name: name.partition(": ")[0] for name in found}
    stock = {tables[name]: rate for name, rate in found.items() if "stock" in name and "1 process" in name}
    against = {f"{found[name] / stock[table]:.1f}" for name, table in tables.items() if table in stock}
    assert set(ratios) <= against


def test_growth_and_limit_on_the_page_on_speed_are_those_of_the_tables() -> None:
    page = (ROOT / "docs" / "speed.md").read_text(encoding="utf-8")
    exponents = {name: value for name, value in speeds("scaling").items() if "^" in name}
    alone, seen = (
        exponents[f"World.step {how} by devices: cost of an agent step ~ devices^"] for how in ("alone", "with views")
    )
    assert f"as I^{alone:.2f} (with views and masks I^{seen:.2f})" in page
    assert f"exponent −{-exponents['World.step alone by missions: cost of an agent step ~ missions^']:.2f}" in page
    parts = speeds("parts")
    floor, ways = "MAPPO's floor: ", ("torch.mm", "oneDNN")
    mm, dnn = (parts[f"{floor}float32 product, {way}, 750 x 128 x 128"] for way in ways)
    share_mm, share_dnn = (parts[f"{floor}fraction of the floor by float32 product, {way}"] for way in ways)
    step = parts["MAPPO's time: all"]
    assert f"({mm:.0f} GFLOP/s)" in page
    assert f"({dnn:.0f} GFLOP/s) it takes {step * share_dnn:.1f} µs" in page
    assert (
        f"MAPPO takes {step:.1f} µs with rollouts (`parts`), a fraction of **{share_mm:.2f}** or {share_dnn:.2f}"
        in page
    )
    assert f"at least {step * share_mm:.1f} µs on two cores" in page
