"""Section of the page on the reducer: every number with its source, and a drawing."""

from rvjax import catalogue
from rvjax.records import PyTree
from rvjax.render import Cell, Figure, Note, Section, Table, Text, Titled
from rvjax.study import Study, facts_of, kind_of, shown


def design_section(study: Study) -> Section:
    """Every number of the design and where it comes from, and a drawing to scale."""
    rows: list[list[Cell]] = []
    for one in study.numbers:
        name = Titled(one.path.replace(".", " "), one.meaning)
        rows.append([name, _value(one.value, one.unit), one.origin, "assumed" if one.assumed else ""])
    rows += [[name, value, "follows from the numbers above", ""] for name, value in facts_of(study.design)]
    parts: list[Note | Table | Figure] = []
    if drawing := kind_of(study.design).drawing:
        parts.append(Figure("design", drawing.caption(study.design), lambda: drawing.reducer(study.design)))
    if study.assumed:
        parts.append(Note("Values marked assumed are not published: the result depends on them."))
    if study.base:
        parts.append(Note(f"Base {study.base}. {catalogue.citation(study.base)}"))
    columns = [Text("number"), Text("value", wraps=True), Text("from", wraps=True), Text("note")]
    listed = Table("design", columns, rows)
    numbers = Section("", (listed,), fold=f"All {len(rows)} numbers of the design and their sources")
    return Section("The reducer", (Section("", tuple(parts), style="reducer"), numbers))


def _value(value: PyTree, unit: str) -> str:
    """A number of a design with its unit, or a word; of an array the elements."""
    if isinstance(value, str):
        return value
    if getattr(value, "shape", ()) or isinstance(value, list | tuple):
        return ", ".join(_value(item, unit) for item in value)
    return shown(value, unit) if unit != "-" else f"{float(value):.6g}"
