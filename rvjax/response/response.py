"""A response is a pure function of the errors of one unit; here it meets a batch of units.

It returns a scalar, a dict or record of scalars, or an `Outcome` that names why a unit failed. Inside this
package its values are always a dict; a plain scalar is wrapped in `evaluate` and unwrapped in `unwrapped`.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._ground.choices import UnknownWord, meant
from rvjax._ground.progress import compiling
from rvjax._jax.blocks import BLOCK as BLOCK, CPU, platform_of, spread
from rvjax._jax.callbacks import called_back
from rvjax._jax.compile_cache import Options, inside, kept_folder, understood
from rvjax.population import Given, Population, drawn
from rvjax.records import Array, PyTree, Record, field, record
from rvjax.status import Status, succeeded, worst

if TYPE_CHECKING:
    from rvjax._jax.exported import Kept

PLAIN = ""
"""Name of the value of a response that returns one scalar."""

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


@dataclasses.dataclass
class _Program:
    """A program that the command line keeps, None where none can be kept, and its compilation in another thread."""

    kept: "Kept | None"
    begun: Future[Any] | None = None


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
    those of its programs, but within another program. The command line keeps the traced programs of records, and
    `begin` compiles them in other threads while the next ones are traced.
    """

    _threads = ThreadPoolExecutor(2, "compile")  # 88.8 -> 83.5 s of the loaded study with one more

    def __init__(self, function: Callable[..., R], static: tuple[str, ...] = (), options: Options = ()) -> None:
        functools.update_wrapper(self, function)
        self._options = options

        def shared(options: Options) -> jax.stages.Wrapped:
            return jax.jit(function, static_argnames=static, compiler_options=understood(options))

        def own(response: Function, options: Options) -> jax.stages.Wrapped:
            whole = functools.partial(function, response)
            return jax.jit(whole, static_argnames=static, compiler_options=understood(options))

        self._flat: dict[Any, _Program] = {}
        self._shared, self._own = functools.lru_cache(PROGRAMS)(shared), functools.lru_cache(PROGRAMS)(own)

    def _program(self, response: Function, options: Options = ()) -> tuple[jax.stages.Wrapped, tuple[Record, ...]]:
        """The compiled function and its first arguments."""
        if isinstance(response, Record):
            return self._shared(options), (response,)
        return self._own(response, options), ()

    def __call__(self, response: Function, *arguments: object, **static: object) -> R:
        """The function's value."""
        leaves = jax.tree.leaves((response, arguments))
        if inside(leaves):
            jitted, first = self._program(response)
            return jitted(*first, *arguments, **static)
        options = self._chosen(response, leaves)
        if isinstance(response, Record) and (folder := kept_folder()) is not None:
            return self._kept(folder, options, (response, *arguments), static)
        jitted, first = self._program(response, options)
        return jitted(*first, *arguments, **static)

    def begin(self, response: Function, *arguments: object, **static: object) -> R | None:
        """Trace the program of such arguments and compile it while the caller goes on; later calls wait for it.

        Only where the command line keeps programs. An error is raised by the call that waits.

        Args:
            response: as in the call.
            arguments: likewise; their values do not count, and the program computes them once.
            static: likewise.

        Returns:
            Shapes of the value; None where nothing was begun.
        """
        options = self._chosen(response, arguments)
        if not isinstance(response, Record) or (folder := kept_folder()) is None:
            return None
        program, leaves = self._traced(folder, options, (response, *arguments), static)
        kept = program.kept
        if kept is None:
            return None
        if program.begun is None:
            program.begun = self._threads.submit(lambda: jax.block_until_ready(kept.call(*kept.given(leaves))))
            compiling(program.begun)
        return kept.put_together(jax.eval_shape(kept.call, *kept.given(leaves)))

    def shapes(self, response: Function, *arguments: object, **static: object) -> R:
        """Shapes of the function's value; traced once for arguments of the same types."""
        program, first = self._program(response)
        jitted: Any = program
        found: R = jitted.eval_shape(*first, *arguments, **static)
        return found

    def _chosen(self, response: Function, arguments: object) -> Options:
        """Options of the program; they are those of a processor."""
        return (*getattr(response, "compiler_options", ()), *self._options) if platform_of(arguments) == CPU else ()

    def _kept(self, folder: Path, options: Options, arguments: PyTree, static: dict[str, object]) -> R:
        """The function's value, by a program that this or an earlier process has traced."""
        program, leaves = self._traced(folder, options, arguments, static)
        kept = program.kept
        if kept is None:
            return self._shared(options)(*arguments, **static)
        if program.begun is not None:
            program.begun.result()
        return kept.put_together(kept.call(*kept.given(leaves)))

    def _traced(
        self, folder: Path, options: Options, arguments: PyTree, static: dict[str, object]
    ) -> "tuple[_Program, list[Any]]":
        """A program and its leaves."""
        from rvjax._jax.exported import exported

        leaves, tree = jax.tree.flatten(arguments)
        # Not the types that JAX gives to a hundred Python numbers: hashing these took half of the time of a call.
        types = tuple(map(_type_of, leaves))
        key = (folder, platform_of(leaves), options, tree, types, tuple(sorted(static.items())))
        known = self._flat.get(key)
        if known is None:
            found = exported(folder, self.__wrapped__, static, arguments)  # type: ignore[attr-defined]
            found = found and found._replace(call=jax.jit(found.call, compiler_options=understood(options)))
            known = self._flat[key] = _Program(found)
        return known, leaves

    def lowered(self, response: Function, *arguments: object, **static: object) -> str:
        """Text of the program, and of the Python functions that it calls back."""
        jitted, first = self._program(response)
        traced = jitted.trace(*first, *arguments, **static)
        return str(traced.lower().as_text()) + called_back(traced.jaxpr)


def per_response(*, static: tuple[str, ...] = (), options: Options = ()) -> Callable[[Callable[..., R]], Compiled[R]]:
    """Compile a function whose first argument is a response.

    Args:
        static: names of arguments given by keyword.
        options: of XLA, with those of the response.
    """
    return lambda function: Compiled(function, static, options)


@record
class Outcome(Record):
    """A response with the reason of its failure.

    A unit fails if any status is no success (the first by `rvjax.status.PRECEDENCE` counts) or any
    value is nan, which counts as NONFINITE. An infinite value is one, such as a life without load; statistics count it
    as a success if the only limit is on the other side, else as NONFINITE.
    """

    value: PyTree = field("-", "scalar, or dict or record of scalars", kind="record")
    status: Array = field("-", "`Status` values, any shape (angles, discs)", kind="integer")


def evaluate(response: Response, errors: object) -> tuple[Values, jax.Array]:
    """Values by name and the status of one unit.

    Raises:
        ValueError: a value that is not one number.
    """
    call: Callable[..., PyTree] = response
    result = call(*errors) if isinstance(errors, Given) else call(errors)
    status = jnp.int32(int(Status.CONVERGED))
    if isinstance(result, Outcome):
        status, result = worst(jnp.asarray(result.status)).astype(jnp.int32), result.value
    values = {}
    for name, value in _named(result).items():
        number = jnp.asarray(value)
        if number.shape or not jnp.issubdtype(number.dtype, jnp.number):
            shown = f"response[{name!r}]" if name else "response"
            raise ValueError(f"{shown}: must be one real number per unit, got shape {number.shape} {number.dtype}")
        values[name] = number.astype(jnp.result_type(float, number))
    lost = jnp.any(jnp.stack([jnp.isnan(number) for number in values.values()]))
    return values, jnp.where(succeeded(status) & lost, jnp.int32(int(Status.NONFINITE)), status)


def _named(result: object) -> dict[str, PyTree]:
    if isinstance(result, Record):
        result = {path[-1].name: leaf for path, leaf in jax.tree_util.tree_flatten_with_path(result)[0]}
    if not isinstance(result, Mapping):
        return {PLAIN: result}
    if not result:
        raise ValueError("response: returned no value")
    return dict(result)


def is_costly(response: Response) -> bool:
    """True if a unit is so expensive that only the units that decide are solved."""
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


def by_name(kind: type, found: Mapping[str, Mapping[str, PyTree]]) -> PyTree:
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


@per_response()
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
