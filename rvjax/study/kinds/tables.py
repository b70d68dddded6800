"""Tables of an embedded study with other values, line by line: comments and order stay."""

import re
from collections.abc import Callable, Mapping

from rvjax.geometry import figures
from rvjax.records import PyTree
from rvjax.study.kinds.kind import Assumed, Choices
from rvjax.study.kinds.scaling import number_at
from rvjax.study.values import in_unit

VALUE = re.compile(
    r'(?P<key>\w+)(?P<gap> *= *)"(?P<word>diametral )?(?P<number>-?[\d.]+) (?P<unit>[^"]+)"(?: *# *(?P<note>.*))?'
)
"""A line with a value and its unit."""


def rewritten(text: str, change: Callable[[tuple[str, ...], re.Match[str]], str]) -> str:
    """Text of tables with other values.

    Args:
        text: of the tables.
        change: (names of the table and the key, match of `VALUE`) -> the line.
    """
    table, made = tuple[str, ...](), []
    for line in text.splitlines():
        if header := re.match(r"\[+([\w.]+)\]+", line):
            table = tuple(header[1].split("."))
        elif match := VALUE.fullmatch(line):
            line = change((*table, match["key"]), match)
        made.append(line)
    return "\n".join(made) + "\n"


def stated(match: re.Match[str], value: str, *notes: str | None) -> str:
    """The line with another value.

    Args:
        match: of the line.
        value: with its unit.
        *notes: of its comment.
    """
    comment = "; ".join(filter(None, notes))
    line = f'{match["key"]}{match["gap"]}"{match["word"] or ""}{value}"'
    return f"{line} # {comment}" if comment else line


def scaled_line(path: tuple[str, ...], match: re.Match[str], ratios: Mapping[str, tuple[float, str]]) -> str:
    """The line with its length in um times the ratio of its error; unchanged where there is none.

    Args:
        path: names of the table and the key.
        match: of the line.
        ratios: (ratio, note) by error, or by "error.key".
    """
    number, names = float(match["number"]), (".".join(path[1:3]), path[1] if len(path) > 2 else "")
    ratio, note = next((ratios[name] for name in names if name in ratios), (1.0, ""))
    if match["unit"] != "um" or ratio == 1 or not number:
        return match[0]
    return stated(match, f"{number * ratio:.6g} um", match["note"], note)


def with_torque(path: tuple[str, ...], match: re.Match[str], torque: Assumed | None, note: str | None = None) -> str:
    """The line with the rated torque of this reducer; unchanged where none is known.

    Args:
        path: names of the table and the key.
        match: of the line.
        torque: rated torque, N m.
        note: of its comment; None: as it is.
    """
    if torque is None or not path[-1].endswith(("output_torque", "rated_torque")):
        return match[0]
    return stated(match, in_unit(torque.value, "N m"), match["note"] if note is None else note)


def variable_tables(choices: Choices, design: PyTree) -> tuple[str, str]:
    """Tables of the numbers that `rvjax design` may choose, with their prices; limits of the unit without errors.

    Args:
        choices: of the kind of reducer.
        design: at the start.
    """
    tables = ["# Numbers of the design that may change; bounds and prices are assumed", ""]
    for path, shares in choices.bounds.items():
        if number := float(number_at(design, path)):  # 0 has no bounds in proportion
            lower, upper = (in_unit(end, "m") for end in sorted(share * number for share in shares))
            tables += [f'[variable."{path}"]', f'lower = "{lower}"', f'upper = "{upper}"']
            if price := choices.prices.get(path):
                tables += [f'cost = {{price = {price:g}, per = "{in_unit(number, "m")}"}}']
            tables += [""]
    limits = list[str]()
    found: PyTree = figures(design) if choices.volume or choices.limits else None
    if choices.volume:
        volume = in_unit(float(found.envelope_volume), "m3", 2)
        tables += ["[objective] # price of the space, in the unit of the costs"]
        tables += [f'envelope_volume = {{price = {choices.volume:g}, per = "{volume}"}}', ""]
        limits += ["# Limits of the unit without errors, assumed from its values at the start", ""]
    for name, share in choices.limits.items():
        value = in_unit(share * float(getattr(found, name)), "m", 3)
        limits += [f"[requirement.{name}]", f'nominal_{"lower" if share < 1 else "upper"} = "{value}"', ""]
    return "\n".join(tables), "\n".join(limits)
