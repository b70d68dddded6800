"""A response is a pure function of the errors of one unit; here it meets a batch of units.

It returns a scalar, a dict or record of scalars, or an `Outcome` that names why a unit failed. Inside this
package its values are always a dict; a plain scalar is wrapped in `evaluate` and unwrapped in `unwrapped`.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import Options, inside, kept_folder, understood
from rvjax._jax.sizes import BLOCK as BLOCK, CPU, default_platform, platform_of, spread
from rvjax.base.words import UnknownWord, meant
from rvjax.population import Given, Population, drawn
from rvjax.records import Array, PyTree, Record, field, record
from rvjax.status import Status, succeeded, worst

PLAIN = ""
"""Name of the value of a response that returns one scalar."""
CURVE = "curve"
"""Name of the numbers of a curve among the values of a unit."""

PROGRAMS = 32
"""Plain functions whose programs are kept, the latest ones."""

Values = dict[str, jax.Array]
Function = Callable[..., PyTree]  # a response, or a function that also takes an index
R = TypeVar("R")


class Response(Protocol):
    """A pure function of the errors of one unit: a number, a dict of numbers by name, or an `Outcome`."""

    def __call__(self, errors: PyTree, /) -> PyTree: ...


class DesignResponse(Protocol):
    """A response of a design with free numbers: of the errors of one unit, and of these numbers by name."""

    def __call__(self, errors: PyTree, values: dict[str, Any], /) -> PyTree: ...


def _type_of(leaf: object) -> object:
    """Type of a leaf of the arguments, by which a program is found."""
    if type(leaf) in (float, int, bool):
        return type(leaf)
    return jax.typeof(leaf), spread(leaf)


class Compiled(Generic[R]):
    """A function of a response and arrays, compiled.

    A response that is a record is an argument like the others: its numbers are traced, so that ten thousand
    designs share one program and none of them is kept alive. A plain function is a constant of a program of
    its own; of these the last `PROGRAMS` are kept. `compiler_options` of a response, ((option of XLA, value), ...), are
    those of its programs, but within another program. The command line keeps the traced programs of records.
    """

    def __init__(self, function: Callable[..., R], static: tuple[str, ...] = (), options: Options = ()) -> None:
        functools.update_wrapper(self, function)
        self._options = options

        def shared(options: Options) -> jax.stages.Wrapped:
            return jax.jit(function, static_argnames=static, compiler_options=understood(options))

        def own(response: Function, options: Options) -> jax.stages.Wrapped:
            whole = functools.partial(function, response)
            return jax.jit(whole, static_argnames=static, compiler_options=understood(options))

        self._kept: dict[Any, Callable[[list[Any]], R] | None] = {}
        self._shared, self._own = functools.lru_cache(PROGRAMS)(shared), functools.lru_cache(PROGRAMS)(own)

    def _program(self, response: Function, options: Options = ()) -> tuple[jax.stages.Wrapped, tuple[Record, ...]]:
        """The compiled function and its first arguments."""
        if isinstance(response, Record):
            return self._shared(options), (response,)
        return self._own(response, options), ()

    def __call__(self, response: Function, *arguments: object, **static: object) -> R:
        """The function's value; a static argument that is None counts as absent."""
        leaves, static = jax.tree.leaves((response, arguments)), _given(static)
        if inside(leaves):
            jitted, first = self._program(response)
            return jitted(*first, *arguments, **static)
        options = self._chosen(response, leaves)
        if isinstance(response, Record) and (folder := kept_folder()) is not None:
            kept = self._of_folder(folder, options, (response, *arguments), static)
            if kept is not None:
                return kept(leaves)
        jitted, first = self._program(response, options)
        return jitted(*first, *arguments, **static)

    def shapes(self, response: Function, *arguments: object, **static: object) -> R:
        """Shapes of the function's value; traced once for arguments of the same types."""
        program, first = self._program(response)
        jitted: Any = program
        found: R = jitted.eval_shape(*first, *arguments, **_given(static))
        return found

    def _chosen(self, response: Function, arguments: object) -> Options:
        """Options of the program; they are those of a processor."""
        return (*getattr(response, "compiler_options", ()), *self._options) if platform_of(arguments) == CPU else ()

    def _of_folder(
        self, folder: Path, options: Options, arguments: PyTree, static: dict[str, object]
    ) -> Callable[[list[Any]], R] | None:
        """A program of leaves that this or an earlier process has traced; None where none can be kept."""
        from rvjax._jax.exported import exported

        leaves, tree = jax.tree.flatten(arguments)
        # Not the types that JAX gives to a hundred Python numbers: hashing these took half of the time of a call.
        types = tuple(map(_type_of, leaves))
        key = (folder, platform_of(leaves), options, tree, types, tuple(sorted(static.items())))
        if key not in self._kept:
            self._kept[key] = exported(folder, self.__wrapped__, static, arguments, understood(options))  # type: ignore[attr-defined]
        return self._kept[key]

    def traced(self, response: Function, *arguments: object) -> jax.stages.Traced:
        """The program, traced."""
        jitted, first = self._program(response)
        return jitted.trace(*first, *arguments)


def _given(static: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in static.items() if value is not None}


UNITS = jax.sharding.PartitionSpec("units")
NUMBERS = jax.sharding.PartitionSpec(None, "units")
EVERYWHERE = jax.sharding.PartitionSpec()


def per_response(
    *, static: tuple[str, ...] = (), options: Options = (), shared: object = None
) -> Callable[[Callable[..., R]], Compiled[R]]:
    """Compile a function whose first argument is a response.

    Args:
        static: names of arguments given by keyword.
        options: of XLA, with those of the response.
        shared: of a function of a response, a population and arrays (numbers, units): where the units are in its
            results, `UNITS` or `NUMBERS`. The devices of its further argument `mesh` share the units.
    """
    if shared is None:
        return lambda function: Compiled(function, static, options)
    return lambda function: Compiled(_shared_out(function, shared), (*static, "mesh"), options)


def _shared_out(function: Callable[..., R], out: object) -> Callable[..., R]:
    @functools.wraps(function)
    def call(
        response: Response,
        population: Population,
        *rows: jax.Array,
        mesh: jax.sharding.Mesh | None = None,
        **static: object,
    ) -> R:
        if mesh is None:
            return function(response, population, *rows, **static)
        if isinstance(response, Record):  # its numbers go in like those of the population; a plain function is none
            given: Any = response, population
            part: Any = lambda both, *rows: function(*both, *rows, **static)  # noqa: E731
        else:
            given, part = population, functools.partial(function, response, **static)
        specs = (EVERYWHERE, *(NUMBERS for _ in rows))
        return jax.shard_map(part, mesh=mesh, in_specs=specs, out_specs=out, check_vma=False)(given, *rows)

    del call.__wrapped__  # JAX would read the arguments of that function
    return call


@record
class Outcome(Record):
    """A response with the reason of its failure.

    A unit fails if any status is no success (the first by `rvjax.status.PRECEDENCE` counts) or any
    value is nan, which counts as NONFINITE. An infinite value is one, such as a life without load; statistics count it
    as a success if the only limit is on the other side, else as NONFINITE.
    """

    value: PyTree = field("-", "scalar, or dict or record of scalars", kind="record")
    status: Array = field("-", "`Status` values, any shape (angles, discs)", kind="integer")
    curve: Array | None = field("as the outputs", "numbers along a span that they read", shape=("n",), default=None)


def evaluate(response: Response, errors: object) -> tuple[Values, jax.Array]:
    """Values by name and the status of one unit.

    Raises:
        ValueError: a value that is not one number.
    """
    call: Callable[..., PyTree] = response
    result = call(*errors) if isinstance(errors, Given) else call(errors)
    status, curve = jnp.int32(int(Status.CONVERGED)), None
    if isinstance(result, Outcome):
        curve = result.curve
        status, result = worst(jnp.asarray(result.status)).astype(jnp.int32), result.value
    values = {}
    for name, value in _named(result).items():
        number = jnp.asarray(value)
        if number.shape or not jnp.issubdtype(number.dtype, jnp.number):
            shown = f"response[{name!r}]" if name else "response"
            raise ValueError(f"{shown}: must be one real number per unit, got shape {number.shape} {number.dtype}")
        values[name] = number.astype(jnp.result_type(float, number))
    lost = jnp.any(jnp.stack([jnp.isnan(number) for number in values.values()]))
    if curve is not None:
        values[CURVE] = curve
    return values, jnp.where(succeeded(status) & lost, jnp.int32(int(Status.NONFINITE)), status)


def _named(result: object) -> dict[str, PyTree]:
    if isinstance(result, Record):
        result = {path[-1].name: leaf for path, leaf in jax.tree_util.tree_flatten_with_path(result)[0]}
    if not isinstance(result, Mapping):
        return {PLAIN: result}
    if not result:
        raise ValueError("response: returned no value")
    return dict(result)


def is_costly(response: object) -> bool:
    """True if a unit of a response, or of a study, is so expensive that only the units that decide are solved."""
    return bool(getattr(response, "costly", False))


def unwrapped(result: object) -> PyTree:
    """Result with dicts by name of the response, with plain values where it is a plain scalar."""
    if dataclasses.is_dataclass(result) and not isinstance(result, (type, Record)):
        fields = {f.name: unwrapped(getattr(result, f.name)) for f in dataclasses.fields(result)}
        return dataclasses.replace(result, **fields)
    if not isinstance(result, dict):
        return result
    if set(result) == {PLAIN}:
        return result[PLAIN]
    by_number = all(isinstance(key, float) for key in result)  # quantiles: {p: {name: ...}}
    return {key: unwrapped(item) for key, item in result.items()} if by_number else result


def by_name(kind: type, found: Mapping[str, Mapping[str, object]]) -> PyTree:
    """A result of this kind, every field a dict by name, from what was found of each response; unwrapped."""
    columns = {f.name: {n: each[f.name] for n, each in found.items()} for f in dataclasses.fields(kind)}
    return unwrapped(kind(**columns))


def by_response(given: object, names: tuple[str, ...], kind: type, argument: str) -> dict[str, PyTree]:
    """Requirements (one, a dict, or None) as a dict by response; a ValueError names another type or an unknown name."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        if names != (PLAIN,):
            raise ValueError(f"{argument}: the response has the names {', '.join(names)}; give a dict of them")
        given = {PLAIN: given}
    for name, item in given.items():
        if name not in names:
            have = ", ".join(names) if names != (PLAIN,) else "only one scalar; give its value itself"
            near = meant(name, names)
            raise UnknownWord(f"{argument}: {name!r} is no name of the response{near}; it has {have}")
        if item is not None and not isinstance(item, kind):
            raise ValueError(f"{argument}[{name!r}] = {item!r}: must be a {kind.__name__}")
    return {name: item for name, item in given.items() if item is not None}


@per_response(shared=UNITS)
def respond(response: Response, population: Population, z: jax.Array) -> tuple[Values, jax.Array]:
    """Values (n,) by name and status (n,) of the units whose random numbers are z (numbers, n)."""
    one: Callable[[Any], Any] = lambda active: evaluate(response, population.fill(active))  # noqa: E731
    return jax.vmap(one, in_axes=-1, axis_size=z.shape[-1])(population.deviations(z))


def respond_units(
    response: Response, population: Population, key: jax.Array, start: int, *, count: int
) -> tuple[Values, jax.Array]:
    """Values and status of units start .. start + count - 1; one compilation for any start.

    Sampling is a separate program, so that the response is compiled once for each number of units.
    """
    return respond(response, population, drawn(population, key, np.uint32(start), count=count))


def numbers_of(population: Population, key: jax.Array, units: np.ndarray) -> np.ndarray:
    """Random numbers (numbers, n) of any units, by the program that draws `BLOCK` of them."""
    blocks, place = np.unique(np.asarray(units) // BLOCK, return_inverse=True)
    rows = [np.asarray(drawn(population, key, np.uint32(BLOCK * block), count=BLOCK)) for block in blocks]
    return np.stack(rows, axis=1)[:, place, np.asarray(units) % BLOCK]


def response_names(response: Response, population: Population) -> tuple[str, ...]:
    """Names of the response's values, found without computing any: a record with `outputs` lists them.

    Any other response is traced for the default number of units, because JAX then need not trace it again.
    """
    if isinstance(response, Record) and hasattr(response, "outputs"):
        return tuple(sorted(response.outputs))  # as JAX sorts the keys of a dict
    z = jax.ShapeDtypeStruct((population.numbers, BLOCK), jnp.result_type(float))
    return tuple(respond.shapes(response, population, z)[0])


_chosen: list[jax.Device] = []  # by `units_on`


@contextlib.contextmanager
def units_on(devices: Sequence[jax.Device]) -> Iterator[None]:
    """A context within which units are computed on these devices; everything else stays where it is.

    Args:
        devices: of one platform; none: the default ones.
    """
    before = list(_chosen)
    _chosen[:] = devices
    try:
        yield
    finally:
        _chosen[:] = before


def units_devices() -> list[jax.Device]:
    """Devices that compute units: those of `units_on`, else all local ones of the default platform."""
    return list(_chosen) or jax.local_devices(backend=default_platform())


def mesh_of(units: int) -> jax.sharding.Mesh | None:
    """All devices of units, where they can share so many evenly; None for one alone."""
    devices = units_devices()
    return jax.sharding.Mesh(np.array(devices), ("units",)) if len(devices) > 1 and units % len(devices) == 0 else None


def on(mesh: jax.sharding.Mesh | None, rows: jax.Array) -> jax.Array:
    """Rows (numbers, units) shared out, as a kept program takes them; without a mesh on the device of `units_on`."""
    if mesh is not None:
        return jax.device_put(rows, jax.sharding.NamedSharding(mesh, NUMBERS))
    return jax.device_put(rows, _chosen[0]) if _chosen else rows
