"""One table, three forms: each shows every cell, and none breaks a number."""

import io
import re
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table, runs_table, side_by_side
from experiments.reports.table import Cell, Column, Row, Table, show
from experiments.reports.terminal_table import TerminalTable
from robots.errors import ConfigError
from tests.support.made_runs import made_run

WORDS = Column("filter", words=True)
SMALL = Table(
    (WORDS, Column("h", "mm"), Column("ticks\nlate")),
    (Row(("CBF", Cell("-7.44", bad=True), "3")), Row(("ISSf-CBF", "9.54", "0"), bold=True)),
    "Hands",
    "smallest h",
)


def drawn(table: Table, width: int) -> str:
    out = io.StringIO()
    show(table, Console(file=out, force_terminal=True, width=width, color_system=None))
    return out.getvalue()


def piped(table: Table) -> str:
    out = io.StringIO()
    show(table, Console(file=out, force_terminal=False, width=20))
    return out.getvalue()


class Cells(HTMLParser):
    """The texts of a page's table cells, with their classes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.cells: list[tuple[str, str]] = []
        self.within = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in {"td", "th"}:
            self.within = True
            self.cells.append((" ".join((dict(attrs).get("class") or "").split()), ""))

    def handle_endtag(self, tag: str) -> None:
        self.within = self.within and tag not in {"td", "th"}

    def handle_data(self, data: str) -> None:
        if self.within:
            kind, text = self.cells[-1]
            self.cells[-1] = kind, text + data


# --- Markdown


def test_markdown_has_title_heads_rows_and_caption() -> None:
    assert SMALL.markdown() == (
        "### Hands\n\n"
        "| filter | h [mm] | ticks late |\n| --- | --- | --- |\n"
        "| CBF | -7.44 | 3 |\n| **ISSf-CBF** | **9.54** | **0** |\n\n"
        "smallest h"
    )


def test_markdown_of_rows_with_units_has_them_beside_the_words() -> None:
    table = side_by_side(["CBF", "none"], [(Metric("h", "nearest", "mm", 1e3), (0.012, None))])
    assert table.markdown() == "|  | CBF | none |\n| --- | --- | --- |\n| nearest (mm) | 12 | - |"


def test_further_lines_of_a_title_are_text() -> None:
    table = Table((Column("a"),), (Row(("1",)),), "Title\nmore of it")
    assert table.markdown().startswith("### Title\n\nmore of it\n\n| a |")


def test_what_ends_a_cell_in_markdown_is_escaped() -> None:
    line = Table((Column("|d|"),), (Row(("a|b\nc",)),)).markdown().splitlines()
    assert line[0] == r"| \|d\| |"
    assert line[2] == r"| a\|b c |"


# --- terminal or not


def test_a_table_is_drawn_in_a_terminal_and_markdown_anywhere_else() -> None:
    assert piped(SMALL) == SMALL.markdown() + "\n\n"
    text = drawn(SMALL, 80)
    assert "|" not in text
    assert "─" in text
    for words in ("Hands", "filter", "[mm]", "-7.44", "ISSf-CBF", "smallest h"):
        assert words in text


def test_what_should_not_be_is_red_in_a_terminal() -> None:
    out = io.StringIO()
    show(SMALL, Console(file=out, force_terminal=True, width=80, color_system="standard", no_color=False))
    assert re.search(r"\x1b\[31m *-7\.44", out.getvalue())
    assert not re.search(r"\x1b\[31m *9\.54", out.getvalue())


NUMBERS = st.floats(-1e9, 1e9).map(lambda x: f"{x:.4g}")


@given(
    st.lists(st.lists(NUMBERS, min_size=12, max_size=12), min_size=1, max_size=4),
    st.integers(1, 2),
    st.integers(40, 200),
)
def test_folded_every_number_is_whole_and_no_line_too_long(numbers: list[list[str]], labels: int, width: int) -> None:
    names = tuple(Column(f"name {k}", words=True) for k in range(labels))
    heads = tuple(Column(f"a longer heading {k}", "m/s") for k in range(12))
    rows = tuple(Row((*(f"run {i}" for _ in names), *line)) for i, line in enumerate(numbers))
    table = Table((*names, *heads), rows)
    text = drawn(table, width)
    assert max(cell_len(line) for line in text.splitlines()) <= width
    shown = sorted(word for word in text.split() if re.fullmatch(r"-?[\d.]+(e[+-]\d+)?", word) and "." in word)
    assert shown == sorted(n for line in numbers for n in line if "." in n)
    blocks = TerminalTable(table, width).folded()
    assert [i for block in blocks for i in block[labels:]] == list(range(labels, labels + 12))
    assert all(block[:labels] == list(range(labels)) for block in blocks)


def test_a_table_that_fits_is_one_block_and_blocks_are_of_about_one_width() -> None:
    table = Table((WORDS, *(Column(f"c{k}") for k in range(10))), (Row(("issf", *["1.2345"] * 10)),))
    assert len(TerminalTable(table, 90).folded()) == 1
    sizes = [len(block) for block in TerminalTable(table, 60).folded()]
    assert sizes == [6, 6]


# --- HTML


def test_html_has_every_cell_and_marks_what_should_not_be() -> None:
    page = Cells(str(SMALL.html()))
    texts = [text for _, text in page.cells]
    assert texts[:3] == ["filter", "h [mm]", "ticks\nlate"]
    assert texts[3:] == ["CBF", "-7.44", "3", "ISSf-CBF", "9.54", "0"]
    assert [text for kind, text in page.cells if kind == "bad"] == ["-7.44"]
    assert "<caption>Hands</caption>" in SMALL.html()
    assert "smallest h" in SMALL.html()


def test_html_of_rows_with_units_has_a_column_of_them() -> None:
    table = side_by_side(["CBF"], [(Metric("h", "nearest", "mm", 1e3, "negative"), (-0.012,))])
    assert Cells(str(table.html())).cells[3:] == [("words", "nearest"), ("bad", "-12"), ("unit", "mm")]


def test_a_cell_leads_where_its_link_says() -> None:
    table = Table((Column("run", words=True),), (Row((Cell("one", link="runs/a%20b/"),)), Row(("two",))))
    assert '<a href="runs/a%20b/">one</a>' in table.html()
    assert table.html().count("<a ") == 1
    assert table.markdown().splitlines()[2:] == ["| one |", "| two |"]


def test_text_from_outside_stays_text_in_html() -> None:
    html = Table((Column("<i>", "<b>"),), (Row(("<script>",)),), "<u>", "<p>").html()
    assert "&lt;script&gt;" in html
    assert not re.search(r"<(i|b|u|script|p)>", html)


# --- tables of figures


def test_columns_of_words_stand_to_the_left_and_missing_values_are_dashes() -> None:
    figures = (Metric("robot", "robot"), Metric("fell", "fell"), Metric("h", "h", "mm", 1e3, "negative"))
    table = rows_table([{"robot": "g1", "fell": False, "h": -0.001}, {"robot": "tocabi", "fell": True}], figures)
    assert [c.words for c in table.columns] == [True, False, False]
    assert [table.cells(r) for r in table.rows] == [
        (Cell("g1"), Cell("no"), Cell("-1", bad=True)),
        (Cell("tocabi"), Cell("yes"), Cell("-")),
    ]


def test_runs_stand_side_by_side_under_their_titles() -> None:
    runs = [made_run(ticks=1), made_run(ticks=1, filter="none")]
    table = runs_table(runs)
    assert [c.heading for c in table.columns] == ["", "ISSf-CBF", "no filter"]
    # each group of metrics under its name
    assert [row.cells for row in table.rows] == [
        ("outcome",),
        ("fell", Cell("no"), Cell("no")),
        ("safety",),
        ("smallest self-collision barrier", Cell("50"), Cell("50")),
    ]


def test_a_table_needs_columns_and_room_for_its_cells() -> None:
    with pytest.raises(ConfigError, match="columns"):
        Table((), ())
    with pytest.raises(ConfigError, match="at most 1"):
        Table((WORDS,), (Row(("a", "b")),))
    assert Table((WORDS, Column("n")), (Row(("scene",)),)).markdown().splitlines()[-1] == "| scene |  |"
