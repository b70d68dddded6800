"""`rvjax init`: a commented study file to change."""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, replace
from pathlib import Path

import numpy as np

from rvjax import catalogue
from rvjax.base.files import check_writable
from rvjax.commands import Inputs, argument, option, switch
from rvjax.records import PyTree
from rvjax.render import Report
from rvjax.study import (
    BASES,
    EMBEDDED,
    KINDS,
    Assumed,
    Kind,
    Known,
    Metadata,
    Start,
    StudyError,
    choice,
    comments,
    fields_of_kind,
    given_numbers,
    given_paths,
    in_unit,
    is_replaced,
    kind_of,
    load,
    naming,
    parse_study,
    quantity,
    subtable,
    variable_tables,
    walk,
)


@dataclass(kw_only=True)
class InitInputs(Inputs):
    """Write a study of the loaded reducer with all values of a known reducer, or of your drawing, each with unit and
    meaning. Values without a source come from the nearest known reducer by scaling laws and are marked "assumed".
    Tolerances, costs and requirements follow the size. Existing files are never overwritten.

    examples:
      rvjax init mine.toml
      rvjax init mine.toml --base rv-80e
      rvjax init mine.toml --base drawing.toml
      rvjax init mine.toml --base cycloidal-17 --process wire-cut
      rvjax init mine.toml --base rv-80e --model four-bar
      rvjax init mine.toml --design

    A drawing is a TOML file with [design]: kind = "rv", involute.sun_teeth, involute.planet_teeth, involute.module,
    cycloid.disc_teeth, cycloid.pin_count, cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius,
    cranks.count; every other number of the design, and rated_torque in [conditions], may be given too.
    That of a drive has kind = "cycloidal", cycloid.disc_teeth, cycloid.eccentricity, cycloid.pin_circle_radius,
    cycloid.pin_radius, output.count, output.circle_radius, output.pin_radius.
    """

    file: str = argument("new file", "FILE.toml", ends=".toml")
    base: str = option(
        "reducer with the initial values: corr, rv-20e, rv-40e (default), rv-40e-whole, rv-80e, rv-320e, "
        "cycloidal-15, cycloidal-17, cycloidal-29, or the .toml file of a drawing",
        "REDUCER",
        default="rv-40e",
    )
    model: str = option(
        "loaded: every pin, bearing life and forces (default); four-bar: cranks and bores only",
        default="loaded",
        choices=["loaded", "four-bar"],
    )
    process: str = option(
        "of the parts of a drive: milled, wire-cut, printed, ground (default: the usual one of the drive)",
        "PROCESS",
        default="",
    )
    design: bool = switch(
        "a study for rvjax design: numbers of the design with bounds, prices and limits; of rv-40e the four-bar model"
    )

    def __post_init__(self) -> None:
        """Check that the file can be written."""
        if Path(self.file).exists():
            raise ValueError(f"{self.file}: exists already; name a new file")
        check_writable(Path(self.file))


ABOUT = """[about] # for the head of reports; every line may go
revision = "A"
# title = "..."
# author = "..."

"""


@dataclass(frozen=True)
class Written:
    """A new study.

    Attributes:
        text: of the file.
        model: "loaded" or "four-bar", "" for another kind of reducer.
        of: name of the reducer, or of the file of its drawing.
        warnings: assumed numbers outside the interval of their scaling law, and tables not taken over, a line each.
    """

    text: str
    model: str
    of: str
    warnings: tuple[str, ...] = ()


def compute(inputs: InitInputs) -> Written:
    """Text of the new study."""
    if inputs.design and inputs.base == "rv-40e" and not inputs.process:
        return Written(with_variables(), "four-bar", inputs.base)
    return written(inputs.base, inputs.model, inputs.process, variables=inputs.design)


def with_variables() -> str:
    """Write the text of a study for `rvjax design`, with comments."""
    text = (EMBEDDED / "rv-40e-design-four-bar.toml").read_text("utf-8")
    head = (
        "# A study to change, with the numbers of an RV-40E: replace them by those of your drawing, then run\n"
        "# rvjax design on this file. Tolerances, costs, prices, limits, stiffnesses and masses are assumed.\n\n"
    )
    return head + ABOUT + text[text.index("[design]") :]


def written(base: str, model: str = "loaded", process: str = "", *, variables: bool = False) -> Written:
    """Write a study of a reducer, with all its values.

    Args:
        base: a known reducer, or a TOML file with the table [design].
        model: "loaded" or "four-bar"; an oscillatory roller reducer has a single one.
        process: that makes the parts; "" for the usual one.
        variables: also tables of the numbers that `rvjax design` may choose.

    Raises:
        ValueError: an unknown name, variables of another four-bar model than that of rv-40e, a process that such a
            reducer has not, or a file that gives no reducer.
    """
    given = known(base, process)
    starts = given.kind.starts
    model = model if model in starts else next(iter(starts))
    start = starts[model]
    own, more = start.complete(given, load(start.study, solve=False).design)
    given = replace(given, numbers=own)
    text = (EMBEDDED / f"{start.study}.toml").read_text("utf-8")
    numbers = {**own, **{path: item.value for path, item in more.items()}}
    rest = start.tables(text[text.index("[conditions]") :], numbers, given)
    made = _joined(given, more, start, rest)
    if variables:
        if start.choices is None:
            raise ValueError(
                f"--design --model {model}: needs --base rv-40e; other studies with variables are of the loaded reducer"
            )
        choices, limits = variable_tables(start.choices, parse_study(made, name=given.name, solve=False).design)
        made = made.replace("[conditions]", f"{choices}\n[conditions]", 1).replace("[run]", f"{limits}\n[run]", 1)
    return Written(made, model, given.name, _warnings(given, more))


def _joined(given: Known, more: Mapping[str, Assumed], start: Start, rest: str) -> str:
    """Text of the study; of a reducer whose published values contradict each other by its name."""
    named = f'kind = "{given.kind.word}"\n' + "\n".join(lines(given, more, start.parts))
    head = start.head.format(name=given.name) + ABOUT + "[design]\n"
    try:
        made = parse_study(head + named + "\n\n" + rest, name=given.name, solve=False)
        if given.drawing and (sharp := catalogue.undercut(made.design)):
            raise StudyError(f"{given.name}: design.{sharp[0]}")
    except StudyError as contradiction:  # published so: possible by name alone
        if given.drawing:
            raise
        own = "\n".join(lines(given, more, start.parts, only=True)).lstrip("\n")
        named = f'base = "{given.name}" # its published values contradict each other: {contradiction}\n'
        named += start.unread(given.numbers) + own
    return head + named + "\n\n" + rest


def _warnings(given: Known, more: Mapping[str, Assumed]) -> tuple[str, ...]:
    far = dict.fromkeys(line for item in (*more.values(), given.torque) if item is not None for line in item.outside)
    unread = (
        [f"{given.name}: not taken over: {', '.join(f'[{name}]' for name in given.unread)}"] if given.unread else []
    )
    return (*far, *unread)


FILE_PARTS = {"design", "conditions", "about"}


def known(base: str, process: str = "") -> Known:
    """A known reducer by its name, or the reducer of a drawing.

    Args:
        base: name, or path of a TOML file with a table [design].
        process: that makes the parts; "" for the usual one.

    Raises:
        ValueError: an unknown name, a wrong value, or a number that is missing; one line.
    """
    if base.endswith(".toml"):
        found = _drawn(Path(base))
    else:
        design: PyTree = BASES[choice(base, BASES, "--base")]
        numbers = {path: value for path, value, _ in walk(design)}
        found = Known(base, base, kind_of(design), numbers, dict.fromkeys(catalogue.assumed(base), "assumed"), None)
    if process and not found.kind.processes:
        raise ValueError(f"--process {process}: tolerances of {found.kind.name} follow its size alone")
    found = replace(found, process=process and choice(process, found.kind.processes, "--process"))
    return found if found.torque else replace(found, torque=found.kind.torque(found))


def _drawn(path: Path) -> Known:
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"--base {path}: cannot be read ({error})") from None
    with naming(str(path)):
        try:
            tables = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ValueError(f"not valid TOML: {error}") from None
        table = subtable(tables, "design")
        drawn = {kind.word: kind for kind in KINDS.values() if kind.needed}
        if not table:
            words = " or ".join(f'"{name}"' for name in drawn)
            raise ValueError(f"[design] is missing or empty: a drawing has kind = {words} and its numbers")
        if (base := table.get("base")) is None:
            kind = drawn[choice(table.get("kind"), drawn, "design.kind")]
        else:
            bases = {name: kind for kind in drawn.values() for name in kind.bases}
            kind = bases[choice(base, bases, "design.base")]
        numbers = given_numbers(table)
        if missing := _lacking(kind, numbers):
            raise ValueError(f"[design] lacks {'; '.join(missing)}")
        said = dict.fromkeys(catalogue.assumed(str(base)), "assumed") if base else {}
        about = {path: each for path, each, _ in fields_of_kind(kind.design, given=numbers)}
        notes = {path: note for path, note in comments(text).items() if path in numbers}
        said |= {path: "" if is_replaced(numbers[path], about[path], note) else note for path, note in notes.items()}
        torque, unread = _torque(subtable(tables, "conditions")), tuple(sorted(set(tables) - FILE_PARTS))
        for name, value in numbers.items():
            if about[name].get("sign") == "positive" and np.any(np.asarray(value) <= 0):
                raise ValueError(
                    f"design.{name} = {in_unit(float(np.min(value)), about[name]['unit'])}: must be positive"
                )
        return Known(
            str(path), str(base or ""), kind, numbers, said, torque, True, unread, stated=frozenset(given_paths(table))
        )


def _lacking(kind: Kind, numbers: Mapping[str, object]) -> list[str]:
    """Numbers that a drawing must have and that these lack, with their meaning, a line each."""
    about, needed = dict[str, Metadata](), [*kind.needed]
    for path, about[path], default in fields_of_kind(kind.design, given=numbers):
        if default is MISSING and f"{path.rpartition('.')[0]}.balls" in numbers:
            needed.append(path)  # no known reducer has balls
    units = {path: "" if about[path]["unit"] == "-" else f", in {about[path]['unit']}" for path in needed}
    return [f"{path} ({about[path]['meaning']}{units[path]})" for path in needed if path not in numbers]


def _torque(conditions: Mapping[str, object]) -> Assumed | None:
    for key in ("rated_torque", "output_torque"):
        if key in conditions:
            value = quantity(conditions[key], "N m", f"conditions.{key}")
            if value <= 0:
                raise ValueError(f"conditions.{key} = {conditions[key]!r}: must be positive")
            return Assumed(value, "as in the drawing")
    return None


def lines(given: Known, more: Mapping[str, Assumed], parts: Collection[str], *, only: bool = False) -> Iterator[str]:
    """`key = value # meaning` of every number, with an empty line between parts.

    Args:
        given: numbers with a source.
        more: assumed numbers.
        parts: that are written.
        only: only parts with assumed numbers, as changes of a base.
    """
    numbers = {**given.numbers, **{path: item.value for path, item in more.items()}}
    implied, last, changed = given.kind.implied(numbers), "", {path.rpartition(".")[0] for path in more}
    for path, about, _ in fields_of_kind(given.kind.design, given=numbers):
        part = path.rpartition(".")[0]
        if (path.split(".")[0] not in parts and part) or path not in numbers or numbers[path] is None:
            continue
        if (only and part not in changed) or path in implied:
            continue
        if part != last:
            last = part
            yield ""
        item = more.get(path)
        meaning = str(about["meaning"])
        reason = item.why if item is not None else given.said.get(path, "").removeprefix(meaning).removeprefix("; ")
        value = _text(numbers[path], about, exact=item is None)
        alone = np.ndim(numbers[path]) == 0 and reason.startswith("assumed") and "initially" not in reason
        initially = "initially " + value.strip('"') if alone else ""
        yield f"{path} = {value} # {'; '.join(filter(None, [meaning, reason, initially]))}"


def _text(value: PyTree, about: Metadata, *, exact: bool) -> str:
    if about["kind"] == "count":
        return str(value)
    if about["kind"] == "text":
        return f'"{value}"'
    if np.ndim(value):
        return f"[{', '.join(_text(float(item), about, exact=exact) for item in value)}]"
    if about["unit"] == "-":
        return str(value)
    return f'"{in_unit(float(value), about["unit"], 12 if exact else 4)}"'


def report(inputs: InitInputs, found: Written) -> Report:
    """The report on a new study.

    Args:
        inputs: inputs of the command.
        found: the study.
    """
    file, base = inputs.file, inputs.base
    return Report(
        title=file,
        content=(),
        data={"study": file, "base": base, "model": found.model, "warnings": found.warnings},
        exports={Path(file): found.text.encode("utf-8")},
        closing=(
            *(f"warning: {line}" for line in found.warnings),
            f"{file}: a study of the {found.of} to change. Next: rvjax check {file}",
        ),
    )
