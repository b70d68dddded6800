"""Writes what the README shows and nobody should type: the table of levels and two pictures.

python docs/readme.py            all (the answer to the embedded study takes a minute)
python docs/readme.py levels     the table and the picture of the levels only
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import rvjax
from rvjax import plotting, study
from rvjax.levels import markdown, table

README = Path(__file__).parents[1] / "README.md"
PICTURES = Path(__file__).parent / "pictures"
BEGIN, END = "<!-- tradeoff begins -->\n", "<!-- tradeoff ends -->\n"


def levels() -> None:
    """The measured levels, as the table and the picture."""
    text = README.read_text("utf-8")
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    README.write_text(f"{before}\n{markdown(table.stored())}\n\n{after}", "utf-8")
    plotting.tradeoff(table.stored()).savefig(PICTURES / "tradeoff.png", dpi=80)


def answer() -> None:
    """What the embedded study answers: two requirements before and after, and what the tolerances cost."""
    from rvjax.study.answer import answer

    found = answer(study.load("rv-40e"), progress=False)
    with plotting.style():
        figure, axes = plt.subplots(1, 3, figsize=(13, 3.6))
        for name, place in zip(("transmission_error", "lost_motion"), axes):
            plotting.response_histogram(
                found.before.values[name],
                found.after.values[name],
                unit=found.study.output(name).unit,
                name=name,
                upper=found.study.requirements[name].upper,
                axes=place,
            )
        plotting.cost_bars(found.before.cost, found.after.cost, axes=axes[2])
        figure.savefig(PICTURES / "answer.png", dpi=80)


if __name__ == "__main__":
    rvjax.enable_x64()
    PICTURES.mkdir(exist_ok=True)
    levels()
    if sys.argv[1:] != ["levels"]:
        answer()
