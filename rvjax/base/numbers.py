"""Numbers in the cells of a table: decimal points or commas, separators of thousands, missing readings."""

import math
import re
from collections.abc import Sequence
from decimal import Decimal

import numpy as np

from rvjax.units import with_unit

LARGEST, SMALLEST = 1e12, 1e-100  # in any unit: beyond every size of a part, below every rounding error of a zero
_GROUPS = {
    mark: rf"[-+]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?:{re.escape(point)}\d*)?" for mark, point in (",.", ".,")
}
"""{mark: number with this mark between thousands}"""


def _is_proof(text: str, mark: str) -> bool:
    """Return True if a mark can only separate thousands: it occurs twice, or before the other mark."""
    other = "." if mark == "," else ","
    return re.fullmatch(_GROUPS[mark], text) is not None and (text.count(mark) > 1 or other in text)


def has_decimal_comma(text: str) -> bool:
    """Return True if the comma of a number cannot separate thousands, as in "0,5"."""
    return re.fullmatch(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?", text) is not None and not re.fullmatch(_GROUPS[","], text)


def grouping_of(source: str, cells: Sequence[str]) -> str:
    """The mark that certainly separates thousands in some cell of a file, "" for none.

    Args:
        source: name of the file, for the message.
        cells: with numbers.

    Raises:
        ValueError: the same mark is a decimal mark elsewhere.
    """
    proofs = {mark for cell in cells if "," in cell or cell.count(".") > 1 for mark in _GROUPS if _is_proof(cell, mark)}
    for mark in sorted(proofs):
        alone = [cell for cell in cells if mark in cell and not re.fullmatch(_GROUPS[mark], cell)]
        if alone or len(proofs) > 1:
            said = f"{(alone or [cell for cell in cells if _is_proof(cell, mark)])[0][:40]!r}"
            raise ValueError(f"{source}: {said}: {mark!r} separates thousands in one cell, decimals in another")
    return next(iter(proofs), "")


def number_of(
    source: str, name: str, unit: str, row: int, cell: str, comma: bool, *, missing: bool = True, grouping: str = ""
) -> float:
    """Return the number in a cell, in the unit of the cell; NaN for an empty one.

    Args:
        source: name of the file, for the message.
        name: of the quantity.
        unit: of the cell.
        row: line of the file.
        cell: text.
        comma: whether decimals may have a comma.
        missing: "nan" is a missing reading too, as an empty cell is.
        grouping: mark that separates thousands in this file.

    Raises:
        ValueError: no number, not finite, or larger or smaller than any number of a part.
    """
    text = cell.lower() if cell.isascii() and not ("," in cell or grouping) else _usual(cell, comma, grouping)
    if text == "" or (missing and text == "nan"):
        return math.nan
    where = f"{source}: row {row}, {name} = {cell[:40]!r}"
    try:
        value = float(text)
    except ValueError:
        try:
            value = float(text := _usual(cell, comma, grouping))
        except ValueError:
            hint = "; is its comma decimal? write a point, or no separator" if re.fullmatch(_GROUPS[","], text) else ""
            hint = "; save the values, not the formulas" if text.startswith("=") else hint
            raise ValueError(f"{where}: must be a number in {unit}{hint}") from None
    digits = re.search("[1-9]", text.partition("e")[0])
    if math.isnan(value) or (math.isinf(value) and not digits):
        raise ValueError(f"{where}: must be finite, in {unit}; leave the cell empty if nothing was measured")
    if abs(value) > LARGEST:
        raise ValueError(f"{where}: too large, must be at most {with_unit(LARGEST, unit, 'g')}; correct the number")
    if digits and abs(value) < SMALLEST:  # also one that is 0 in double precision
        least = with_unit(SMALLEST, unit, "g")
        raise ValueError(f"{where}: too small, must be 0 or at least {least}; correct the number")
    return value


def last_digit(cells: Sequence[str], comma: bool, grouping: str = "") -> float:
    """Return one unit of the last digit, in the unit of cells that `number_of` has read; inf without a number.

    Args:
        cells: texts.
        comma: whether decimals may have a comma.
        grouping: mark that separates thousands in this file.
    """
    parts = [text for cell in cells if (text := _usual(cell, comma, grouping)) not in ("", "nan")]
    tens = [Decimal(text).as_tuple().exponent for text in parts]
    return min((10.0**place for place in tens if isinstance(place, int)), default=math.inf)


def _usual(cell: str, comma: bool, grouping: str) -> str:
    """A number with a decimal point and without separators of thousands."""
    text = cell.lower().replace("\u2212", "-")  # the minus sign of a typesetter
    text = re.sub(r"(?<=\d)['’\u00a0\u2009\u202f ](?=\d{3}(?!\d))", "", text)
    mark = grouping or next((own for own in _GROUPS if _is_proof(text, own)), "")
    if mark and re.fullmatch(_GROUPS[mark], text):
        text = text.replace(mark, "").replace(",", ".")
    return text.replace(",", ".") if comma else text


def svd(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left vectors, singular values and right vectors of a matrix.

    The fast driver of LAPACK fails for some matrices whose singular values are equal, such as orders over whole turns;
    the other one is slower and always converges.

    Args:
        matrix: (n, p).
    """
    try:
        left, size, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        from scipy import linalg

        left, size, right = linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return left, size, right
