"""Figures in documents are those that were measured."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import figures
from figures import DOCUMENTS, PARTS, RESULTS, Figure, as_quoted, quotes, read_results, with_figures


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_documents_quote_what_was_measured(document):
    measured = read_results()
    for name, number in quotes(document.read_text(encoding="utf-8")):
        assert name in measured, f"{name} is in no result file"
        assert number == as_quoted(measured[name].value, number), f"run make figures WRITE=1 for {name}"


def test_some_document_quotes_figures_of_every_part():
    quoted = {name.partition(".")[0] for path in DOCUMENTS for name, _ in quotes(path.read_text(encoding="utf-8"))}
    assert quoted >= set(PARTS)


@pytest.mark.parametrize("part", PARTS)
def test_every_part_was_measured_and_says_how(part):
    found = json.loads((RESULTS / f"{part}.json").read_text(encoding="utf-8"))
    assert {"command", "commit", "date", "machine", "seeds", "figures"} <= set(found)
    assert found["command"] == f"python benchmarks/figures.py {part} --write"
    assert all(name.startswith(f"{part}.") for name in found["figures"])


def test_a_figure_is_worse_where_it_is_so_by_more_than_its_noise():
    more, less = Figure(98.0, 2.0, True), Figure(0.6, 0.1, False)
    assert Figure(96.0, 2.0, True).worse_by(more) <= 0
    assert Figure(95.0, 2.0, True).worse_by(more) > 0
    assert Figure(0.69, 0.1, False).worse_by(less) <= 0
    assert Figure(0.72, 0.1, False).worse_by(less) > 0


def test_measured_numbers_replace_quoted_ones():
    text = "It is 98 %<!-- a.b_percent --> and 0.63 cm<!-- a.c_cm --> of 5 cm<!-- x.y -->."
    found = with_figures(text, {"a.b_percent": Figure(96.2, 2, True), "a.c_cm": Figure(0.719, 0.1, False)})
    assert found == "It is 96 %<!-- a.b_percent --> and 0.72 cm<!-- a.c_cm --> of 5 cm<!-- x.y -->."


def test_a_figure_that_became_worse_ends_the_command(monkeypatch, capsys):
    parts = {"desk": lambda _: {"desk.placed_percent": Figure(50.0, 0.0, True)}}
    monkeypatch.setattr(sys, "argv", ["figures.py", "desk"])
    with pytest.raises(SystemExit, match=r"desk\.placed_percent"):
        figures.run(None, parts)
    assert "was" in capsys.readouterr().out
