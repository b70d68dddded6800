"""Conditions of a measurement: unit, torque, direction, temperature, speed."""

import dataclasses
from dataclasses import dataclass

from rvjax.units import rpm

DIRECTIONS = {"forward": 1, "backward": -1}


@dataclass(frozen=True)
class Conditions:
    """Conditions of a measurement.

    Attributes:
        unit: name of the unit, "" where the file has no column for it.
        torque: N m, None where the file does not say.
        direction: "forward" or "backward".
        temperature: degC, None where the file does not say.
        speed: of the input, rad/s, None where the file does not say.
        stated: whether the file has directions; without them every run is forward.
    """

    unit: str = ""
    torque: float | None = None
    direction: str = "forward"
    temperature: float | None = None
    speed: float | None = None
    stated: bool = dataclasses.field(default=True, compare=False)

    @property
    def sign(self) -> int:
        """1 forward, -1 backward: load opposes motion, so it is the sign of the torque of the discs on the carrier."""
        return DIRECTIONS[self.direction]

    def text(self) -> str:
        """Text such as "412 N m forward, 25 degC"."""
        torque = "" if self.torque is None else f"{self.torque:g} N m "
        speed = "" if self.speed is None else f", {self.speed / rpm:g} r/min"
        return f"{torque}{self.direction}{speed}" + ("" if self.temperature is None else f", {self.temperature:g} degC")


def where(source: str, at: Conditions) -> str:
    """Name a run in a message.

    Args:
        source: name of the file.
        at: its conditions.
    """
    unit = f"unit {at.unit!r}, " if at.unit else ""
    return f"{source}: {unit}run {at.text()}"
