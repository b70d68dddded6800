"""Features of the parts that errors belong to, from `features.toml`: how a deviation becomes a size of a drawing."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources


@dataclass(frozen=True)
class Feature:
    """Feature of a part that an error belongs to.

    Attributes:
        part: its name.
        feature: of one part.
        each: axis of equal parts, "" for one part.
        count: axes of equal features of one part.
        nominal: {path of a number of the design: its factor} whose sum is the nominal, m; empty if it is not known.
        factor: size over error, 2 for the radius of a diameter.
        form: "position", "runout" or "cumulative": form of a drawing for its zone; "" for limits.
        geometric: characteristic, "" for a size, or for that of the form.
        datum: of a geometric tolerance.
    """

    part: str
    feature: str
    each: str = ""
    count: tuple[str, ...] = ()
    nominal: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0
    form: str = ""
    geometric: str = ""
    datum: str = ""

    @property
    def size(self) -> frozenset[str]:
        """Numbers of the design, the same for all errors of one size."""
        return frozenset(self.nominal)


def features(*tables: str) -> dict[str, Feature]:
    """Features by error.

    Args:
        *tables: of `features.toml`.
    """
    found = tomllib.loads((resources.files("rvjax.study.kinds") / "features.toml").read_text("utf-8"))
    return {error: Feature(**row) for table in tables for error, row in found[table].items()}
