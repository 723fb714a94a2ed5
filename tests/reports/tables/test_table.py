"""A table, and what of it is saved as CSV."""

from base64 import b64decode

from markupsafe import Markup

from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_reports.page import set_page
from ddpc_reports.sections import Section, StudyPart


def test_a_text_is_no_formula_for_a_spreadsheet() -> None:
    cells = (Cell("=1+1"), Cell("-5"), Cell("+1e-3"), Cell("-cmd|x"), Cell("@x\x1b"), Cell("a=1"))
    table = Table("t", "T", (Heading("="), *(Heading(str(i)) for i in range(6))), (Row("=a", cells),))
    text = b64decode(table.csv_uri.partition(",")[2]).decode()
    assert text.splitlines()[1] == "'=a,'=1+1,-5,+1e-3,'-cmd|x,'@x\\x1b,a=1"


def test_a_cell_leads_to_its_place_and_tells_failures_in_words() -> None:
    cell = Cell(
        "1.2", 1.2, best=True, href="#s1-1-responses", title="in <deg>", detail="1 … 2", failures="1 of 5"
    )
    heading = Heading("calm", group="tanks", href="#a", group_href="#b")
    rows = (Row("a", (cell,)),)
    section = Section("s", "S", [("table", Table("t", "T", (Heading("controller"), heading), rows))])
    page = set_page([StudyPart("s1-", 1, "t", [], {}, Markup(""), [], [section])], {})
    row = page[page.index('<th scope="row">') :]
    assert row.startswith(
        '<th scope="row">a</th><td class="n best" title="in &lt;deg&gt;">'
        '<b><a href="#s1-1-responses">1.2</a></b><span class="unseen"> (best)</span>'
        ' <small class="failed">✕\xa01 of 5</small><small>1 … 2</small></td>'
    )
    assert '<th scope="colgroup" colspan="1"><span><a href="#b">tanks</a></span></th>' in page
    assert '<th scope="col" class="n"><a href="#a">calm</a></th>' in page
