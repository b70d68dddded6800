"""Table of all units of a run on disk, written chunk by chunk in constant memory."""

import contextlib
import csv
import dataclasses
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np

from rvjax.base import frames
from rvjax.base.fields import elements
from rvjax.base.files import check_writable, replacing
from rvjax.population import Population
from rvjax.records import PyTree
from rvjax.status import Status, succeeded

if TYPE_CHECKING:
    from pyarrow import Schema
    from pyarrow.parquet import ParquetWriter

    from rvjax.base.frames import DataFrame

ENDINGS = (".csv", ".parquet")
FORMAT = 1
ABOUT = b"rvjax"
"""Key of the JSON in a Parquet file's metadata, with seed, versions and study."""

Columns = Mapping[str, np.ndarray]
Write = Callable[[int, Columns, np.ndarray, Columns], None]
"""Takes number of the first unit, responses by name (n,), status (n,) and errors by field (*shape, n)."""


@dataclasses.dataclass(frozen=True)
class UnitFile:
    """File of all units of `monte_carlo`, one row each, in SI: number, status, responses and, if required, errors.

    A unit that failed has no response: an empty cell (CSV), NaN (Parquet). The elements of an error are columns such as
    "disc_bore[0,1,0]". CSV has units in its header; Parquet in the metadata of each column, with seed, versions and
    study in that of the file, and a row group for each chunk.

    Attributes:
        path: ends with .csv or .parquet (needs the extra parquet).
        errors: the sampled errors, a column for each element.
        units: SI unit by name of a response, or of an error whose record has none.
        about: further texts of the study in the Parquet file, by name.

    Raises:
        ValueError: another ending.
        ImportError: pyarrow is not installed.
    """

    path: str | Path
    errors: bool = False
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    about: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if Path(self.path).suffix not in ENDINGS:
            raise ValueError(f"{self.path}: must end with {' or '.join(ENDINGS)}")
        if Path(self.path).suffix == ".parquet":
            frames.needed("pyarrow.parquet", str(self.path), "parquet")

    def columns(self, names: Sequence[str], population: Population) -> dict[str, str]:
        """Name and unit of each number of a unit.

        Args:
            names: of the responses.
            population: names the errors.

        Raises:
            ValueError: two columns would have one name.
        """
        found = [(name or "response", self.units.get(name, "")) for name in names]
        if self.errors:
            record = population.tolerances
            own = {} if isinstance(record, dict) else {f.name: f.metadata["unit"] for f in dataclasses.fields(record)}
            for field, tolerance in population.active.items():
                unit = own.get(field) or self.units.get(field, "")
                found += [(element, unit) for element in elements(field, tolerance.shape)]
        taken = ["unit", "status", *(name for name, _ in found)]
        if double := sorted({name for name in taken if taken.count(name) > 1}):
            raise ValueError(f"{self.path}: two columns would be called {', '.join(double)}; rename the response")
        return dict(found)


@contextlib.contextmanager
def writing(
    target: UnitFile, path: Path, names: Sequence[str], population: Population, about: Mapping[str, PyTree]
) -> Iterator[Write]:
    """A function that adds a chunk; the file is there once the block has ended well, whole or not at all."""
    columns = target.columns(names, population)
    said = {"format": FORMAT, "kind": "units", **about, "study": dict(about.get("study", {})) | dict(target.about)}
    check_writable(path)
    with replacing(path) as partial, _TABLES[Path(target.path).suffix].begun(partial, columns, said) as table:

        def write(first: int, values: Columns, status: np.ndarray, errors: Columns) -> None:
            good = succeeded(status)
            numbers = [np.where(good, values[name], np.nan) for name in names]
            for drawn in errors.values():
                numbers += list(np.asarray(drawn).reshape(-1, drawn.shape[-1])[:, : len(status)])
            rows = zip(columns, (np.asarray(column, np.float64) for column in numbers), strict=True)
            table.add(first + np.arange(len(status)), [_NAMES[int(code)] for code in status], dict(rows))

        yield write


def joined(parts: Sequence[Path], path: Path) -> None:
    """One file from those of several processes, which are removed.

    Args:
        parts: in the order of the units.
        path: of the whole, with the ending of a table.
    """
    with replacing(path) as partial:
        _TABLES[path.suffix].join(parts, partial)
    for part in parts:
        if part != path:
            part.unlink()


_NAMES = {int(status): status.name for status in Status}


class _Csv:
    """Numbers as the shortest text that gives all bits back; an empty cell where there is none."""

    def __init__(self, file: TextIO) -> None:
        self._rows = csv.writer(file, lineterminator="\n")

    @classmethod
    @contextlib.contextmanager
    def begun(cls, path: Path, columns: Mapping[str, str], about: Mapping[str, PyTree]) -> "Iterator[_Csv]":
        with path.open("w", encoding="utf-8", newline="") as file:
            made = cls(file)
            heads = (f"{name} [{unit}]" if unit else name for name, unit in columns.items())
            made._rows.writerow(["unit", "status", *heads])
            yield made

    def add(self, number: np.ndarray, status: list[str], columns: Columns) -> None:
        cells = [[None if x != x else x for x in column.tolist()] for column in columns.values()]
        self._rows.writerows(zip(number.tolist(), status, *cells))

    @staticmethod
    def join(parts: Sequence[Path], path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as file:
            for part in parts:
                with part.open(encoding="utf-8", newline="") as source:
                    head = source.readline()
                    if part == parts[0]:
                        file.write(head)
                    shutil.copyfileobj(source, file)


class _Parquet:
    """Each chunk is a row group."""

    def __init__(self, writer: "ParquetWriter", schema: "Schema") -> None:
        self._writer, self._schema = writer, schema

    @classmethod
    @contextlib.contextmanager
    def begun(cls, path: Path, columns: Mapping[str, str], about: Mapping[str, PyTree]) -> "Iterator[_Parquet]":
        import pyarrow
        from pyarrow import parquet

        own = [
            pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit} if unit else None)
            for name, unit in columns.items()
        ]
        first = [pyarrow.field("unit", pyarrow.int64()), pyarrow.field("status", pyarrow.string())]
        schema = pyarrow.schema([*first, *own], metadata={ABOUT: json.dumps(about)})
        with parquet.ParquetWriter(path, schema) as writer:
            yield cls(writer, schema)

    def add(self, number: np.ndarray, status: list[str], columns: Columns) -> None:
        import pyarrow

        table = pyarrow.table([number, status, *columns.values()], schema=self._schema)
        self._writer.write_table(table, row_group_size=len(number))

    @staticmethod
    def join(parts: Sequence[Path], path: Path) -> None:
        from pyarrow import parquet

        with parquet.ParquetWriter(path, parquet.read_schema(parts[0])) as writer:
            for part in parts:
                with parquet.ParquetFile(part) as file:
                    for number in range(file.num_row_groups):
                        table = file.read_row_group(number)
                        writer.write_table(table, row_group_size=len(table))


_TABLES: dict[str, type[_Csv] | type[_Parquet]] = {".csv": _Csv, ".parquet": _Parquet}


def parquet_origin(path: Path) -> dict[str, PyTree]:
    """Read kind, seed, study and versions of a Parquet file of units.

    Raises:
        ValueError: no file of units of rvjax, or damaged.
        ImportError: pyarrow is not installed.
    """
    frames.needed("pyarrow.parquet", str(path), "parquet")
    from pyarrow import ArrowException, parquet

    try:
        about = json.loads((parquet.read_schema(path).metadata or {})[ABOUT])
    except (ArrowException, KeyError, ValueError) as error:
        raise ValueError(f"{path}: damaged, or no result of rvjax ({' '.join(str(error).split())})") from None
    if about.get("format") != FORMAT:
        raise ValueError(f"{path}: has format {about.get('format')!r}, this version of rvjax reads {FORMAT}")
    return about


def parquet_frame(path: Path) -> "DataFrame":
    """Return the units of a Parquet file as a `pandas.DataFrame`, SI, indexed by unit; units in `attrs["units"]`.

    Raises:
        ValueError: as `parquet_origin`.
        ImportError: pandas or pyarrow is not installed.
    """
    about = parquet_origin(path)
    frames.needed("pandas", str(path), "parquet")
    from pyarrow import parquet

    read = parquet.read_table(path)
    frame = read.to_pandas().set_index("unit")
    units = {field.name: field.metadata[b"unit"].decode() for field in read.schema if field.metadata}
    frame.attrs = {"units": units, **{key: about[key] for key in ("seed", "versions")}}
    return frame
