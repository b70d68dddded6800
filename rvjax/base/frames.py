"""Results as tables of pandas and data sets of xarray; both packages are optional: `pip install 'rvjax[tables]'`."""

import dataclasses
import importlib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from pandas import DataFrame as DataFrame
    from xarray import Dataset as Dataset


class Interval(Protocol):
    """A value with its standard error and the ends of its interval."""

    @property
    def value(self) -> float: ...
    @property
    def error(self) -> float: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...


class Column(NamedTuple):
    """One field of a record, or of a record in it: its name, numbers, axes, unit and meaning."""

    name: str
    values: np.ndarray
    dims: tuple[str, ...]
    unit: str
    meaning: str


def data_set(record: "DataclassInstance", batch: Sequence[str] = ()) -> "Dataset":
    """Return an `xarray.Dataset` of a record: a variable for each field, SI, with `units` and `long_name`.

    Args:
        record: whose fields declare unit, shape and meaning.
        batch: names of the leading axes that `jax.vmap` gave it.

    Raises:
        ImportError: xarray is not installed.
        ValueError: a field has other axes than these and its own.
    """
    xarray = needed("xarray", "to_xarray")
    columns = list(_columns(record, tuple(batch)))
    made = xarray.Dataset({c.name: (c.dims, c.values, {"units": c.unit, "long_name": c.meaning}) for c in columns})
    texts = {f.name: getattr(record, f.name) for f in dataclasses.fields(record) if f.metadata["kind"] in _STATIC}
    names = {_singular(name): list(text) for name, text in texts.items() if isinstance(text, tuple)}
    made = made.assign_coords({name: text for name, text in names.items() if made.sizes.get(name) == len(text)})
    plain = {name: text for name, text in texts.items() if isinstance(text, (str, int))}
    return made.assign_attrs(record=type(record).__name__, **plain)


def frame(record: "DataclassInstance", batch: Sequence[str] = (), along: str | None = None) -> "DataFrame":
    """Return a `pandas.DataFrame` of a record, SI: one row for each unit, one column for each number of it.

    Args:
        record: whose fields declare unit, shape and meaning.
        batch: names of the leading axes that `jax.vmap` gave it; they index the rows.
        along: an axis of fields, such as "angle": one row for each of its elements, with the fields that have it.

    Raises:
        ImportError: pandas is not installed.
        ValueError: a field has other axes than these and its own, or none has the axis `along`.
    """
    pandas = needed("pandas", "to_pandas")
    rows = (*batch, *((along,) if along else ()))
    columns = [c for c in _columns(record, tuple(batch)) if along is None or along in c.dims]
    if along is not None and not columns:
        known = sorted({dim for c in _columns(record, tuple(batch)) for dim in c.dims} - set(batch))
        raise ValueError(f"along = {along!r}: {type(record).__name__} has the axes {', '.join(known) or 'of a scalar'}")
    sizes = {dim: size for c in columns for dim, size in zip(c.dims, c.values.shape)}
    found, units = {}, {}
    for column in columns:
        own = [dim for dim in column.dims if dim not in rows]
        order = [column.dims.index(dim) for dim in (*(dim for dim in rows if dim in column.dims), *own)]
        missing = tuple(k for k, dim in enumerate(rows) if dim not in column.dims)  # one value for the whole batch
        values = np.expand_dims(column.values.transpose(order), missing)
        values = np.broadcast_to(values, (*(sizes.get(dim, 1) for dim in rows), *values.shape[len(rows) :]))
        for place in itertools.product(*(range(sizes[dim]) for dim in own)):
            name = f"{column.name}[{','.join(map(str, place))}]" if place else column.name
            at: Any = (..., *place)
            found[name], units[name] = values[at].ravel(), column.unit
    index = None
    if rows:
        index = pandas.MultiIndex.from_product([range(sizes.get(dim, 1)) for dim in rows], names=rows)
        index = index.get_level_values(0) if len(rows) == 1 else index
    made = pandas.DataFrame(found, index=index)
    made.attrs["units"] = units
    return made


def tidy(rows: Iterable[Mapping[str, object]], index: Sequence[str]) -> "DataFrame":
    """Return a `pandas.DataFrame` of rows by name."""
    pandas = needed("pandas", "to_pandas")
    return pandas.DataFrame(list(rows)).set_index(list(index))


def spread(name: str, estimate: Interval | None) -> dict[str, float]:
    """Return an estimate as columns: value, standard error, ends of its interval.

    Args:
        name: of the value.
        estimate: with `value`, `error`, `lower` and `upper`; None gives no column.
    """
    if estimate is None:
        return {}
    ends = {f"{name}_{end}": getattr(estimate, end) for end in ("error", "lower", "upper")}
    return {name: estimate.value} | ends


_STATIC = ("text", "count")


class MissingExtra(ImportError):
    """An optional package is not installed; the message names the extra that does it."""


def needed(package: str, what: str, extra: str = "tables") -> ModuleType:
    """Return an optional package.

    Args:
        package: or module of it.
        what: needs it.
        extra: that installs it.

    Raises:
        MissingExtra: the package is not there; an error inside the package is raised as it is.
    """
    name = package.partition(".")[0]
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name not in (name, package):
            raise
        raise MissingExtra(f"{what} needs {name}: pip install 'rvjax[{extra}]'") from None


def _columns(
    record: "DataclassInstance | type[DataclassInstance]", batch: tuple[str, ...], prefix: str = ""
) -> Iterator[Column]:
    for f in dataclasses.fields(record):
        value, about, name = getattr(record, f.name), f.metadata, prefix + f.name
        if value is None or about["kind"] in _STATIC:
            continue
        if dataclasses.is_dataclass(value):
            yield from _columns(value, batch, f"{name}_")
            continue
        values, declared = np.asarray(value), _dims(about["shape"])
        possible = [(*batch, *declared), declared, batch, ()]  # the same for all units; one number for all elements
        dims = next((dims for dims in possible if len(dims) == values.ndim), None)
        if dims is None:
            own = f"its own axes ({', '.join(declared)})" if declared else "a scalar"
            named = ", ".join(batch) or "none"
            raise ValueError(
                f"{type(record).__name__}.{f.name}: shape {values.shape} is {own} behind those of a batch, of which "
                f"you named: {named}; name them, outermost first, as in batch=('unit',)"
            )
        if name in dims and dims != (name,):  # no variable of several axes may be called as one of them
            name = f"{name}_value"
        yield Column(name, values, dims, about["unit"], about["meaning"])


def _dims(shape: tuple[str | int, ...]) -> tuple[str, ...]:
    """Names of declared axes: "discs" -> "disc", 2 -> "axis_2"; a name that comes again has a number."""
    names: list[str] = []
    for axis in shape:
        name = _singular(axis) if isinstance(axis, str) else f"axis_{axis}"
        names.append(f"{name}_{names.count(name) + 1}" if name in names else name)
    return tuple(names)


def _singular(name: str) -> str:
    return name.removesuffix("s")
