"""A table, and what of it is saved as CSV."""

from base64 import b64decode

from ddpc_reports.tables.table import Cell, Heading, Row, Table


def test_a_text_is_no_formula_for_a_spreadsheet() -> None:
    cells = (Cell("=1+1"), Cell("-5"), Cell("+1e-3"), Cell("-cmd|x"), Cell("@x\x1b"), Cell("a=1"))
    table = Table("t", "T", (Heading("="), *(Heading(str(i)) for i in range(6))), (Row("=a", cells),))
    text = b64decode(table.csv_uri.partition(",")[2]).decode()
    assert text.splitlines()[1] == "'=a,'=1+1,-5,+1e-3,'-cmd|x,'@x\\x1b,a=1"
