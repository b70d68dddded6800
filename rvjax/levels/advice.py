"""The measured table as text, and for each model one sentence that says which level to use when."""

from rvjax.levels.table import SAFETY, Level, Model, Table
from rvjax.units import arcsec, readable

STEP = 5.0  # a level is mentioned if it is this many times as accurate as the last mentioned level


def report(table: Table) -> str:
    """Every level of every model, with the sentence below."""
    blocks = [_model(model) for model in table.models.values()]
    facts = ", ".join(f"{key} {value}" for key, value in table.machine.items() if value not in ("", []))
    return "\n\n".join([*blocks, f"Measured on {facts}; seed {table.seed}."])


def advice(model: Model) -> str:
    """Advise on levels, from the measured errors at the error size nearest 1 and times."""
    *mentioned, exact = worth_a_mention(model)
    if not mentioned:
        return f"Only {exact.name} ({_time(exact.ns)}) is of use: no cheaper level comes within its own size of it."
    parts = [f"for an error below {_error(model, level)} {level.name} ({_time(level.ns)})" for level in mentioned]
    return "Take " + "; ".join([*parts, f"for less {exact.name} ({_time(exact.ns)})"]) + "."


def worth_a_mention(model: Model) -> list[Level]:
    """Levels of the front, each several times as accurate as the one before, and the exact one."""
    mentioned: list[Level] = []
    exact = model.level(model.reference)
    for level in model.front():
        last = model.relative(mentioned[-1]) if mentioned else float("inf")
        if level is not exact and model.relative(level) < 1 and model.relative(level) * STEP <= last:
            mentioned.append(level)
    return [*mentioned, exact]


def _model(model: Model) -> str:
    first = next(iter(model.outputs))
    unit, unit_size = _shown(model.outputs[first])
    failed = f"; {model.failed[0]} of {model.failed[1]} cases without a reference excluded" if model.failed[0] else ""
    size = min(model.sizes, key=lambda s: abs(s - 1))
    lines = [
        f"{model.name}: {first} per {model.case}",
        f"error against {model.reference}, at {size:g} x the errors, relative to the rms of the output{failed}",
        f"{'level':44s} {'largest':>9s} {'rms':>9s} {unit:>10s} {'time':>9s} {'compile s':>10s} {'MB':>7s}",
    ]
    front = model.front()
    for level in sorted(model.levels, key=lambda level: level.ns):
        k = model.sizes.index(size)
        shown = level.largest[first][k] / unit_size
        lines.append(
            f"{'*' if level in front else ' '} {level.name:42s} {model.relative(level):9.2g} "
            f"{model.relative(level, 'rms'):9.2g} {shown:10.2g} {_time(level.ns):>9s} {level.compile_s:10.1f} "
            f"{level.memory_MB:7.1f}"
        )
    about = [f"{model.drawn} cases of each error size"] if model.drawn else []
    about += [f"on {model.machine['processor']}, {model.machine['cores']} cores"] if model.machine else []
    return "\n".join([*lines, advice(model), *([", ".join(about) + "."] if about else [])])


def _error(model: Model, level: Level) -> str:
    first = next(iter(model.outputs))
    bound = SAFETY * level.largest[first][min(range(len(model.sizes)), key=lambda k: abs(model.sizes[k] - 1))]
    unit, size = _shown(model.outputs[first])
    return f"{bound / size:.2g} {unit}"


def _shown(unit: str) -> tuple[str, float]:
    return ("arcsec", arcsec) if unit == "rad" else readable(unit)


def _time(ns: float) -> str:
    for limit, size, name in ((1e3, 1, "ns"), (1e6, 1e3, "us"), (1e9, 1e6, "ms")):
        if ns < limit:
            return f"{ns / size:.3g} {name}"
    return f"{ns / 1e9:.3g} s"
