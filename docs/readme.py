"""Draw the figure of the README: `python docs/readme.py`, at once where `results` holds that of `rvjax allocate`."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import rvjax
from rvjax import plotting, study

PICTURES = Path(__file__).parent / "pictures"


def answer() -> None:
    """Draw the result of the embedded study: two requirements before and after, and the cost of the tolerances."""
    from rvjax.commands.allocate.answer import answer, restored_from

    question = study.load("rv-40e-whole", solve=False)
    found = restored_from(question)[1] or answer(question)
    with plotting.style():
        figure, axes = plt.subplots(1, 3, figsize=(13, 3.6))
        for name, place in zip(("loaded_transmission_error", "life"), axes):
            plotting.histogram(
                {"after": found.after.values[name], "before": found.before.values[name]},
                unit=found.study.output(name).unit,
                name=name,
                limits=(found.study.requirements[name].lower, found.study.requirements[name].upper),
                read_in=found.study.output(name).read_in,
                axes=place,
            )
        plotting.cost_bars(found.before.cost, found.after.cost, axes=axes[2])
        figure.savefig(PICTURES / "answer.png", dpi=80)


if __name__ == "__main__":
    rvjax.enable_x64()
    PICTURES.mkdir(exist_ok=True)
    answer()
