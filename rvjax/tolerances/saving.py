"""Results as files: JSON for values, NPZ where there are many samples; both give back what was saved.

Every file carries the kind of result, the study it belongs to, its seed and the versions that made it.
Floats keep their bits.
"""

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np

from rvjax.base.files import DAMAGE, pack, unpack, versions, write_atomically
from rvjax.records import PyTree, Record
from rvjax.tolerances.batch.unit_file import parquet_frame, parquet_origin

_FORMAT = 2
_ABOUT = "about"

RESULTS: list[type] = []
"""Dataclasses that a file may hold in addition to records; the package lists its classes when it is imported."""


@dataclasses.dataclass(frozen=True)
class Origin:
    """Origin of a saved result.

    Attributes:
        kind: name of the result's class.
        seed: of its random numbers; None where there are none.
        study: its inputs.
        versions: of rvjax and JAX that made it.
    """

    kind: str
    seed: int | None
    study: PyTree
    versions: dict[str, str]


def save(result: object, path: str | Path, *, study: object = None, seed: int | None = None) -> None:
    """Write a result of this package to a file, whole or not at all.

    Args:
        result: `Statistics`, `Allocation`, `Moments`, `WorstCase` ...: any dataclass or record.
        path: ends with .json (everything as text) or .npz (arrays in binary form).
        study: inputs of the study, text or a dict of text; by default those of the result.
        seed: by default what the result itself carries.

    Raises:
        ValueError: another ending, or something in the result that no file can hold.
        OSError: it cannot be written; an older file stays as it was.
    """
    target, kind = Path(path), _ending(path)
    arrays: dict[str, np.ndarray] | None = {} if kind == ".npz" else None
    about = {
        "format": _FORMAT,
        "kind": type(result).__name__,
        "seed": getattr(result, "seed", None) if seed is None else seed,
        "study": getattr(result, "study", None) if study is None else study,
        "versions": getattr(result, "versions", None) or versions(),
    }
    text = json.dumps({"rvjax": about, "result": _encode(result, arrays)}, indent=1, allow_nan=False).encode()
    if arrays is not None:
        text = pack({**arrays, _ABOUT: np.frombuffer(text, np.uint8)})
    write_atomically(target, text)


def load(path: str | Path) -> PyTree:
    """The result that `save` wrote, with arrays as NumPy arrays; of the .parquet that `monte_carlo` wrote a DataFrame.

    The frame has a row for each unit, SI; its `attrs` hold units, seed and versions.

    Raises:
        ValueError: no file of `save`, damaged, or from a version that this one cannot read.
        ImportError: pandas or pyarrow is not installed, which .parquet needs.
    """
    if Path(path).suffix == ".parquet":
        return parquet_frame(Path(path))
    content, arrays = _read(path)
    try:
        return _decode(content["result"], arrays)
    except (KeyError, TypeError, AttributeError, IndexError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: damaged ({type(error).__name__}: {error})") from None


def origin(path: str | Path) -> Origin:
    """Read the origin of the result in a file.

    Raises:
        ValueError: as `load`.
    """
    about: PyTree = parquet_origin(Path(path)) if Path(path).suffix == ".parquet" else _read(path)[0]["rvjax"]
    return Origin(*(about.get(name) for name in ("kind", "seed", "study", "versions")))


def _ending(path: str | Path) -> str:
    ending = Path(path).suffix
    if ending not in (".json", ".npz"):
        raise ValueError(f"{path}: must end with .json or .npz (tables of units: monte_carlo(save=...))")
    return ending


def _read(path: str | Path) -> tuple[PyTree, dict[str, np.ndarray]]:
    arrays: dict[str, np.ndarray] = {}
    ending, raw = _ending(path), Path(path).read_bytes()
    try:
        if ending == ".npz":
            arrays = unpack(raw)
            raw = arrays.pop(_ABOUT).tobytes()
        content = json.loads(raw)
        written = content["rvjax"]["format"]
    except DAMAGE as error:
        raise ValueError(f"{path}: damaged, or no result of rvjax ({error})") from None
    if written != _FORMAT:
        raise ValueError(f"{path}: has format {written!r}, this version of rvjax reads {_FORMAT}")
    return content, arrays


def _encode(value: object, arrays: dict[str, np.ndarray] | None) -> object:
    """Encode as JSON values; other types are a dict with one key that begins with "$"."""
    again: Callable[[object], PyTree] = lambda item: _encode(item, arrays)  # noqa: E731
    if value is None or (isinstance(value, (str, bool, int)) and not isinstance(value, np.generic)):
        return value
    if isinstance(value, float) and not isinstance(value, np.generic):
        return value if math.isfinite(value) else {"$float": str(value)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: again(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"$": type(value).__name__, "fields": fields}
    if isinstance(value, dict):
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return {key: again(item) for key, item in value.items()}
        return {"$dict": [[again(key), again(item)] for key, item in value.items()]}
    if isinstance(value, list):
        return [again(item) for item in value]
    if isinstance(value, tuple):
        return {"$tuple": [again(item) for item in value]}
    if isinstance(value, (np.generic, np.ndarray, jax.Array)):
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise ValueError(f"save: an array of {array.dtype} fits no file")
        if arrays is not None:
            name = f"array_{len(arrays)}"
            arrays[name] = array
            return {"$array": name}
        numbers = [again(item) for item in array.ravel().tolist()]
        return {"$numbers": numbers, "shape": array.shape, "as": array.dtype.name}
    raise ValueError(f"save: {type(value).__name__} fits no file")


def _decode(value: object, arrays: dict[str, np.ndarray]) -> PyTree:
    again: Callable[[object], PyTree] = lambda item: _decode(item, arrays)  # noqa: E731
    if isinstance(value, list):
        return [again(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "$float" in value:
        return float(value["$float"])
    if "$tuple" in value:
        return tuple(again(item) for item in value["$tuple"])
    if "$dict" in value:
        return {again(key): again(item) for key, item in value["$dict"]}
    if "$array" in value:
        return arrays[value["$array"]]
    if "$numbers" in value:
        numbers = [again(item) for item in value["$numbers"]]
        return np.array(numbers, np.dtype(value["as"])).reshape(value["shape"])
    if "$" in value:
        return _rebuild(value["$"], {name: again(item) for name, item in value["fields"].items()})
    return {key: again(item) for key, item in value.items()}


def _rebuild(name: str, fields: dict[str, object]) -> object:
    known = {cls.__name__: cls for cls in _classes()}
    if name not in known:
        raise ValueError(f"load: this version of rvjax has no result {name!r}")
    cls = known[name]
    expected = {f.name for f in dataclasses.fields(cls)}
    if set(fields) != expected:
        different = ", ".join(sorted(set(fields) ^ expected))
        raise ValueError(f"load: {name} has other fields in this version of rvjax: {different}")
    made: object = object.__new__(cls)  # as it was saved: nothing is checked or filled in again
    for field, value in fields.items():
        object.__setattr__(made, field, value)
    return made


def _classes() -> Iterator[type]:
    yield from RESULTS
    waiting = [Record]
    while waiting:
        below = waiting.pop().__subclasses__()
        waiting += below
        yield from below
