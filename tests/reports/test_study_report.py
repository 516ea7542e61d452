"""The page of a study: a table of every scenario, a reference to hold the others against, the paper's claims."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy import stats

from tests.synthetic_study import DEFAULT, MAPPO, VDN, Variant, set_to, without, write_study
from uavaou import InputError, read_study
from uavaou.experiments.study import Study
from uavaou.reports.ablations import ablation_table, ablations
from uavaou.reports.claims import Claim, judge
from uavaou.reports.markdown import END, rounded
from uavaou.reports.scores import study_scores
from uavaou.reports.study_report import begin_marker, claims_markdown, write_claims, write_report
from uavaou.statistics import interval_over_missions

pytestmark = pytest.mark.usefixtures("few_resamples")


def study_with(folder: Path, **fields: Any) -> Path:
    write_study(folder)
    content = yaml.safe_load((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(yaml.safe_dump(content | fields, sort_keys=False))
    return folder


def test_the_commands_of_a_page_are_those_that_work(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "ours")
    assert "uavaou study run ours.yaml\nuavaou study report" in page(folder)
    write_report(folder, tmp_path / "README.md", ["my own.py"])
    text = (folder / "README.md").read_text()
    for command in ("run", "report"):
        assert f"\nuavaou --plugin 'my own.py' study {command} ours.yaml\n" in text
    assert "\nuavaou plot figures results/studies/ours\n" in text


def page(folder: Path) -> str:
    write_report(folder, folder.parent / "README.md")
    return (folder / "README.md").read_text()


def test_every_policy_stands_in_the_table_with_its_mean_the_best_first(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "paper")
    scores = page(folder).partition("## Trainings")[0]
    rows = [line.split(" | ") for line in scores.splitlines() if line.startswith(("| `", "| lower"))]
    names = [row[0].strip("| `") for row in rows]
    assert names == ["lower bound", *["mappo", "best-first", "greedy", "vdn", "qmix", "random"]]
    results = read_study(folder)
    for row in rows[1:]:
        mean = results.stack(row[0].strip("| `"), "paper").mean()
        assert float(row[3].split()[0].replace(",", "")) == pytest.approx(mean, rel=1e-3)
    knows = {row[0].strip("| `"): row[1].strip() for row in rows}
    assert [knows[name] for name in ("lower bound", "greedy", "random")] == ["", "everything", "nothing"]
    assert json.loads((folder / "marl-eval.json").read_text())
    assert not (tmp_path / "README.md").exists()


@pytest.mark.parametrize("other", ["two", ""])
def test_a_page_says_where_wall_clock_times_are_of_several_processors(tmp_path: Path, other: str) -> None:
    folder, remark = write_study(tmp_path / "study"), "their wall-clock times do not compare"
    assert remark not in page(folder)
    set_to(folder, "processor", other or None, policy="mappo", seed=0)
    assert page(folder).count(remark) == 1


def test_a_page_names_the_scenarios_of_several_processors_where_others_have_one(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", scenarios=("small", "large"))
    set_to(folder, "processor", "two", policy="mappo", scenario="large", seed=0)
    assert "The trainings on large ran on several processors" in page(folder)


def test_a_reference_and_claims_are_told_where_the_study_asks_for_them(tmp_path: Path) -> None:
    plain = page(study_with(tmp_path / "plain"))
    assert "Against" not in plain
    assert "claims" not in plain
    text = page(study_with(tmp_path / "asked", reference="vdn", claims=True))
    assert "## Against `vdn`" in text
    assert "better with mappo" in text
    assert "## The paper's claims" in text
    assert begin_marker("asked") in (tmp_path / "README.md").read_text()


def test_verdicts_of_another_study_are_left_alone_and_that_is_said(tmp_path: Path) -> None:
    first, second = (study_with(tmp_path / name, claims=True) for name in ("first", "second"))
    assert write_report(first, tmp_path / "README.md") == []
    text = (tmp_path / "README.md").read_text()
    (remark,) = write_report(second, tmp_path / "README.md")
    assert remark == f"{tmp_path / 'README.md'}: left as it is: the claims there are judged from study 'first'"
    assert (tmp_path / "README.md").read_text() == text
    assert "## The paper's claims" in (second / "README.md").read_text()


def test_a_page_says_what_is_not_done_and_what_failed(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "paper")
    assert "Not finished" not in page(folder)
    failed = [["vdn", "paper", 3, "out\n of memory"], ["rolling", "paper", None, "no plan"]]
    failed.append(["mappo", "paper", 0, "an old one"])
    (folder / ".state.json").write_text(json.dumps({"running": [], "failed": failed}))
    assert page(folder).count("Failed when last tried") == 1  # of a planner
    without(folder, policy="vdn")
    text = page(folder)
    assert "**Not finished: 8 of 12 trainings are done.**" in text
    assert "- `vdn` on paper, seed 3: out of memory\n- `rolling` on paper: no plan\n" in text
    assert "an old one" not in text  # it is done by now


def test_a_bound_that_is_broken_is_told(tmp_path: Path) -> None:
    """Of a planner and of one training alone; a mean that is below by chance is none."""
    assert write_report(study_with(tmp_path / "paper"), tmp_path / "README.md") == []
    folder = write_study(tmp_path / "broken", planners={"greedy": Variant(24.9)}, bound=37.8)
    means = read_study(folder).stack("mappo", "paper").mean(axis=1)
    assert means.min() < 37.8 < means.max()
    set_to(folder, "mean_aou_slots", 30.0, policy="vdn", seed=2)
    remarks = write_report(folder, tmp_path / "README.md")
    assert remarks[0].startswith(
        "'vdn' on 'paper' has a mean AoU of 30.00 slots, which is below the certified bound of 37.80"
    )
    assert [remark.split("'")[1] for remark in remarks] == ["vdn", "greedy"]
    for remark in remarks:
        assert f"**Something is wrong: {remark}.**" in (folder / "README.md").read_text()


def test_a_study_that_is_not_finished_has_a_page(tmp_path: Path) -> None:
    """A scenario without the reference, a variant with one seed, a name that would end a cell, no bound."""
    folder = write_study(tmp_path / "own 1", {"published": MAPPO, "a|b": VDN}, {}, 2, ("paper", "b"), bound=None)
    content = yaml.safe_load((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(yaml.safe_dump(content | {"reference": "published"}))
    without(folder, policy="published", scenario="b")
    text = page(folder)
    assert "uavaou study run 'own 1.yaml'" in text
    compared = text.partition("## Against `published`")[2]
    assert "| a\\|b | 2 |" in compared
    assert "###" not in compared  # one scenario has both
    table = text.partition("## b\n")[2].partition("##")[0]
    assert "`a\\|b`" in table
    assert "published" not in table


def test_one_seed_and_planners_have_intervals_over_missions(tmp_path: Path) -> None:
    results = read_study(write_study(tmp_path / "one", seeds=1, missions=9))
    found = {one.policy: one for one in study_scores(results)["paper"]}
    for name in ("mappo", "greedy"):
        scores = results.stack(name, "paper")[0]
        assert found[name].mean.value == pytest.approx(scores.mean())
        assert found[name].mean == interval_over_missions(scores)
    assert (found["mappo"].seeds, found["greedy"].seeds) == (1, 0)
    assert found["mappo"].wall_s == pytest.approx(60)
    assert found["lower bound"].scores.tolist() == [[25.0]]


def test_a_reference_and_claims_need_their_variants(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {}, vdn: {}}\nreference: mapo\n")
    with pytest.raises(InputError, match=r"reference: no variant 'mapo'.*mappo.*\(variants: mappo, vdn\)"):
        Study.load(path)
    path.write_text("seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {}, vdn: {}}\nreference: vdn\n")
    assert Study.load(path).reference == "vdn"
    path = tmp_path / "own.yaml"
    path.write_text("seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {}, vdn: {}, qmix: {}}\nclaims: true\n")
    assert Study.load(path).claims
    path.write_text(path.read_text().replace("qmix:", "qmix2: {algorithm: qmix}, x:").replace("x: {}", "ippo: {}"))
    with pytest.raises(
        InputError, match=r"claims = True: .* mappo, vdn, qmix, there is no 'qmix'; did you mean 'qmix2'"
    ):
        Study.load(path)


def test_what_cannot_be_written_is_told(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "paper")
    (folder / "README.md").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_report(folder, tmp_path / "README.md")


ANY = "<!-- numbers:claims -->"  # of no study by name
BEGIN = begin_marker("paper")
FLIES = Claim("it flies", "", "not measured", "nothing")


def test_verdicts_are_written_between_the_markers_and_nothing_else_changes(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    variants = {name: variant for name, variant in DEFAULT.items() if name != "vdn"}
    claims = judge(read_study(write_study(tmp_path / "study", variants, seeds=1)))
    table = claims_markdown(claims)
    rows = [line for line in table.splitlines() if line.startswith("|")]
    assert ({row.count("|") for row in rows}, len(rows)) == ({7}, 2 + len(claims))
    assert ("none: one training" in table, "nan" in table) == (True, False)
    for before, begins, ends in (
        (f"# Mine\n\n{BEGIN}\nthe last table\n{END}\n\nThe end.\n", f"# Mine\n\n{BEGIN}\n", f"{END}\n\nThe end.\n"),
        ("", f"## The paper's claims\n\n{BEGIN}\n", f"{END}\n"),
    ):
        readme.write_text(before, encoding="utf-8")
        for _ in range(2):
            write_claims(readme, "paper", claims)
            text = readme.read_text(encoding="utf-8")
            assert text.lstrip().startswith(begins)
            assert text.endswith(ends)
            assert (text.count(BEGIN), text.count(END), text.count(table), "last table" in text) == (1, 1, 1, False)


def test_another_studys_verdicts_are_left_alone(tmp_path: Path) -> None:
    readme, name = tmp_path / "README.md", "a --> b é"  # of a file, too
    readme.write_text(f"{ANY}\nof no study by name\n{END}\n", encoding="utf-8")
    assert write_claims(readme, name, [FLIES]) == name
    text = readme.read_text(encoding="utf-8")
    assert ("of no study" in text, text.count("-->")) == (False, 2)
    assert write_claims(readme, "paper", [FLIES]) == name
    assert readme.read_text(encoding="utf-8") == text
    assert write_claims(readme, name, [replace(FLIES, claim="it lands")]) == name
    assert "it lands" in readme.read_text(encoding="utf-8")


TWICE = [f"{BEGIN}\n{BEGIN}\n{END}", f"{ANY}\n{BEGIN}\n{END}", f"{BEGIN}\n{END}\n{BEGIN}\n{END}"]
OTHERS = [f"{BEGIN}\n<!-- numbers:mine -->\n{END}", f"<!-- numbers:claims of mine -->\n{END}"]


@pytest.mark.parametrize("text", [BEGIN, ANY, f"{END} {BEGIN}", *TWICE, *OTHERS])
def test_markers_without_a_pair_lose_nothing(tmp_path: Path, text: str) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"README\.md"):
        write_claims(readme, "paper", [FLIES])
    assert readme.read_text(encoding="utf-8") == text


PUBLISHED = [40.0, 42.0, 38.0]


def study(variants: Mapping[str, list[float]], scenario: str = "paper") -> dict[str, dict[str, NDArray[np.float64]]]:
    """The mean of each seed."""
    return {scenario: {name: np.array(means) for name, means in variants.items()}}


def test_findings_say_what_the_numbers_say() -> None:
    variants = {
        "masks off": [80.0, 83.0, 79.0],
        "published": PUBLISHED,
        "reward aou": [41.0, 37.0, 42.0],
        "shared": [20.0, 21.0, 20.5],
    }
    found = {one.variant: one for one in ablations(study(variants), "published")}
    assert next(iter(found)) == "published"
    assert found["published"].aou == pytest.approx(40.0)
    assert found["published"].ratio is None
    ratio = found["masks off"].ratio
    assert ratio is not None
    assert ratio.value == pytest.approx(stats.gmean([80, 83, 79]) / stats.gmean(PUBLISHED))
    assert found["masks off"].finding == f"×{ratio.value:.2f} ({ratio.low:.2f}–{ratio.high:.2f}): worse with masks off"
    assert found["reward aou"].finding == "no significant difference with 3 seeds"
    assert found["shared"].finding.endswith(": better with shared")


def test_the_table_is_markdown_by_scenario_with_three_digits() -> None:
    means = study({"published": PUBLISHED, "a|b": [80.0, 82.0, 81.0]}) | study({"published": PUBLISHED}, "quickstart")
    lines = ablation_table(ablations(means, "published")).splitlines()
    assert [line for line in lines if line.startswith("###")] == ["### paper", "### quickstart"]
    assert "| published | 3 | 40.0 | 1 | the reference |" in lines
    assert sum(line.startswith("| a\\|b | 3 | 81.0 | 2.03 (") for line in lines) == 1
    values = (0.0, 0.8739, 38.149, 999.9, 12_449.0, 0.00012345)
    assert [rounded(value) for value in values] == ["0", "0.874", "38.1", "1,000", "12,400", "0.000123"]
    assert rounded(14_539.2, 4) == "14,540"


def test_what_has_no_interval_or_no_reference_is_said() -> None:
    one = ablations(study({"published": [40.0], "x": [80.0]}), "published")[1]
    assert one.finding == "×2.00; one seed has no interval"
    still = ablations(study({"published": PUBLISHED, "x": [0.0, 0.0]}), "published")[1]
    assert still.finding == "no ratio: an AoU of 0"
    with pytest.raises(InputError, match="did you mean 'published'"):
        ablations(study({"published": PUBLISHED}), "publishd")
