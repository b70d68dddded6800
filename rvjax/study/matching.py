"""How measured parts of a study are matched: the table [assembly]."""

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Assembly:
    """What `rvjax assemble` asks of a list of parts.

    Attributes:
        response: that decides; None: the only requirement.
        objective: "mean", "bottleneck" or "yield".
        turned: discs may be turned over and carriers turned.
        draws: of what is not known of the parts, to choose by.
        certificate_draws: fresh ones, to value by.
        sd: standard deviation of the measurement by error, SI.
    """

    response: str | None = None
    objective: str = "mean"
    turned: bool = True
    draws: int = 64
    certificate_draws: int = 1024
    sd: Mapping[str, float] = dataclasses.field(default_factory=dict)
