"""Pages of the benchmark say what its results say, and nothing else."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from evidence import pages
from evidence.pages import (
    FIGURE,
    ROOT,
    TABLE,
    all_results,
    digest,
    figure,
    with_figures,
    written_by_hand,
)
from evidence.run import Results
from evidence.score import Row
from evidence.simulated.kinds import FURTHER, KINDS

PROGRAMS = ("tumble joint", "tumble ellipsoid", "imu_tk")


def row(kind: str, index: int, program: str, z: float = 0.8, verdict: str = "accepted") -> Row:
    errors = {"accel.bias": (0.01 * (1.0 + index), 0.05), "accel.scale": (1e-4, 5e-3)}
    states = program != "imu_tk"
    return Row(
        case=f"{kind} {index}", kind=kind, program=program, verdict=verdict, said=verdict,  # type: ignore[arg-type]
        z={"accel.bias.x": z, "accel.scale.x": -0.5} if states else {}, covered=2, intervals=2 if states else 0,
        errors=errors,
    )  # fmt: skip


@pytest.fixture
def made_up() -> Results:
    rows = [
        row(kind.name, index, program)
        for index in range(3)
        for kind in KINDS
        for program in PROGRAMS
    ]  # fmt: skip
    made = {
        "set": "simulated", "commit": "0123456789abcdef", "date": "2026-01-01", "machine": "a machine",
        "system": "a system", "series": "made up", "sessions": 3 * len(KINDS), "kinds": len(KINDS),
        "sessions_of_a_kind": 3, "programs": list(PROGRAMS),
    }  # fmt: skip
    return Results(made=made, rows=tuple(rows), cost={p: {"seconds": 1.0, "megabytes": 100} for p in PROGRAMS})


def test_pictures_are_of_the_results() -> None:
    results = all_results()
    if "simulated" in results:
        for name in ("evidence-kinds.svg", "evidence-programs.svg"):
            picture = (pages.PICTURES / name).read_text(encoding="utf-8")
            assert f"results {digest(results['simulated'])}" in picture, "run python -m evidence.pages"


@pytest.mark.parametrize("path", written_by_hand(), ids=lambda path: path.name)
def test_figures_in_pages_are_those_of_the_results(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if FIGURE.search(text) or TABLE.search(text):
        assert with_figures(text, all_results()) == text, "run python -m evidence.pages"


def test_what_studies_have_stored_says_what_it_is_of() -> None:
    for path in sorted((ROOT / "studies/results").glob("*.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        assert {"command", "commit", "date", "machine", "seed", "N"} <= set(content["made"]), path.name
        assert (ROOT / "studies" / f"{path.stem}.py").exists()
        assert not content["made"]["commit"].endswith("changed"), path.name
        for rows in content["tables"].values():
            assert len({len(row) for row in rows}) == 1


def test_a_table_of_a_study_is_put_where_its_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    content = {"made": {"date": "2026-01-02"}, "figures": {"x": "7"}, "tables": {"t": [["a", "b"], ["1", "2 %"]]}}
    (tmp_path / "studies/results").mkdir(parents=True)
    (tmp_path / "studies/results/some.json").write_text(json.dumps(content), encoding="utf-8")
    text = "<!-- figure: some | made | date --><!-- end -->: <!-- figure: some | figures | x --><!-- end -->\n"
    text += "<!-- table: some | t -->\n<!-- end -->\n"
    filled = with_figures(text, {})
    assert "2026-01-02" in filled
    assert "-->7<!--" in filled
    assert "\n\n| a | b |\n| --- | --- |\n| 1 | 2 % |\n\n<!-- end -->" in filled
    assert with_figures(filled, {}) == filled
    with pytest.raises(KeyError):
        with_figures("<!-- table: some | none -->\n<!-- end -->", {})


def test_published_results_are_of_300_sessions_of_30_kinds_with_sealed_seeds() -> None:
    results = all_results()
    if "simulated" in results:
        made = results["simulated"].made
        assert made["sessions"] >= 300
        assert made["kinds"] >= 30
        assert not made["commit"].endswith("changed")


def test_a_figure_is_put_where_its_name_is_and_one_that_no_result_has_is_refused(made_up: Results) -> None:
    text = "Of <!-- figure: simulated | made | sessions -->0<!-- end --> sessions "
    text += "<!-- figure: simulated | tumble joint | hand-8 | covered -->?<!-- end --> are covered."
    out = with_figures(text, {"simulated": made_up})
    assert f"-->{3 * len(KINDS)}<!-- end -->" in out
    assert "-->100.0 %<!-- end -->" in out
    assert with_figures(out, {"simulated": made_up}) == out
    results = {"simulated": made_up}
    assert figure("simulated | over joint | imu_tk | accel.bias", results) == "1.00 ± 0.00"
    bad = sum(kind.expected in ("refuse", "name the cause") for kind in KINDS)
    assert figure("simulated | useless | imu_tk", results) == f"{3 * bad} of {3 * bad}"
    with pytest.raises(KeyError):
        figure("simulated | over joint | imu_tk | gyro.axis", results)
    with pytest.raises(KeyError):
        figure("simulated | tumble joint | no such kind | rms", {"simulated": made_up})
    with pytest.raises(KeyError):
        with_figures(text, {})


def test_a_figure_never_begins_a_line_where_it_would_end_the_paragraph(made_up: Results) -> None:
    text = "Simulated sessions:\n<!-- figure: simulated | made | sessions -->0<!-- end --> of them."
    assert with_figures(text, {"simulated": made_up}).startswith("Simulated sessions: <!-- figure")


def test_losses_are_named(made_up: Results) -> None:
    rows = list(made_up.rows)
    at = next(i for i, r in enumerate(rows) if r.kind == "hand-8" and r.program == "tumble joint")
    rows[at] = row("hand-8", 0, "tumble joint", z=4.6)
    rows = [
        replace(r, errors={group: (0.5 * off * (1.0 + 1e-3 * i), was) for group, (off, was) in r.errors.items()})
        if r.program == "imu_tk" and r.kind == "cube-26" else r
        for i, r in enumerate(rows)
    ]  # fmt: skip
    text = pages.losses(replace(made_up, rows=tuple(rows)), KINDS)
    assert re.search(r"`hand-8 0` \(seed [0-9a-f]{16}\), `accel.bias.x` by \+4.6 u", text)
    assert re.search(r"imu_tk 0\.5\d of `accel\.bias` in `cube-26` \(N = 3\)", text)
    assert "`in-g` 3 of 3" in text


def test_every_kind_and_program_has_its_line(made_up: Results) -> None:
    by_kind = pages.kind_table(made_up, KINDS)
    for kind in KINDS:
        assert by_kind.count(f"| `{kind.name}` | {kind.words} | {kind.expected} |") == 1
    good = sum(kind.expected == "accept" for kind in KINDS)
    assert f"| tumble joint | {3 * good} | {3 * good} | 0 |" in pages.program_table(made_up, KINDS)
    assert "| imu_tk | " in pages.left_table(made_up, KINDS)


def test_pictures_are_drawn_of_any_results(made_up: Results, tmp_path: Path) -> None:
    pages.draw_kinds(made_up, tmp_path / "kinds.svg")
    pages.draw_programs(made_up, tmp_path / "programs.svg")
    for path in tmp_path.iterdir():
        assert digest(made_up) in path.read_text(encoding="utf-8")


# -------------------- recordings of other kinds --------------------


def test_tables_of_other_kinds_have_errors_in_units_and_per_cent(made_up: Results) -> None:
    """Two sessions with errors of 3 and 4 µT of hard irons of 10 µT each: rms 3.5 µT, 35 %."""
    rows = [
        Row(
            case=f"mag-pivot {i}", kind="mag-pivot", program=program, verdict=verdict, said="",  # type: ignore[arg-type]
            z={"mag.bias.x": 0.5},
            covered=1, intervals=1, errors={"mag.bias": (error, 10.0), "mag.scale": (2e-3, 2e-2)},
        )
        for program, verdict in (("tumble joint", "accepted"), ("imu_tk", "gave up"))
        for i, error in enumerate((3.0, 4.0))
    ]  # fmt: skip
    lines = pages.further_table(replace(made_up, rows=tuple(rows)), "magnetometer").splitlines()
    assert lines[2:] == [
        "| `mag-pivot` | tumble joint | 2 of 2 | 3.5 (35 %) | 0.20 (10 %) | – | 0.50 | 0.5 | 100.0 % |"
    ]


def test_every_other_kind_is_in_one_table() -> None:
    families = [pages.family_of(kind) for kind in FURTHER]
    assert set(families) == set(pages.FAMILIES)
    assert pages.further_kinds().count("\n") == len(FURTHER) + 1


def test_published_results_of_other_kinds_are_of_four_sessions_and_more() -> None:
    results = all_results()
    if "further" in results:
        made = results["further"].made
        assert made["sessions_of_a_kind"] >= 4
        assert made["kinds"] == len(FURTHER)
        assert not made["commit"].endswith("changed")
